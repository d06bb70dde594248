//! Evidence that something changed in a view from one timestep to the next: differences of images beyond the camera's
//! noise, and errors of the scene's picture that have grown.
//!
//! The noise level is measured in the same blocks: the median difference plus some robust standard deviations. It is
//! the median over nine timesteps, so that one flash does not count as noise. Grown errors reveal slow drifts, which no
//! difference of two images shows. If training could not lower an error, the gate accepts a quarter of it in each
//! timestep.

use std::ops::Range;

use tcgs_core::{Image, upper_median};
use tcgs_render::{TILE, TileMask};

/// Channels of an image that are its colours.
const COLORS: usize = 3;
/// Side in pixels of the blocks whose difference is averaged against noise.
const BLOCK: usize = 4;
/// Standard deviation of a normal variable whose median absolute deviation is 1.
const NORMAL_DEVIATION: f32 = 1.4826;

/// A block has changed if its difference exceeds the median of all blocks of the view by so many robust standard
/// deviations, and by [`CONTRAST`].
pub(crate) const NOISE_DEVIATIONS: f32 = 6.0;
/// Least difference beyond the noise level that is a change, in units of colour: one and a half of 255 levels.
pub(crate) const CONTRAST: f32 = 0.006;

/// Blocks of an image, of [`BLOCK`] pixels a side; those at the right and lower edge may be cut.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Blocks {
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

    /// The first pixel of a block.
    pub fn pixel(&self, index: usize) -> [usize; 2] {
        [index % self.across * BLOCK, index / self.across * BLOCK]
    }

    /// The blocks that are marked in both.
    pub fn and(mut self, other: &Self) -> Self {
        self.is_marked.iter_mut().zip(&other.is_marked).for_each(|(own, other)| *own &= other);
        self
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
    pub fn with_around(&self, count: usize) -> Self {
        let is_marked = (0..self.is_marked.len()).map(|index| self.around(index) >= count).collect();
        Self { is_marked, ..*self }
    }
}

/// Mean absolute difference of two images in each block.
///
/// - `before`, `now`: `[C, H, W]`, of which the colours count
/// - returns: `[blocks]`, row by row
pub(super) fn differences(before: &Image, now: &Image) -> Vec<f32> {
    let (width, height) = (now.width, now.height);
    let across = width.div_ceil(BLOCK);
    let mut means = vec![0.0_f32; across * height.div_ceil(BLOCK)];
    for (band, means) in means.chunks_exact_mut(across).enumerate() {
        let rows = band * BLOCK..((band + 1) * BLOCK).min(height);
        for channel in 0..COLORS {
            let (before, now) = (before.plane(channel), now.plane(channel));
            for row in rows.clone() {
                let (before, now) = (&before[row * width..][..width], &now[row * width..][..width]);
                for (mean, (a, b)) in means.iter_mut().zip(before.chunks(BLOCK).zip(now.chunks(BLOCK))) {
                    *mean += a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>();
                }
            }
        }
        for (column, mean) in means.iter_mut().enumerate() {
            *mean /= (COLORS * rows.len() * BLOCK.min(width - column * BLOCK)) as f32;
        }
    }
    means
}

/// The difference up to which noise explains a block: the median over the blocks plus [`NOISE_DEVIATIONS`] robust
/// standard deviations. Moving content covers fewer than half of the blocks; noise of cameras and of video compression
/// is in all.
///
/// - `differences`: of the blocks of one view
pub(super) fn noise_level(differences: &[f32]) -> f32 {
    let middle = upper_median(differences.iter().copied()).unwrap_or_default();
    let distance = upper_median(differences.iter().map(|difference| (difference - middle).abs()));
    middle + NOISE_DEVIATIONS * NORMAL_DEVIATION * distance.unwrap_or_default()
}

/// Blocks that differ by more than a limit and are not alone, and those around them.
///
/// - `differences`: of the blocks of an image of `width` x `height` pixels
pub(super) fn changed_blocks(differences: &[f32], limit: f32, width: usize, height: usize) -> Blocks {
    let all = Blocks::none(width, height);
    let blocks = Blocks { is_marked: differences.iter().map(|difference| *difference > limit).collect(), ..all };
    let supported = blocks.with_around(2);
    let is_marked = blocks.is_marked.iter().zip(&supported.is_marked).map(|(own, near)| *own && *near).collect();
    // One more block on each side: the edge of a moving object changes least.
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
pub(crate) fn tiles_of(blocks: &Blocks, width: usize, height: usize) -> TileMask {
    let mut tiles = TileMask::none(width, height);
    for index in (0..blocks.is_marked.len()).filter(|&index| blocks.is_marked[index]) {
        let [x, y] = blocks.pixel(index);
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
    fn noise_marks_nothing_and_what_moves_is_marked_whole() {
        let moved = |x: usize, y: usize| {
            if (40..50).contains(&x) && (20..40).contains(&y) { 0.5 } else { wall(x, y) }
        };
        for sigma in [0.0, 1.0, 2.0, 5.0].map(|levels| levels / 255.0) {
            let before = shot(1, sigma, wall);
            let marked = |now: &Image| {
                let differences = differences(&before, now);
                let limit = noise_level(&differences) + CONTRAST;
                changed_blocks(&differences, limit, SIZE[0], SIZE[1])
            };
            assert!(marked(&shot(2, sigma, wall)).is_marked.iter().all(|marked| !marked), "noise of {sigma}");
            let blocks = marked(&shot(3, sigma, moved));
            for (x, y) in [(40, 20), (49, 39), (45, 30)] {
                assert!(blocks.at(x, y), "{x}, {y} with noise of {sigma}");
            }
            assert!(!blocks.at(30, 30) && !blocks.at(45, 8) && !blocks.at(60, 30) && !blocks.at(45, 52));
            let tiles = tiles_of(&blocks, SIZE[0], SIZE[1]);
            assert_eq!(tiles.iter().collect::<Vec<_>>(), [8, 9, 14, 15], "of 6 a row");
        }
    }

    #[test]
    fn the_level_of_noise_lies_above_nearly_all_blocks_and_is_not_moved_by_a_few() {
        let sigma = 3.0 / 255.0;
        let before = shot(1, sigma, wall);
        let still = noise_level(&differences(&before, &shot(2, sigma, wall)));
        // Blocks of two images with noise differ by 2/√π of its deviation in the mean.
        assert!(still > 1.13 * sigma && still < 2.5 * sigma, "{still} for {sigma}");
        let moved = |x: usize, y: usize| if x < 30 { 1.0 - wall(x, y) } else { wall(x, y) };
        let with_motion = noise_level(&differences(&before, &shot(2, sigma, moved)));
        assert!(with_motion < 2.0 * still, "{with_motion} against {still}");
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
