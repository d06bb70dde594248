//! Depth of every pixel of one view: PatchMatch stereo (Bleyer et al. 2011; Barnes et al. 2009).
//!
//! A hypothesis is a plane, written as inverse depth over the image. The inverse depth of a plane is linear in the
//! pixel. A slanted surface therefore needs three numbers, and carrying a plane to the next pixel two multiplications.
//! Good hypotheses spread from pixel to pixel; random changes refine them.

use tcgs_core::{distance, dot};

use tcgs_core::Pinhole;

use super::vantage::Vantage;

/// Maximum number of views that a view is compared with.
pub(super) const MAX_SOURCES: usize = 6;
/// Half of a window's side over its sample spacing: 5 x 5 samples.
const WINDOW_STEPS: i32 = 2;
/// Pixels between two samples of a window.
const WINDOW_SPACING: i32 = 2;
const WINDOW_SAMPLES: usize = ((2 * WINDOW_STEPS + 1) * (2 * WINDOW_STEPS + 1)) as usize;
/// Grey levels by which a sample may differ from the window's middle before it counts little: across the edge of an
/// object the depth is different.
const EDGE_CONTRAST: f32 = 0.12;
/// Added to the variances of both windows: noise of two grey levels is no texture.
const NOISE_VARIANCE: f32 = (2.0 / 255.0) * (2.0 / 255.0);
/// Cost of a hypothesis that leaves the other image: as bad as no correlation.
const OUTSIDE_COST: f32 = 1.0;
/// Steepest surface: largest change of depth over the way along the image, at unit distance.
const MAX_SLOPE: f32 = 5.0;
/// Largest disparity, image widths: no other view sees objects that are closer.
const MAX_DISPARITY_WIDTHS: f32 = 1.5;
/// Largest angle between two views' directions at which they are compared; cosine.
pub(super) const MIN_DIRECTION_COSINE: f32 = 0.4;
/// Farthest depth that is searched, scene units, ...
const FARTHEST: f32 = 1e6;
/// ... and the least ratio of farthest to nearest depth.
const FARTHEST_OF_NEAREST: f32 = 1e3;

/// Inverse depth over the image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Plane {
    /// At the pixel's centre.
    pub inverse_depth: f32,
    /// Change of inverse depth with a step to the right and down.
    pub gradient: [f32; 2],
}

impl Plane {
    /// The same plane, some pixels away.
    fn moved(self, dx: f32, dy: f32) -> Self {
        let [gx, gy] = self.gradient;
        Self { inverse_depth: self.inverse_depth + gx * dx + gy * dy, ..self }
    }
}

/// Depth estimates of a view.
#[derive(Clone, Debug)]
pub(super) struct DepthMap {
    /// `[H, W]`
    pub planes: Vec<Plane>,
    /// `[H, W]`; 1 minus the mean correlation with the best-matching other views, 0 to 2.
    pub costs: Vec<f32>,
}

/// Search range of a pixel's inverse depth: from and to.
pub(super) type Range = [f32; 2];

/// The other views that a view is compared with, nearest first.
///
/// - `count`: at most so many
pub(super) fn neighbors(pinholes: &[Pinhole<f32>], of: usize, count: usize) -> Vec<usize> {
    let me = &pinholes[of];
    let mut others: Vec<(f32, usize)> = (0..pinholes.len())
        .filter(|&i| i != of && dot(me.forward(), pinholes[i].forward()) >= MIN_DIRECTION_COSINE)
        .map(|i| (distance(me.center, pinholes[i].center), i))
        // Two cameras in one place have no depth between them.
        .filter(|&(distance, _)| distance > 0.0)
        .collect();
    others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    others.into_iter().take(count).map(|(_, i)| i).collect()
}

/// The widest range of inverse depths of a view, up to where the nearest other view would see a point
/// [`MAX_DISPARITY_WIDTHS`] away.
pub(super) fn widest_range(vantages: &[Vantage], of: usize, neighbors: &[usize]) -> Range {
    let me = &vantages[of].pinhole;
    let baselines = neighbors.iter().map(|&i| distance(me.center, vantages[i].pinhole.center));
    let baseline = baselines.fold(f32::INFINITY, f32::min);
    let to = MAX_DISPARITY_WIDTHS * me.width as f32 / (me.focal[0] * baseline);
    // A view without neighbours may have any range.
    let to = if to.is_finite() && to > 0.0 { to } else { 1.0 };
    [(1.0 / FARTHEST).min(to / FARTHEST_OF_NEAREST), to]
}

