//! Evidence that something changed in a view from one timestep to the next: differences of images beyond the camera's
//! noise, and errors of the scene's picture that have grown.

use std::ops::Range;

use tcgs_core::Image;
use tcgs_render::{TILE, TileMask};

use super::GateConfig;

/// Channels of an image that are its colours.
const COLORS: usize = 3;
/// Side in pixels of the blocks whose difference is averaged against noise.
const BLOCK: usize = 4;
/// Bins of differences, from 0 to 1, of which the median is taken.
const NOISE_BINS: usize = 8192;
/// Median of the absolute value of a normal variable of standard deviation 1.
const NORMAL_MEDIAN: f64 = 0.674_489_75;

/// Blocks of an image, of [`BLOCK`] pixels a side; those at the right and lower edge may be cut.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Blocks {
    pub across: usize,
    pub down: usize,
    /// `[down, across]`
    pub is_marked: Vec<bool>,
}

impl Blocks {
    pub fn none(width: usize, height: usize) -> Self {
        let (across, down) = (width.div_ceil(BLOCK), height.div_ceil(BLOCK));
        Self { across, down, is_marked: vec![false; across * down] }
    }

    /// Whether the block that holds a pixel is marked.
    pub fn at(&self, x: usize, y: usize) -> bool {
        self.is_marked[y / BLOCK * self.across + x / BLOCK]
    }

    /// Marks the blocks that hold pixels of `columns` and `rows`.
    pub fn mark(&mut self, columns: Range<usize>, rows: Range<usize>) {
        for row in rows.start / BLOCK..rows.end.div_ceil(BLOCK) {
            let columns = columns.start / BLOCK..columns.end.div_ceil(BLOCK);
            self.is_marked[row * self.across..][columns].fill(true);
        }
    }

    /// Number of marked blocks among a block and the eight around it.
    fn around(&self, index: usize) -> usize {
        let (x, y) = (index % self.across, index / self.across);
        let rows = y.saturating_sub(1)..(y + 2).min(self.down);
        rows.map(|row| {
            let columns = x.saturating_sub(1)..(x + 2).min(self.across);
            self.is_marked[row * self.across..][columns].iter().filter(|marked| **marked).count()
        })
        .sum()
    }

    /// The blocks that have at least `count` marked ones among themselves and the eight around them.
    fn with_around(&self, count: usize) -> Self {
        let is_marked = (0..self.is_marked.len()).map(|index| self.around(index) >= count).collect();
        Self { is_marked, ..*self }
    }
}

/// Standard deviation of the noise in the difference of two images of one camera: a robust estimate from the second
/// derivative along rows, which hardly sees changes of light and shade (Immerkær 1996 for single images).
///
/// - `before`, `now`: `[C, H, W]`, of which the colours count
pub(super) fn noise(before: &Image, now: &Image) -> f32 {
    let width = now.width;
    let mut bins = vec![0_u32; NOISE_BINS];
    let mut count = 0_u32;
    for channel in 0..COLORS {
        let rows = before.plane(channel).chunks_exact(width).zip(now.plane(channel).chunks_exact(width));
        for (before, now) in rows {
            for x in (1..width.saturating_sub(1)).step_by(3) {
                let difference = |x: usize| now[x] - before[x];
                let bend = (difference(x - 1) - 2.0 * difference(x) + difference(x + 1)).abs();
                bins[((bend * NOISE_BINS as f32) as usize).min(NOISE_BINS - 1)] += 1;
                count += 1;
            }
        }
    }
    let mut below = 0;
    let median = bins.iter().position(|&bin| {
        below += bin;
        2 * below > count
    });
    // The weights 1, −2, 1 add up to six variances. Whole bins are what 8-bit images have; the first one is no noise.
    let median = median.unwrap_or(0) as f64 / NOISE_BINS as f64;
    (median / NORMAL_MEDIAN / 6_f64.sqrt()) as f32
}

/// Blocks whose mean absolute difference is beyond what noise explains, and that are not alone.
///
/// - `before`, `now`: `[C, H, W]`, of which the colours count
/// - `noise`: standard deviation of the noise in the images' difference
pub(super) fn changed_blocks(before: &Image, now: &Image, noise: f32, config: &GateConfig) -> Blocks {
    let (width, height) = (now.width, now.height);
    let mut blocks = Blocks::none(width, height);
    let limit = config.noise * noise + config.contrast;
    let mut sums = vec![0.0_f32; blocks.across];
    for band in 0..blocks.down {
        sums.fill(0.0);
        let rows = band * BLOCK..((band + 1) * BLOCK).min(height);
        for channel in 0..COLORS {
            let (before, now) = (before.plane(channel), now.plane(channel));
            for row in rows.clone() {
                let (before, now) = (&before[row * width..][..width], &now[row * width..][..width]);
                for (sum, (a, b)) in sums.iter_mut().zip(before.chunks(BLOCK).zip(now.chunks(BLOCK))) {
                    *sum += a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>();
                }
            }
        }
        for (column, sum) in sums.iter().enumerate() {
            let pixels = rows.len() * BLOCK.min(width - column * BLOCK) * COLORS;
            blocks.is_marked[band * blocks.across + column] = *sum > limit * pixels as f32;
        }
    }
    let supported = blocks.with_around(2);
    let is_marked = blocks.is_marked.iter().zip(&supported.is_marked).map(|(own, near)| *own && *near).collect();
    // One block more on each side: the edge of what moves is where the least changes.
    Blocks { is_marked, ..blocks }.with_around(1)
}

