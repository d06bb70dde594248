//! From differences to a mask, and the image operations for it.

use tcgs_core::Segmentation;

use super::station::{Pixels, Station};

/// Foreground may reach this far out of the hull, pixels.
const REACH_PX: usize = 1;
/// Added to the belief in foreground inside the hull, since the hull supports it.
const HULL_BELIEF: f32 = 0.1;
/// Belief in foreground inside the hull where the background is never seen, in `[-1, 1]`.
const UNKNOWN: f32 = 0.15;
/// Half of the width of gaps that [`filled`] closes, as a share of the image's width.
const GAP: f32 = 0.03;
/// Radius of the guided filter, pixels.
const RADIUS: usize = 4;
/// Regularisation of the guided filter: beliefs are not averaged across edges of more than about the root of this.
const EPSILON: f32 = 3e-4;

/// The mask of an image, of the camera's full size.
///
/// - `image`, `differences`, `cover`: `[H, W]` of the reduced size; the latter two as `compare` gives them
/// - `threshold`: the difference above which a pixel is foreground
pub(super) fn mask(
    station: &Station,
    image: &Pixels,
    differences: &[f32],
    threshold: f32,
    cover: &[bool],
) -> Segmentation {
    let width = station.pinhole.width;
    let allowed = grown(width, cover, REACH_PX);
    let beliefs: Vec<f32> = (0..differences.len())
        .map(|i| match (allowed[i], station.background.known[i]) {
            (false, _) => -1.0,
            (true, false) => UNKNOWN,
            (true, true) => (differences[i] / threshold - 1.0 + HULL_BELIEF).clamp(-1.0, 1.0),
        })
        .collect();
    let guide: Vec<f32> =
        image.iter().map(|color| color.iter().map(|&value| f32::from(value)).sum::<f32>() / (3.0 * 255.0)).collect();
    let mut beliefs = guided(width, &guide, &beliefs);
    beliefs.iter_mut().zip(&allowed).filter(|(_, allowed)| !**allowed).for_each(|(belief, _)| *belief = -1.0);
    enlarged(station, &beliefs)
}

/// Beliefs above 0, interpolated linearly between the middles of reduced pixels.
fn enlarged(station: &Station, beliefs: &[f32]) -> Segmentation {
    let (width, height) = station.full_size;
    let (small_width, small_height) = (station.pinhole.width, station.pinhole.height);
    let near = |at: usize, size: usize| {
        let at = ((at as f32 + 0.5) / station.factor as f32 - 0.5).clamp(0.0, (size - 1) as f32);
        let first = at as usize;
        (first, (first + 1).min(size - 1), at - first as f32)
    };
    let columns: Vec<(usize, usize, f32)> = (0..width).map(|x| near(x, small_width)).collect();
    let mut foreground = Vec::with_capacity(width * height);
    for y in 0..height {
        let (upper, lower, down) = near(y, small_height);
        let mix = |x: usize| (1.0 - down) * beliefs[upper * small_width + x] + down * beliefs[lower * small_width + x];
        foreground
            .extend(columns.iter().map(|&(left, right, share)| (1.0 - share) * mix(left) + share * mix(right) > 0.0));
    }
    Segmentation { width, height, foreground }
}

/// Guided filter (He et al. 2013): averages `values`, but not across the edges of `guide`.
fn guided(width: usize, guide: &[f32], values: &[f32]) -> Vec<f32> {
    let mean = |values: Vec<f32>| Sums::new(width, values).means(RADIUS);
    let g = mean(guide.to_vec());
    let v = mean(values.to_vec());
    let gg = mean(guide.iter().map(|g| g * g).collect());
    let gv = mean(guide.iter().zip(values).map(|(g, v)| g * v).collect());
    let slopes: Vec<f32> = (0..g.len()).map(|i| (gv[i] - g[i] * v[i]) / (gg[i] - g[i] * g[i] + EPSILON)).collect();
    let offsets: Vec<f32> = (0..g.len()).map(|i| v[i] - slopes[i] * g[i]).collect();
    let (slopes, offsets) = (mean(slopes), mean(offsets));
    (0..g.len()).map(|i| slopes[i] * guide[i] + offsets[i]).collect()
}

/// Majority filter over 3x3 pixels.
pub(super) fn majority(width: usize, mask: &[bool]) -> Vec<bool> {
    Sums::of_mask(width, mask).means(1).into_iter().map(|share| share > 0.5).collect()
}

/// A mask without narrow gaps and without holes: closed by 3 % of the width, then filled.
pub(super) fn filled(width: usize, mask: &[bool]) -> Vec<bool> {
    let radius = (GAP * width as f32).round() as usize;
    let closed = grown(width, mask, radius);
    let height = mask.len() / width;
    // Unmarked pixels that are connected to the image's border are outside.
    let mut outside = vec![false; mask.len()];
    let is_border = |i: usize| [0, width - 1].contains(&(i % width)) || [0, height - 1].contains(&(i / width));
    let mut next: Vec<usize> = (0..mask.len()).filter(|&i| is_border(i)).collect();
    while let Some(i) = next.pop() {
        if closed[i] || outside[i] {
            continue;
        }
        outside[i] = true;
        let (x, y) = (i % width, i / width);
        let around = [(x > 0, i.wrapping_sub(1)), (x + 1 < width, i + 1)];
        let across = [(y > 0, i.wrapping_sub(width)), (y + 1 < height, i + width)];
        next.extend(around.into_iter().chain(across).filter(|(exists, _)| *exists).map(|(_, neighbor)| neighbor));
    }
    grown(width, &outside, radius).iter().zip(mask).map(|(outside, mask)| !outside || *mask).collect()
}

/// Dilation: pixels with a marked one at most `radius` rows and columns away.
pub(super) fn grown(width: usize, mask: &[bool], radius: usize) -> Vec<bool> {
    Sums::of_mask(width, mask).means(radius).into_iter().map(|share| share > 0.0).collect()
}

/// Summed-area table: sums over rectangles in constant time (Crow 1984).
struct Sums {
    width: usize,
    height: usize,
    /// `[H + 1, W + 1]`: of all pixels above and to the left.
    sums: Vec<f64>,
}

impl Sums {
    fn of_mask(width: usize, mask: &[bool]) -> Self {
        Self::new(width, mask.iter().map(|&marked| f32::from(u8::from(marked))).collect())
    }

    fn new(width: usize, values: Vec<f32>) -> Self {
        let height = values.len() / width;
        let mut sums = vec![0.0; (width + 1) * (height + 1)];
        for y in 0..height {
            let mut row = 0.0;
            for x in 0..width {
                row += f64::from(values[y * width + x]);
                sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + row;
            }
        }
        Self { width, height, sums }
    }

    /// Means over the squares of `2 radius + 1` pixels around each pixel, cut at the image's edges.
    fn means(&self, radius: usize) -> Vec<f32> {
        let at = |x: usize, y: usize| self.sums[y * (self.width + 1) + x];
        let mut means = Vec::with_capacity(self.width * self.height);
        for y in 0..self.height {
            let (top, bottom) = (y.saturating_sub(radius), (y + radius + 1).min(self.height));
            for x in 0..self.width {
                let (left, right) = (x.saturating_sub(radius), (x + radius + 1).min(self.width));
                let sum = at(right, bottom) + at(left, top) - at(left, bottom) - at(right, top);
                means.push((sum / ((right - left) * (bottom - top)) as f64) as f32);
            }
        }
        means
    }
}