/// One view's search.
pub(super) struct Search<'a> {
    pub vantage: &'a Vantage,
    pub sources: Vec<SourceView<'a>>,
    /// `[H, W]`
    pub ranges: &'a [Range],
    pub seed: u64,
}

/// Another view, and the map of a pixel to it: `image_from_image * [x, y, 1] + inverse_depth * epipole`.
pub(super) struct SourceView<'a> {
    vantage: &'a Vantage,
    image_from_image: [[f32; 3]; 3],
    epipole: [f32; 3],
}

impl<'a> SourceView<'a> {
    pub fn new(from: &Vantage, to: &'a Vantage) -> Self {
        let (a, b) = (&from.pinhole, &to.pinhole);
        // K_b R_b R_aᵀ K_a⁻¹ and K_b (t_b − R_b R_aᵀ t_a)
        let relative: [[f32; 3]; 3] =
            std::array::from_fn(|i| std::array::from_fn(|j| dot(b.rotation[i], a.rotation[j])));
        let offset: [f32; 3] = std::array::from_fn(|i| b.translation[i] - dot(relative[i], a.translation));
        let without_intrinsics = relative.map(|[x, y, z]| {
            let [x, y] = [x / a.focal[0], y / a.focal[1]];
            [x, y, z - x * a.principal[0] - y * a.principal[1]]
        });
        let intrinsics = |m: [[f32; 3]; 3]| {
            let row = |i: usize| std::array::from_fn(|j| b.focal[i] * m[i][j] + b.principal[i] * m[2][j]);
            [row(0), row(1), m[2]]
        };
        let epipole = [
            b.focal[0] * offset[0] + b.principal[0] * offset[2],
            b.focal[1] * offset[1] + b.principal[1] * offset[2],
            offset[2],
        ];
        Self { vantage: to, image_from_image: intrinsics(without_intrinsics), epipole }
    }
}

/// The window around a pixel, its weights adding up to 1.
struct Window {
    weights: [f32; WINDOW_SAMPLES],
    /// Minus their weighted mean.
    values: [f32; WINDOW_SAMPLES],
    variance: f32,
}

