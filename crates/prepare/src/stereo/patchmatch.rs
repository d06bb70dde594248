//! Depth of every pixel of one view: PatchMatch stereo (Bleyer et al. 2011; Barnes et al. 2009).
//!
//! A hypothesis is a plane, written as inverse depth over the image. The inverse depth of a plane is linear in the
//! pixel. A slanted surface therefore needs three numbers, and carrying a plane to the next pixel two multiplications.
//! Good hypotheses spread from pixel to pixel; random changes refine them.
//!
//! Nearly all time goes into correlations of windows. They are written for vectors of [`LANES`] samples, compiled for
//! AVX2 as well, without fused multiply-adds: the bits are the same on all machines.

use multiversion::multiversion;
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
/// Samples computed at a time.
const LANES: usize = 8;
/// Samples of a window with those that fill up the last vector. These lie in the middle and have no weight.
const PADDED: usize = WINDOW_SAMPLES.next_multiple_of(LANES);
/// Columns and rows of the samples from the middle, in steps.
const OFFSETS: [[f32; PADDED]; 2] = offsets();
/// Adding this rounds to an integer, which the low bits of the mantissa then hold.
const ROUND: f32 = 12_582_912.0;
/// The bits of the integer.
const INTEGER: u32 = (1 << 22) - 1;
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

const fn offsets() -> [[f32; PADDED]; 2] {
    let side = 2 * WINDOW_STEPS as usize + 1;
    let mut offsets = [[0.0; PADDED]; 2];
    let mut i = 0;
    while i < WINDOW_SAMPLES {
        offsets[0][i] = (i % side) as f32 - WINDOW_STEPS as f32;
        offsets[1][i] = (i / side) as f32 - WINDOW_STEPS as f32;
        i += 1;
    }
    offsets
}

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

    /// The map of pixels to this view by a plane: it times `[x, y, 1]` is the place times the ratio of depths.
    ///
    /// - `inverse_depth`, `gradient`: of the plane, at the image's corner and for a step to the right and down
    pub fn homography(&self, inverse_depth: f32, gradient: [f32; 2]) -> [[f32; 3]; 3] {
        let of_depth = [gradient[0], gradient[1], inverse_depth];
        std::array::from_fn(|i| std::array::from_fn(|j| self.image_from_image[i][j] + self.epipole[i] * of_depth[j]))
    }
}

/// The window around a pixel, its weights adding up to 1.
struct Window {
    weights: [f32; PADDED],
    /// Minus their weighted mean.
    values: [f32; PADDED],
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
        let costs = costs(self, &planes);
        DepthMap { planes, costs }
    }

    /// Sweeps over all pixels `sweeps` times, in alternating directions.
    pub fn refine(&self, map: &mut DepthMap, sweeps: usize) {
        for number in 0..sweeps {
            sweep(self, map, number);
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
        let (mut weights, mut values) = ([0.0; PADDED], [0.0; PADDED]);
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
        for (weight, value) in weights.iter_mut().zip(&mut values).take(WINDOW_SAMPLES) {
            *weight /= sum;
            *value -= mean;
            variance += *weight * *value * *value;
        }
        Window { weights, values, variance }
    }

    /// Mean over the better half of the other views: in the rest the place may be occluded.
    ///
    /// - returns: the mean, or infinity once it is certain that the mean is at least `limit`
    #[inline(always)]
    fn cost(&self, window: &Window, pixel: usize, plane: Plane, limit: f32) -> f32 {
        let count = self.sources.len();
        if count == 0 {
            return OUTSIDE_COST;
        }
        let place = self.vantage.pinhole.pixel_center(pixel);
        let used = count.div_ceil(2);
        // The costs so far, ascending.
        let mut costs = [f32::INFINITY; MAX_SOURCES];
        for (done, source) in self.sources.iter().enumerate() {
            let mut cost = source.cost(window, place, plane);
            for other in &mut costs[..=done] {
                if cost < *other {
                    std::mem::swap(&mut cost, other);
                }
            }
            // The views to come may cost nothing.
            let certain = used.saturating_sub(count - done - 1);
            if costs[..certain].iter().sum::<f32>() >= limit * used as f32 {
                return f32::INFINITY;
            }
        }
        costs[..used].iter().sum::<f32>() / used as f32
    }
}

/// The cost of each pixel's plane.
#[multiversion(targets("x86_64+avx2"))]
fn costs(search: &Search, planes: &[Plane]) -> Vec<f32> {
    let cost = |(pixel, &plane)| search.cost(&search.window(pixel), pixel, plane, f32::INFINITY);
    planes.iter().enumerate().map(cost).collect()
}

