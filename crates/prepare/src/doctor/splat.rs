//! Draws points as seen by a camera, and measures their fit to an image.

use tcgs_core::{Pinhole, PointCloud, distance};

/// Maximum number of drawn points.
const MAX_POINTS: usize = 40_000;
/// Number of points at which the distance between neighbours is measured.
const NUM_PROBES: usize = 100;
/// Points are drawn as squares this much wider than the distance to the next one.
const OVERLAP: f32 = 1.5;
/// Squares reach at most this many pixels from their middle.
const MAX_REACH_PX: i32 = 4;
/// Minimum share of the image's pixels for a comparison.
pub(super) const MIN_COVERAGE: f64 = 0.1;
/// Variance of colours below which there is nothing to compare.
const MIN_VARIANCE: f64 = 1e-5;

/// Points to draw.
#[derive(Clone, Debug)]
pub(crate) struct Splats {
    points: Vec<[f32; 3]>,
    colors: Vec<[f32; 3]>,
    foreground: Vec<bool>,
    /// Side of a square, scene units: of background and of foreground, which may be denser.
    sizes: [f32; 2],
}

/// A picture with holes.
pub(crate) struct Drawing {
    pub width: usize,
    /// Points that fall into the picture, hidden ones too.
    pub num_points: usize,
    /// `[H, W]`; 0 is a hole.
    pub depths: Vec<f32>,
    /// `[H, W]`
    pub colors: Vec<[f32; 3]>,
    /// `[H, W]`
    pub foreground: Vec<bool>,
}

impl Splats {
    pub fn new(cloud: &PointCloud) -> Self {
        let step = cloud.points.len().div_ceil(MAX_POINTS).max(1);
        let points: Vec<[f32; 3]> = cloud.points.iter().step_by(step).copied().collect();
        let foreground: Vec<bool> = cloud.foreground.iter().step_by(step).copied().collect();
        let gap = |label: bool| {
            let alike: Vec<[f32; 3]> =
                points.iter().zip(&foreground).filter(|(_, f)| **f == label).map(|(p, _)| *p).collect();
            let nearest = |i: usize| {
                let others = alike.iter().enumerate().filter(|&(j, _)| j != i);
                others.map(|(_, &p)| distance(p, alike[i])).fold(f32::INFINITY, f32::min)
            };
            let mut gaps: Vec<f32> =
                (0..alike.len()).step_by(alike.len().div_ceil(NUM_PROBES).max(1)).map(nearest).collect();
            gaps.sort_by(f32::total_cmp);
            gaps.get(gaps.len() / 2).copied().unwrap_or(0.0)
        };
        let sizes = [OVERLAP * gap(false), OVERLAP * gap(true)];
        Self { colors: cloud.colors.iter().step_by(step).copied().collect(), foreground, sizes, points }
    }

    /// Whether some points are foreground and some are not.
    pub fn has_both_labels(&self) -> bool {
        self.foreground.contains(&true) && self.foreground.contains(&false)
    }

    /// Correlation of the points' colours with those of their nearest neighbours, 0 to 1. It is the share of the
    /// colours' variance that is texture and not the noise of single points. 0 for fewer than three points.
    pub fn smoothness(&self) -> f64 {
        if self.points.len() < 3 {
            return 0.0;
        }
        let step = self.points.len().div_ceil(NUM_PROBES).max(1);
        let pairs: Vec<(usize, usize)> = (0..self.points.len())
            .step_by(step)
            .filter_map(|i| {
                let apart = |j: usize| distance(self.points[j], self.points[i]);
                let others = (0..self.points.len()).filter(|&j| j != i);
                others.min_by(|&a, &b| apart(a).total_cmp(&apart(b))).map(|j| (i, j))
            })
            .collect();
        let color = |i: usize| self.colors[i].map(f64::from);
        correlation_of_pairs(pairs.into_iter().map(|(i, j)| (color(i), color(j))).collect())
    }