impl Search<'_> {
    /// Starts from random planes, or from those of a coarser map.
    pub fn begin(&self, coarse: Option<(&DepthMap, usize)>) -> DepthMap {
        let pinhole = &self.vantage.pinhole;
        let num_pixels = pinhole.width * pinhole.height;
        let planes: Vec<Plane> = (0..num_pixels)
            .map(|pixel| match coarse {
                Some((map, width)) => {
                    let height = map.planes.len() / width;
                    let (x, y) = (pixel % pinhole.width, pixel / pinhole.width);
                    let (cx, cy) = ((x / 2).min(width - 1), (y / 2).min(height - 1));
                    let plane = map.planes[cy * width + cx];
                    let half = Plane { gradient: plane.gradient.map(|g| g / 2.0), ..plane };
                    let center = |i: usize| 2.0 * i as f32 + 0.5;
                    half.moved(x as f32 - center(cx), y as f32 - center(cy))
                }
                None => {
                    let mut random = Random::new(self.seed, pixel as u64);
                    let [from, to] = self.ranges[pixel];
                    let inverse_depth = from + (to - from) * random.unit();
                    let slope = |focal: f32, random: &mut Random| inverse_depth * random.signed() / focal;
                    let gradient = [slope(pinhole.focal[0], &mut random), slope(pinhole.focal[1], &mut random)];
                    Plane { inverse_depth, gradient }
                }
            })
            .collect();
        let costs = (0..num_pixels).map(|pixel| self.cost(&self.window(pixel), pixel, planes[pixel])).collect();
        DepthMap { planes, costs }
    }

    /// Sweeps over all pixels `sweeps` times, in alternating directions.
    pub fn refine(&self, map: &mut DepthMap, sweeps: usize) {
        let (width, height) = (self.vantage.pinhole.width, self.vantage.pinhole.height);
        let num_pixels = width * height;
        for sweep in 0..sweeps {
            let back = sweep % 2 == 1;
            for step in 0..num_pixels {
                let pixel = if back { num_pixels - 1 - step } else { step };
                let (x, y) = (pixel % width, pixel / width);
                let window = self.window(pixel);
                let mut best = (map.costs[pixel], map.planes[pixel]);
                let mut consider = |plane: Plane| {
                    let plane = self.limited(pixel, plane);
                    let cost = self.cost(&window, pixel, plane);
                    if cost < best.0 {
                        best = (cost, plane);
                    }
                    best.1
                };
                let (has_side, has_above) = if back { (x + 1 < width, y + 1 < height) } else { (x > 0, y > 0) };
                let toward = if back { -1.0 } else { 1.0 };
                if has_side {
                    consider(map.planes[if back { pixel + 1 } else { pixel - 1 }].moved(toward, 0.0));
                }
                if has_above {
                    consider(map.planes[if back { pixel + width } else { pixel - width }].moved(0.0, toward));
                }
                let mut random = Random::new(self.seed ^ (sweep as u64 + 1).wrapping_mul(0x9e37_79b9), pixel as u64);
                let [from, to] = self.ranges[pixel];
                let mut reach = 0.5_f32.powi(sweep as i32 + 1);
                let mut current = map.planes[pixel];
                for _ in 0..3 {
                    let slope = |i: usize, random: &mut Random| {
                        current.gradient[i]
                            + reach * random.signed() * current.inverse_depth / self.vantage.pinhole.focal[i]
                    };
                    let gradient = [slope(0, &mut random), slope(1, &mut random)];
                    let inverse_depth = current.inverse_depth + reach * (to - from) * random.signed();
                    current = consider(Plane { inverse_depth, gradient });
                    reach *= 0.2;
                }
                (map.costs[pixel], map.planes[pixel]) = best;
            }
        }
    }

    /// Clamps a plane to the pixel's range and to the steepest surface.
    fn limited(&self, pixel: usize, plane: Plane) -> Plane {
        let [from, to] = self.ranges[pixel];
        let inverse_depth = plane.inverse_depth.clamp(from, to);
        let focal = self.vantage.pinhole.focal;
        let most = |i: usize| MAX_SLOPE * inverse_depth / focal[i];
        let gradient = std::array::from_fn(|i| plane.gradient[i].clamp(-most(i), most(i)));
        Plane { inverse_depth, gradient }
    }

    fn window(&self, pixel: usize) -> Window {
        let Vantage { pinhole, gray, mask, .. } = self.vantage;
        let (x, y) = ((pixel % pinhole.width) as i32, (pixel / pinhole.width) as i32);
        let middle = gray[pixel];
        let (mut weights, mut values) = ([0.0; WINDOW_SAMPLES], [0.0; WINDOW_SAMPLES]);
        let (mut sum, mut mean) = (0.0, 0.0);
        let mut i = 0;
        for dy in -WINDOW_STEPS..=WINDOW_STEPS {
            for dx in -WINDOW_STEPS..=WINDOW_STEPS {
                let at_x = (x + dx * WINDOW_SPACING).clamp(0, pinhole.width as i32 - 1);
                let at_y = (y + dy * WINDOW_SPACING).clamp(0, pinhole.height as i32 - 1);
                let at = (at_y * pinhole.width as i32 + at_x) as usize;
                let other_side = mask.as_ref().is_some_and(|mask| mask[at] != mask[pixel]);
                let contrast = (gray[at] - middle).abs() / EDGE_CONTRAST;
                let weight = if other_side { 0.0 } else { 1.0 / (1.0 + contrast * contrast) };
                (weights[i], values[i]) = (weight, gray[at]);
                sum += weight;
                mean += weight * gray[at];
                i += 1;
            }
        }
        mean /= sum;
        let mut variance = 0.0;
        for (weight, value) in weights.iter_mut().zip(&mut values) {
            *weight /= sum;
            *value -= mean;
            variance += *weight * *value * *value;
        }
        Window { weights, values, variance }
    }

    /// Mean over the better half of the other views: in the rest the place may be occluded.
    fn cost(&self, window: &Window, pixel: usize, plane: Plane) -> f32 {
        if self.sources.is_empty() {
            return OUTSIDE_COST;
        }
        let place = self.vantage.pinhole.pixel_center(pixel);
        let mut costs = [OUTSIDE_COST; MAX_SOURCES];
        let count = self.sources.len();
        for (cost, source) in costs.iter_mut().zip(&self.sources) {
            *cost = source.cost(window, place, plane);
        }
        let costs = &mut costs[..count];
        costs.sort_unstable_by(f32::total_cmp);
        let used = count.div_ceil(2);
        costs[..used].iter().sum::<f32>() / used as f32
    }
}