/// Mean absolute error of every tile of a picture.
///
/// - `picture`: `[C, H, W]`, of which the first three channels count, before `gain` and `offset`
/// - `target`: `[C, H, W]`, likewise
/// - `gain`, `offset`: the camera's; its image is `exp(gain) * picture + offset`
/// - returns: `[tiles]`
pub(super) fn tile_errors(picture: &Image, target: &Image, gain: [f32; 3], offset: [f32; 3]) -> Vec<f32> {
    let (width, height) = (target.width, target.height);
    let tiles = TileMask::none(width, height);
    let across = tiles.grid()[0];
    let mut sums = vec![0.0_f32; across * tiles.grid()[1]];
    for channel in 0..COLORS {
        let (factor, offset) = (gain[channel].exp(), offset[channel]);
        let (picture, target) = (picture.plane(channel), target.plane(channel));
        for row in 0..height {
            let (picture, target) = (&picture[row * width..][..width], &target[row * width..][..width]);
            let sums = &mut sums[row / TILE * across..][..across];
            for (sum, (a, b)) in sums.iter_mut().zip(picture.chunks(TILE).zip(target.chunks(TILE))) {
                *sum += a.iter().zip(b).map(|(a, b)| (factor * a + offset - b).abs()).sum::<f32>();
            }
        }
    }
    for (tile, sum) in sums.iter_mut().enumerate() {
        let [columns, rows] = tiles.pixels(tile, width, height);
        *sum /= (COLORS * columns.len() * rows.len()) as f32;
    }
    sums
}

/// The tiles that hold marked blocks.
pub(super) fn tiles_of(blocks: &Blocks, width: usize, height: usize) -> TileMask {
    let mut tiles = TileMask::none(width, height);
    for index in (0..blocks.is_marked.len()).filter(|&index| blocks.is_marked[index]) {
        let [x, y] = [index % blocks.across * BLOCK, index / blocks.across * BLOCK];
        tiles.insert_pixels(x..x + BLOCK, y..y + BLOCK);
    }
    tiles
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    const SIZE: [usize; 2] = [90, 70];

    /// A picture with edges and a gradient, rounded to 8 bits after noise was added.
    fn shot(seed: u64, sigma: f32, level: impl Fn(usize, usize) -> f32) -> Image {
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut image = Image::filled(SIZE[0], SIZE[1], 3, 0.0);
        for (i, value) in image.data.iter_mut().enumerate() {
            let (x, y) = (i % SIZE[0], i / SIZE[0] % SIZE[1]);
            // Twelve uniform numbers have a variance of 1 and add up to nearly a normal one.
            let normal = (0..12).map(|_| random.random_range(0.0..1.0_f32)).sum::<f32>() - 6.0;
            let exact = level(x, y) + sigma * normal;
            *value = (exact.clamp(0.0, 1.0) * 255.0).round() / 255.0;
        }
        image
    }

    fn wall(x: usize, y: usize) -> f32 {
        0.3 + 0.3 * f32::from(u8::from(x / 9 % 2 == y / 11 % 2)) + 0.002 * x as f32
    }

    #[test]
    fn noise_is_measured_and_changes_of_light_are_not_taken_for_it() {
        for sigma in [1.0, 2.0, 5.0] {
            let lit = |x: usize, y: usize| wall(x, y) * 1.3;
            for level in [&wall as &dyn Fn(usize, usize) -> f32, &lit] {
                let found = noise(&shot(1, sigma / 255.0, wall), &shot(2, sigma / 255.0, level)) * 255.0;
                let expected = sigma * 2_f32.sqrt();
                assert!((found / expected - 1.0).abs() < 0.25, "{found} of {expected}");
            }
        }
        assert_eq!(noise(&shot(1, 0.0, wall), &shot(2, 0.0, wall)), 0.0);
    }

    #[test]
    fn noise_marks_nothing_and_what_moves_is_marked_whole() {
        let config = GateConfig::ON;
        let sigma = 2.0 / 255.0;
        let moved = |x: usize, y: usize| {
            if (40..50).contains(&x) && (20..40).contains(&y) { 0.5 } else { wall(x, y) }
        };
        let (before, still) = (shot(1, sigma, wall), shot(2, sigma, wall));
        let level = noise(&before, &still);
        assert!(changed_blocks(&before, &still, level, &config).is_marked.iter().all(|marked| !marked));
        let blocks = changed_blocks(&before, &shot(3, sigma, moved), level, &config);
        for (x, y) in [(40, 20), (49, 39), (45, 30)] {
            assert!(blocks.at(x, y), "{x}, {y}");
        }
        assert!(!blocks.at(30, 30) && !blocks.at(45, 8) && !blocks.at(60, 30) && !blocks.at(45, 52));
        let tiles = tiles_of(&blocks, SIZE[0], SIZE[1]);
        assert_eq!(tiles.iter().collect::<Vec<_>>(), [8, 9, 14, 15], "of 6 a row");
    }

    #[test]
    fn errors_are_means_of_the_tiles_pixels() {
        let (picture, mut target) = (Image::filled(20, 17, 3, 0.25), Image::filled(20, 17, 3, 0.5));
        target.plane_mut(1)[16 * 20 + 19] = 1.5;
        let errors = tile_errors(&picture, &target, [2_f32.ln(); 3], [0.0; 3]);
        let expected = [0.0, 0.0, 0.0, 1.0 / 12.0];
        assert!(errors.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{errors:?}");
    }
}