/// Takes planes from the pixels before, and changes them at random.
///
/// - `number`: of sweeps before; every other one goes backwards
#[multiversion(targets("x86_64+avx2"))]
fn sweep(search: &Search, map: &mut DepthMap, number: usize) {
    let (width, height) = (search.vantage.pinhole.width, search.vantage.pinhole.height);
    let num_pixels = width * height;
    let back = number % 2 == 1;
    for step in 0..num_pixels {
        let pixel = if back { num_pixels - 1 - step } else { step };
        let (x, y) = (pixel % width, pixel / width);
        let window = search.window(pixel);
        let mut best = (map.costs[pixel], map.planes[pixel]);
        let mut consider = |plane: Plane| {
            let plane = search.limited(pixel, plane);
            let cost = search.cost(&window, pixel, plane, best.0);
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
        let mut random = Random::new(search.seed ^ (number as u64 + 1).wrapping_mul(0x9e37_79b9), pixel as u64);
        let [from, to] = search.ranges[pixel];
        let mut reach = 0.5_f32.powi(number as i32 + 1);
        let mut current = map.planes[pixel];
        for _ in 0..3 {
            let slope = |i: usize, random: &mut Random| {
                current.gradient[i] + reach * random.signed() * current.inverse_depth / search.vantage.pinhole.focal[i]
            };
            let gradient = [slope(0, &mut random), slope(1, &mut random)];
            let inverse_depth = current.inverse_depth + reach * (to - from) * random.signed();
            current = consider(Plane { inverse_depth, gradient });
            reach *= 0.2;
        }
        (map.costs[pixel], map.planes[pixel]) = best;
    }
}

impl SourceView<'_> {
    /// One minus the correlation of the window with its place in this view, at least 0.
    #[inline(always)]
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
        // Bilinear interpolation between the four nearest pixel centres; the border extends outside.
        let most = [width, height].map(|side| (side - 1) as f32 - 1e-3);
        let (mut parts, mut places) = ([[0.0; PADDED]; 2], [0; PADDED]);
        for i in 0..PADDED {
            let at = |k: usize| middle[k] + OFFSETS[0][i] * step_x[k] + OFFSETS[1][i] * step_y[k];
            let depth = at(2);
            let inverse = 1.0 / if depth > 1e-6 { depth } else { 1e-6 };
            let (x, y) = (within(at(0) * inverse - 0.5, most[0]), within(at(1) * inverse - 0.5, most[1]));
            // Pixels to the left and above. On a pixel's centre they may be the ones before it, at a part of 1.
            let (left, top) = (x - 0.5 + ROUND, y - 0.5 + ROUND);
            (parts[0][i], parts[1][i]) = (x - (left - ROUND), y - (top - ROUND));
            places[i] = (top.to_bits() & INTEGER) * width as u32 + (left.to_bits() & INTEGER);
        }
        let mut corners = [[0.0; PADDED]; 4];
        for i in 0..WINDOW_SAMPLES {
            let rows = &self.vantage.gray[places[i] as usize..][..width + 2];
            for (corner, value) in corners.iter_mut().zip([rows[0], rows[1], rows[width], rows[width + 1]]) {
                corner[i] = value;
            }
        }
        let mut sums = [[0.0; LANES]; 3];
        for first in (0..PADDED).step_by(LANES) {
            for lane in 0..LANES {
                let i = first + lane;
                let above = corners[0][i] + parts[0][i] * (corners[1][i] - corners[0][i]);
                let below = corners[2][i] + parts[0][i] * (corners[3][i] - corners[2][i]);
                let value = above + parts[1][i] * (below - above);
                let weighted = window.weights[i] * value;
                sums[0][lane] += weighted;
                sums[1][lane] += weighted * value;
                sums[2][lane] += weighted * window.values[i];
            }
        }
        let [mean, square, product] = sums.map(|lanes| lanes.iter().sum::<f32>());
        let variance = (square - mean * mean).max(0.0);
        1.0 - product / ((window.variance + NOISE_VARIANCE) * (variance + NOISE_VARIANCE)).sqrt()
    }
}