impl SourceView<'_> {
    fn cost(&self, window: &Window, [x, y]: [f32; 2], plane: Plane) -> f32 {
        let (m, e) = (&self.image_from_image, self.epipole);
        let (width, height) = (self.vantage.pinhole.width, self.vantage.pinhole.height);
        let middle: [f32; 3] =
            std::array::from_fn(|i| m[i][0] * x + m[i][1] * y + m[i][2] + plane.inverse_depth * e[i]);
        let step_x: [f32; 3] = std::array::from_fn(|i| WINDOW_SPACING as f32 * (m[i][0] + plane.gradient[0] * e[i]));
        let step_y: [f32; 3] = std::array::from_fn(|i| WINDOW_SPACING as f32 * (m[i][1] + plane.gradient[1] * e[i]));
        let (u, v) = (middle[0] / middle[2], middle[1] / middle[2]);
        let inside = middle[2] > 0.0 && u >= 0.0 && v >= 0.0 && u < width as f32 && v < height as f32;
        if !inside {
            return OUTSIDE_COST;
        }
        let (mut mean, mut square, mut product) = (0.0, 0.0, 0.0);
        let mut i = 0;
        for dy in -WINDOW_STEPS..=WINDOW_STEPS {
            for dx in -WINDOW_STEPS..=WINDOW_STEPS {
                let at = |k: usize| middle[k] + dx as f32 * step_x[k] + dy as f32 * step_y[k];
                let inverse = 1.0 / at(2).max(1e-6);
                let value = bilinear(&self.vantage.gray, width, height, at(0) * inverse, at(1) * inverse);
                let weighted = window.weights[i] * value;
                mean += weighted;
                square += weighted * value;
                product += weighted * window.values[i];
                i += 1;
            }
        }
        let variance = (square - mean * mean).max(0.0);
        1.0 - product / ((window.variance + NOISE_VARIANCE) * (variance + NOISE_VARIANCE)).sqrt()
    }
}

/// Bilinear interpolation between the four nearest pixel centres; the border extends outside.
fn bilinear(values: &[f32], width: usize, height: usize, x: f32, y: f32) -> f32 {
    let x = (x - 0.5).clamp(0.0, (width - 1) as f32 - 1e-3);
    let y = (y - 0.5).clamp(0.0, (height - 1) as f32 - 1e-3);
    let (left, top) = (x as usize, y as usize);
    let (fx, fy) = (x - left as f32, y - top as f32);
    let at = top * width + left;
    let (above, below) = (&values[at..at + 2], &values[at + width..at + width + 2]);
    let a = above[0] + fx * (above[1] - above[0]);
    let b = below[0] + fx * (below[1] - below[0]);
    a + fy * (b - a)
}

/// Random numbers that depend on a seed and a place alone (SplitMix64; Steele et al. 2014).
pub(super) struct Random(u64);

impl Random {
    pub fn new(seed: u64, place: u64) -> Self {
        Self(seed.wrapping_mul(0xd134_2543_de82_ef95).wrapping_add(place.wrapping_mul(0x2545_f491_4f6c_dd1d)))
    }

    fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In `[0, 1)`.
    pub fn unit(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// In `[-1, 1)`.
    pub fn signed(&mut self) -> f32 {
        2.0 * self.unit() - 1.0
    }
}