    pub fn draw(&self, pinhole: &Pinhole<f32>) -> Drawing {
        let num_pixels = pinhole.width * pinhole.height;
        let mut drawing = Drawing {
            width: pinhole.width,
            num_points: 0,
            depths: vec![0.0; num_pixels],
            colors: vec![[0.0; 3]; num_pixels],
            foreground: vec![false; num_pixels],
        };
        for (i, &point) in self.points.iter().enumerate() {
            let Some((pixel, depth)) = pinhole.pixel(point) else { continue };
            drawing.num_points += 1;
            let reach = ((0.5 * self.sizes[usize::from(self.foreground[i])] * pinhole.focal[0] / depth).round() as i32)
                .min(MAX_REACH_PX);
            let (x, y) = ((pixel % pinhole.width) as i32, (pixel / pinhole.width) as i32);
            for row in (y - reach).max(0)..=(y + reach).min(pinhole.height as i32 - 1) {
                for column in (x - reach).max(0)..=(x + reach).min(pinhole.width as i32 - 1) {
                    let at = row as usize * pinhole.width + column as usize;
                    if drawing.depths[at] == 0.0 || depth < drawing.depths[at] {
                        drawing.depths[at] = depth;
                        drawing.colors[at] = self.colors[i];
                        drawing.foreground[at] = self.foreground[i];
                    }
                }
            }
        }
        drawing
    }
}

impl Drawing {
    /// Correlation with the colours of an image of the same size that is shifted, -1 to 1; `None` where there is too
    /// little to compare.
    ///
    /// - `shift`: the drawing at `x, y` is compared with the image at `x + shift`
    /// - `step`: spacing of the compared pixels along both axes
    pub fn fit(&self, colors: &[[f32; 3]], shift: [i32; 2], step: usize) -> Option<f64> {
        let (width, height) = (self.width as i32, (self.depths.len() / self.width) as i32);
        // Per channel: sum and sum of squares of both, and sum of the product.
        let (mut count, mut sums) = (0.0, [[0.0_f64; 5]; 3]);
        let mut compared = 0;
        for y in (0..height).step_by(step) {
            for x in (0..width).step_by(step) {
                let (at_x, at_y) = (x + shift[0], y + shift[1]);
                if !(0..width).contains(&at_x) || !(0..height).contains(&at_y) {
                    continue;
                }
                compared += 1;
                let at = (y * width + x) as usize;
                if self.depths[at] == 0.0 {
                    continue;
                }
                let other = colors[(at_y * width + at_x) as usize];
                count += 1.0;
                for (sums, (a, b)) in sums.iter_mut().zip(self.colors[at].iter().zip(other)) {
                    let (a, b) = (f64::from(*a), f64::from(b));
                    for (sum, value) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                        *sum += value;
                    }
                }
            }
        }
        let all = (self.depths.len() / (step * step)) as f64;
        if count < MIN_COVERAGE * all || f64::from(compared) < 0.25 * all {
            return None;
        }
        let (mut product, mut square_a, mut square_b) = (0.0, 0.0, 0.0);
        for [a, b, aa, bb, ab] in sums.map(|sums| sums.map(|sum| sum / count)) {
            product += ab - a * b;
            square_a += aa - a * a;
            square_b += bb - b * b;
        }
        (square_a >= MIN_VARIANCE && square_b >= MIN_VARIANCE).then(|| product / (square_a * square_b).sqrt())
    }

    /// Share of the drawn pixels.
    pub fn coverage(&self) -> f64 {
        self.depths.iter().filter(|&&depth| depth > 0.0).count() as f64 / self.depths.len() as f64
    }

    /// Whether a pixel was drawn.
    pub fn is_drawn(&self, pixel: usize) -> bool {
        self.depths[pixel] > 0.0
    }
}

/// Correlation of an image with itself shifted by a pixel to the right, 0 to 1: the share of its variance that is
/// texture and not noise of single pixels.
///
/// - `colors`: `[H, W]`
pub(super) fn smoothness(colors: &[[f32; 3]], width: usize) -> f64 {
    let at = |pixel: usize| colors[pixel].map(f64::from);
    let pairs = (0..colors.len()).filter(|i| (i + 1) % width != 0).map(|i| (at(i), at(i + 1)));
    correlation_of_pairs(pairs.collect())
}

/// Correlation of colours that lie beside each other, 0 to 1; 0 where all are the same.
fn correlation_of_pairs(pairs: Vec<([f64; 3], [f64; 3])>) -> f64 {
    let (mut product, mut variance) = (0.0, 0.0);
    for channel in 0..3 {
        let mean = pairs.iter().map(|(a, b)| a[channel] + b[channel]).sum::<f64>() / (2.0 * pairs.len() as f64);
        for (a, b) in &pairs {
            let (a, b) = (a[channel] - mean, b[channel] - mean);
            product += a * b;
            variance += (a * a + b * b) / 2.0;
        }
    }
    if variance > 0.0 { (product / variance).clamp(0.0, 1.0) } else { 0.0 }
}