/// `x` limited to `0..=most`; 0 for NaN.
#[inline(always)]
fn within(x: f32, most: f32) -> f32 {
    let x = if x > 0.0 { x } else { 0.0 };
    if x < most { x } else { most }
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

#[cfg(test)]
mod tests {
    use tcgs_core::Camera;

    use super::*;

    const SIZE: [usize; 2] = [40, 30];

    /// A view of noise from beside the origin, which looks at a point 4 in front of it.
    fn noise(x: f64, seed: u64) -> Vantage {
        let [width, height] = SIZE;
        let camera = Camera {
            principal: [20.5, 14.5],
            ..Camera::look_at([x, 0.1 * x, 0.0], [0.0, 0.0, 4.0], [0.0, -1.0, 0.0], 45.0, width, height)
        };
        let gray = (0..width * height).map(|i| Random::new(seed, i as u64).unit()).collect();
        Vantage { pinhole: Pinhole::new(&camera), gray, colors: Vec::new(), mask: None }
    }

    /// One minus the correlation of a pixel's window with its place in another view, sample by sample, by projections.
    fn cost_by_points(from: &Vantage, to: &Vantage, pixel: usize, plane: Plane) -> f64 {
        let [width, height] = SIZE;
        let [x, y] = from.pinhole.pixel_center(pixel);
        let gray = |view: &Vantage, x: f32, y: f32| {
            let clamped = |v: f32, side: usize| f64::from((v - 0.5).clamp(0.0, (side - 1) as f32 - 1e-3));
            let (x, y) = (clamped(x, width), clamped(y, height));
            let at = |dx: f64, dy: f64| {
                f64::from(view.gray[(y.floor() + dy) as usize * width + (x.floor() + dx) as usize])
                    * (1.0 - (x.fract() - dx).abs())
                    * (1.0 - (y.fract() - dy).abs())
            };
            at(0.0, 0.0) + at(1.0, 0.0) + at(0.0, 1.0) + at(1.0, 1.0)
        };
        let steps = || (-WINDOW_STEPS..=WINDOW_STEPS).map(|step| (WINDOW_SPACING * step) as f32);
        let samples: Vec<[f64; 3]> = steps()
            .flat_map(|dy| steps().map(move |dx| (dx, dy)))
            .map(|(dx, dy)| {
                let own = gray(from, x + dx, y + dy);
                let contrast = (own - gray(from, x, y)) / f64::from(EDGE_CONTRAST);
                let depth = 1.0 / plane.moved(dx, dy).inverse_depth;
                let [u, v] = to.pinhole.project(from.pinhole.unproject([x + dx, y + dy], depth)).unwrap().0;
                [1.0 / (1.0 + contrast * contrast), own, gray(to, u, v)]
            })
            .collect();
        let sum = |term: &dyn Fn(f64, f64) -> f64| {
            let total: f64 = samples.iter().map(|s| s[0]).sum();
            samples.iter().map(|&[weight, a, b]| weight * term(a, b)).sum::<f64>() / total
        };
        let (a, b) = (sum(&|a, _| a), sum(&|_, b| b));
        let noise = f64::from(NOISE_VARIANCE);
        let variances = (sum(&|v, _| v * v) - a * a + noise) * (sum(&|_, v| v * v) - b * b + noise);
        1.0 - (sum(&|v, w| v * w) - a * b) / variances.sqrt()
    }

    #[test]
    fn costs_are_correlations_of_projected_windows() {
        let (from, others) = (noise(0.0, 1), [0.5, -0.4, 0.9, -1.0].map(|x| noise(x, 7)));
        let sources = others.iter().map(|to| SourceView::new(&from, to)).collect();
        let search = Search { vantage: &from, sources, ranges: &[], seed: 0 };
        let mut mean_below_limit = 0;
        for pixel in (0..SIZE[0] * SIZE[1]).step_by(7) {
            let mut random = Random::new(3, pixel as u64);
            let inverse_depth = 0.25 + 0.05 * random.signed();
            let gradient = [0.002 * random.signed(), 0.002 * random.signed()];
            let plane = Plane { inverse_depth, gradient };
            let window = search.window(pixel);
            let [x, y] = from.pinhole.pixel_center(pixel);
            let mut expected: Vec<f64> = others
                .iter()
                .zip(&search.sources)
                .map(|(to, source)| {
                    let place = to.pinhole.project(from.pinhole.unproject([x, y], 1.0 / inverse_depth)).unwrap().0;
                    let inside = (0..2).all(|i| place[i] >= 0.0 && place[i] < SIZE[i] as f32);
                    // At the border of the own image, windows repeat its last pixels, at depths outside of it.
                    let is_whole = (4..SIZE[0] - 4).contains(&(x as usize)) && (4..SIZE[1] - 4).contains(&(y as usize));
                    let found = f64::from(source.cost(&window, [x, y], plane));
                    let by_points = if inside { cost_by_points(&from, to, pixel, plane) } else { 1.0 };
                    assert!(!is_whole || (found - by_points).abs() < 2e-3, "{pixel}: {found}, expected {by_points}");
                    found
                })
                .collect();
            expected.sort_by(f64::total_cmp);
            let mean = (expected[0] + expected[1]) / 2.0;
            assert!((f64::from(search.cost(&window, pixel, plane, f32::INFINITY)) - mean).abs() < 1e-6);
            // A limit changes no decision.
            for limit in [0.3, 0.8, 1.0, 1.1] {
                let found = search.cost(&window, pixel, plane, limit);
                if mean < f64::from(limit) - 1e-6 {
                    mean_below_limit += 1;
                    assert!((f64::from(found) - mean).abs() < 1e-6, "{pixel}: {found}, expected {mean}");
                } else {
                    assert!(found >= limit - 1e-6);
                }
            }
        }
        assert!((50..600).contains(&mean_below_limit), "{mean_below_limit}");
    }
}
