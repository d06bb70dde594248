//! `0.8 L1 + 0.2 (1 − SSIM)` on the colour image and on the segmentation image, with the camera's
//! gain and offset on the colours.

use std::ops::Range;

use multiversion::multiversion;
use rayon::prelude::*;
use tcgs_core::Image;
use tcgs_metrics::{ImagePair, SSIM_RADIUS};
use tcgs_render::{TILE, TileMask};

use crate::losses::{COUNTED_CHANNELS, L1_SHARE};

/// Fewest rows of pixels that one task handles.
const MIN_ROWS: usize = 16;

/// Values and gradients of the two image losses of one view.
#[derive(Clone, Copy, Debug, Default)]
pub struct ImageLoss {
    /// Loss of the colour image, before its weight.
    pub image: f64,
    /// Loss of the segmentation image, before its weight; 0 without segmentation.
    pub segmentation: f64,
    /// Gradient of the weighted sum with respect to the logarithm of the camera's gain.
    pub v_gain: [f32; 3],
    /// Gradient of the weighted sum with respect to the camera's offset.
    pub v_offset: [f32; 3],
}

/// Compares a rendered image with its target.
///
/// - `rendered`: `[C, H, W]`, of the target's shape, `C` 3 or 5
/// - `gain`, `offset`: the camera's; its image is `exp(gain) * rendered + offset`
/// - `image_weight`, `segmentation_weight`: of the two losses, in the gradients
/// - `v_image`: `[C, H, W]`, gradient of the weighted sum with respect to `rendered`; overwritten, of any shape before
pub fn image_loss(
    rendered: &Image,
    target: &Image,
    gain: [f32; 3],
    offset: [f32; 3],
    image_weight: f32,
    segmentation_weight: f32,
    v_image: &mut Image,
) -> ImageLoss {
    v_image.ensure_shape(rendered.shape());
    let comparison = Comparison::new(rendered, target, gain, offset, [image_weight, segmentation_weight]);
    let whole = [0..rendered.width, 0..rendered.height];
    comparison.losses(whole.clone(), whole, &mut v_image.data)
}

/// Compares some tiles of a rendered image with their target. The gradient in these tiles has the same bits as that of
/// [`image_loss`], which compares the whole image.
///
/// - `mask`: the tiles
/// - `v_image`: `[C, H, W]`, the gradient; of any shape before, overwritten in the tiles, undefined elsewhere
/// - returns: the two losses, as sums over the tiles and their surroundings divided by the pixels of the whole image;
///   the camera has no gradient
#[allow(clippy::too_many_arguments, reason = "the arguments of image_loss, and where")]
pub fn image_loss_in(
    rendered: &Image,
    target: &Image,
    mask: &TileMask,
    gain: [f32; 3],
    offset: [f32; 3],
    image_weight: f32,
    segmentation_weight: f32,
    v_image: &mut Image,
) -> ImageLoss {
    let (width, height) = (rendered.width, rendered.height);
    v_image.ensure_shape(rendered.shape());
    let comparison = Comparison::new(rendered, target, gain, offset, [image_weight, segmentation_weight]);
    // A gradient depends on the map's values within a window's radius, and these on pixels within another.
    const HALO: usize = 2 * SSIM_RADIUS;
    let widened = |range: Range<usize>, end: usize| range.start.saturating_sub(HALO)..(range.end + HALO).min(end);
    // Small rectangles have too little work for all threads, so they are computed beside one another.
    let losses: Vec<_> = rectangles(mask, 2 * HALO)
        .into_par_iter()
        .map(|[columns, rows]| {
            let columns = columns.start * TILE..(columns.end * TILE).min(width);
            let rows = rows.start * TILE..(rows.end * TILE).min(height);
            let window = [widened(columns.clone(), width), widened(rows.clone(), height)];
            let share = (window[0].len() * window[1].len()) as f64 / rendered.num_pixels() as f64;
            let mut v_part = Image::filled(columns.len(), rows.len(), rendered.num_channels, 0.0);
            let loss = comparison.losses(window, [columns.clone(), rows.clone()], &mut v_part.data);
            (share, loss, [columns, rows], v_part)
        })
        .collect();
    let mut sum = ImageLoss::default();
    for (share, loss, [columns, rows], v_part) in losses {
        for channel in 0..rendered.num_channels {
            let to = v_image.plane_mut(channel).chunks_exact_mut(width).skip(rows.start);
            for (from, to) in v_part.plane(channel).chunks_exact(columns.len()).zip(to) {
                to[columns.clone()].copy_from_slice(from);
            }
        }
        sum.image += share * loss.image;
        sum.segmentation += share * loss.segmentation;
    }
    sum
}

/// Rectangles of tiles that do not overlap and together hold the tiles of a set: columns and rows, in tiles. Cut where
/// two smaller ones with a border are less to compute than one.
///
/// - `border`: pixels by which each rectangle is wider and higher when it is computed
fn rectangles(mask: &TileMask, border: usize) -> Vec<[Range<usize>; 2]> {
    fn bounds(mask: &TileMask, [columns, rows]: [Range<usize>; 2]) -> Option<[Range<usize>; 2]> {
        let mut found: Option<[Range<usize>; 2]> = None;
        for row in rows {
            for column in columns.clone().filter(|column| mask.contains(row * mask.grid()[0] + column)) {
                let [columns, rows] = found.unwrap_or([column..column, row..row]);
                found =
                    Some([columns.start.min(column)..columns.end.max(column + 1), rows.start..rows.end.max(row + 1)]);
            }
        }
        found
    }
    let cost = |[columns, rows]: &[Range<usize>; 2]| (columns.len() * TILE + border) * (rows.len() * TILE + border);
    let mut open: Vec<_> = bounds(mask, [0..mask.grid()[0], 0..mask.grid()[1]]).into_iter().collect();
    let mut done = Vec::new();
    while let Some(rectangle) = open.pop() {
        let [columns, rows] = rectangle.clone();
        let left_and_right = (columns.start + 1..columns.end)
            .map(|at| [[columns.start..at, rows.clone()], [at..columns.end, rows.clone()]]);
        let above_and_below =
            (rows.start + 1..rows.end).map(|at| [[columns.clone(), rows.start..at], [columns.clone(), at..rows.end]]);
        let halves = left_and_right.chain(above_and_below).filter_map(|[first, second]| {
            let halves = [bounds(mask, first)?, bounds(mask, second)?];
            Some((cost(&halves[0]) + cost(&halves[1]), halves))
        });
        match halves.min_by_key(|(cost, _)| *cost) {
            Some((both, halves)) if both < cost(&rectangle) => open.extend(halves),
            _ => done.push(rectangle),
        }
    }
    done
}

/// Two images to compare, and how.
struct Comparison<'a> {
    rendered: &'a Image,
    target: &'a Image,
    /// `[C]` the camera's factors and offsets: of the colours, then of segmentation.
    correction: Vec<[f32; 2]>,
    /// `[C]` weights of the losses, in the gradients.
    weights: Vec<f32>,
}

impl<'a> Comparison<'a> {
    /// - `weights`: of the colour image and of the segmentation image, in the gradients
    fn new(rendered: &'a Image, target: &'a Image, gain: [f32; 3], offset: [f32; 3], weights: [f32; 2]) -> Self {
        let channels = 0..rendered.num_channels;
        let correction = |c: usize| if c < 3 { [gain[c].exp(), offset[c]] } else { [1.0, 0.0] };
        let weight = |c: usize| weights[usize::from(c >= 3)];
        Self {
            rendered,
            target,
            correction: channels.clone().map(correction).collect(),
            weights: channels.map(weight).collect(),
        }
    }

    /// - `window`: columns and rows that are compared, as if there were no others
    /// - `part`: columns and rows among them where the gradient is wanted
    /// - `v_part`: `[C, rows, columns]`, the gradient; overwritten
    /// - returns: means over the window; the camera has a gradient only if the part is the window
    fn losses(&self, window: [Range<usize>; 2], part: [Range<usize>; 2], v_part: &mut [f32]) -> ImageLoss {
        let (channels, counted) = (self.rendered.num_channels, self.rendered.num_pixels() as f32);
        let is_whole = window == part;
        let [columns, rows] = window;
        let pair = ImagePair::new(self.rendered, self.target)
            .corrected(&self.correction)
            .within(columns.clone(), rows.clone());
        let v_map: Vec<f32> = self.weights.iter().map(|w| -(1.0 - L1_SHARE) * w / COUNTED_CHANNELS / counted).collect();
        let [part_columns, part_rows] = part;
        let part_columns = part_columns.start - columns.start..part_columns.end - columns.start;
        let part_rows = part_rows.start - rows.start..part_rows.end - rows.start;
        // L1, and the colours' correction taken back, row by row.
        let finish = |channel: usize, row: usize, v_row: &mut [f32]| {
            let [raw, target] = pair.row(channel, part_rows.start + row).map(|row| &row[part_columns.clone()]);
            let slope = L1_SHARE * self.weights[channel] / (COUNTED_CHANNELS * counted);
            row_bwd(raw, target, self.correction[channel], slope, v_row)
        };
        let (ssim, mut parts) = pair.ssim_grad(&v_map, [part_columns.clone(), part_rows.clone()], v_part, finish);
        if !is_whole {
            // The losses count the surroundings, too.
            let of = |row: usize| {
                let (channel, row) = (row / rows.len(), row % rows.len());
                let [raw, target] = pair.row(channel, row);
                [row_l1(raw, target, self.correction[channel]), 0.0, 0.0]
            };
            parts = (0..channels * rows.len()).into_par_iter().with_min_len(MIN_ROWS).map(of).collect();
        }
        let sums: Vec<[f64; 3]> = parts
            .chunks(rows.len())
            .map(|rows| rows.iter().fold([0.0; 3], |sum, part| std::array::from_fn(|i| sum[i] + part[i])))
            .collect();

        let pixels = (columns.len() * rows.len()) as f64;
        let loss = |range: Range<usize>| {
            let l1: f64 =
                sums[range.clone()].iter().map(|s| s[0]).sum::<f64>() / (f64::from(COUNTED_CHANNELS) * pixels);
            // A channel that is not rendered is zero in both images and has an SSIM of 1.
            let unseen = f64::from(COUNTED_CHANNELS) - range.len() as f64;
            let ssim = (ssim[range].iter().sum::<f64>() + unseen) / f64::from(COUNTED_CHANNELS);
            f64::from(L1_SHARE) * l1 + f64::from(1.0 - L1_SHARE) * (1.0 - ssim)
        };
        ImageLoss {
            image: loss(0..3),
            segmentation: if channels > 3 { loss(3..channels) } else { 0.0 },
            v_gain: std::array::from_fn(|c| sums[c][1] as f32),
            v_offset: std::array::from_fn(|c| sums[c][2] as f32),
        }
    }
}

/// Lanes of sums over a row.
const LANES: usize = 8;

/// L1 of one row of one channel, and its part of the gradient. *Accumulates* into `v_row`, then multiplies it by the
/// camera's factor.
///
/// - `raw`, `target`: `[W]`, the rendered image and the target
/// - `correction`: the camera's factor and offset
/// - returns: sums of `|factor raw + offset − target|`, of the gradient to the factor's logarithm, and of that to the
///   offset
#[multiversion(targets("x86_64+avx2"))]
fn row_bwd(raw: &[f32], target: &[f32], [factor, offset]: [f32; 2], slope: f32, v_row: &mut [f32]) -> [f64; 3] {
    let mut sums = [[0.0_f64; LANES]; 3];
    let mut add = |l: usize, raw: f32, target: f32, v: &mut f32| {
        let difference = (factor * raw + offset) - target;
        let sign = if difference > 0.0 { slope } else { 0.0 };
        let sign = if difference < 0.0 { -slope } else { sign };
        let v_corrected = *v + sign;
        *v = v_corrected * factor;
        sums[0][l] += f64::from(difference.abs());
        sums[1][l] += f64::from(*v * raw);
        sums[2][l] += f64::from(v_corrected);
    };
    let ((raw, raw_rest), (target, target_rest)) = (raw.as_chunks(), target.as_chunks());
    let (v, v_rest) = v_row.as_chunks_mut::<LANES>();
    let eights: [&[[f32; LANES]]; 2] = [raw, target];
    for (i, v) in v.iter_mut().enumerate() {
        let [raw, target] = eights.map(|rows| &rows[i]);
        for l in 0..LANES {
            add(l, raw[l], target[l], &mut v[l]);
        }
    }
    for (l, v) in v_rest.iter_mut().enumerate() {
        add(l, raw_rest[l], target_rest[l], v);
    }
    sums.map(|lanes| lanes.iter().sum())
}

/// The first sum of [`row_bwd`], to the bit.
#[multiversion(targets("x86_64+avx2"))]
fn row_l1(raw: &[f32], target: &[f32], [factor, offset]: [f32; 2]) -> f64 {
    let mut sums = [0.0_f64; LANES];
    let mut add = |l: usize, raw: f32, target: f32| sums[l] += f64::from(((factor * raw + offset) - target).abs());
    let ((raw, raw_rest), (target, target_rest)) = (raw.as_chunks::<LANES>(), target.as_chunks::<LANES>());
    for (raw, target) in raw.iter().zip(target) {
        for l in 0..LANES {
            add(l, raw[l], target[l]);
        }
    }
    for (l, (&raw, &target)) in raw_rest.iter().zip(target_rest).enumerate() {
        add(l, raw, target);
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(channels: usize, phase: f32) -> Image {
        let mut image = Image::filled(23, 17, channels, 0.0);
        for (i, v) in image.data.iter_mut().enumerate() {
            *v = 0.5 + 0.4 * (i as f32 * 0.13 + phase).sin() * (i as f32 * 0.031).cos();
        }
        image
    }

    #[test]
    fn gradients_match_central_differences() {
        let (rendered, target) = (pattern(5, 0.3), pattern(5, 0.0));
        let (gain, offset) = ([0.1, -0.2, 0.05], [0.02, 0.0, -0.03]);
        let at = |rendered: &Image, gain, offset| {
            let l = image_loss(rendered, &target, gain, offset, 1.0, 3.0, &mut Image::default());
            l.image + 3.0 * l.segmentation
        };
        let mut v_image = Image::default();
        let loss = image_loss(&rendered, &target, gain, offset, 1.0, 3.0, &mut v_image);
        // Large steps, since the loss is summed from f32: SSIM is smooth and L1 is linear.
        let h = 2e-2;
        for i in (0..rendered.data.len()).step_by(97) {
            let moved = |d: f32| {
                let mut image = rendered.clone();
                image.data[i] += d;
                at(&image, gain, offset)
            };
            if (rendered.data[i] - target.data[i]).abs() < 3.0 * h {
                continue; // the kink of L1
            }
            let difference = (moved(h) - moved(-h)) / (2.0 * f64::from(h));
            let found = f64::from(v_image.data[i]);
            assert!((difference - found).abs() < 0.02 * difference.abs() + 2e-5, "{i}: {difference} against {found}");
        }
        for c in 0..3 {
            let move_by = |d: f32, base: [f32; 3]| {
                let mut x = base;
                x[c] += d;
                x
            };
            let h = 1e-3;
            let along_gain = (at(&rendered, move_by(h, gain), offset) - at(&rendered, move_by(-h, gain), offset))
                / (2.0 * f64::from(h));
            let along_offset = (at(&rendered, gain, move_by(h, offset)) - at(&rendered, gain, move_by(-h, offset)))
                / (2.0 * f64::from(h));
            assert!((along_gain - f64::from(loss.v_gain[c])).abs() < 0.02 * along_gain.abs() + 1e-4);
            assert!((along_offset - f64::from(loss.v_offset[c])).abs() < 0.02 * along_offset.abs() + 1e-4);
        }
    }

    /// Tile patterns as a gate produces them: a few tiles, apart and together, and at the edges.
    fn some_tiles(width: usize, height: usize) -> TileMask {
        let mut mask = TileMask::none(width, height);
        for (x, y) in [(0, 0), (40, 20), (56, 20), (40, 36), (119, 90), (70, 70)] {
            mask.insert_pixels(x..x + 1, y..y + 1);
        }
        mask
    }

    #[test]
    fn some_tiles_have_the_gradient_of_the_whole_image_to_the_bit() {
        let wide = |phase: f32| {
            let mut image = Image::filled(120, 91, 5, 0.0);
            image.data.iter_mut().enumerate().for_each(|(i, v)| *v = 0.5 + 0.4 * (i as f32 * 0.13 + phase).sin());
            image
        };
        let (rendered, target) = (wide(0.4), wide(0.0));
        let (gain, offset) = ([0.1, -0.2, 0.05], [0.02, 0.0, -0.03]);
        let mut v_whole = Image::filled(120, 91, 5, f32::NAN);
        let whole = image_loss(&rendered, &target, gain, offset, 1.0, 3.0, &mut v_whole);
        for mask in [some_tiles(120, 91), TileMask::all(120, 91)] {
            let mut v_image = Image::filled(120, 91, 5, f32::NAN);
            let loss = image_loss_in(&rendered, &target, &mask, gain, offset, 1.0, 3.0, &mut v_image);
            for tile in mask.iter() {
                let [columns, rows] = mask.pixels(tile, 120, 91);
                let cut = |image: &Image| image.crop(columns.clone(), rows.clone());
                assert_eq!(cut(&v_image), cut(&v_whole), "tile {tile}");
            }
            if mask == TileMask::all(120, 91) {
                assert!(
                    (loss.image - whole.image).abs() < 1e-9 && (loss.segmentation - whole.segmentation).abs() < 1e-9
                );
            }
        }
    }

    #[test]
    fn rectangles_hold_every_tile_once_and_are_cut_where_that_pays() {
        let mask = some_tiles(200, 120);
        let found = rectangles(&mask, 20);
        let holds = |tile: usize, [columns, rows]: &[Range<usize>; 2]| {
            columns.contains(&(tile % mask.grid()[0])) && rows.contains(&(tile / mask.grid()[0]))
        };
        for tile in mask.iter() {
            assert_eq!(found.iter().filter(|rectangle| holds(tile, rectangle)).count(), 1, "tile {tile}");
        }
        assert_eq!((found.len(), rectangles(&TileMask::all(200, 120), 20).len()), (4, 1));
        assert!(rectangles(&TileMask::none(200, 120), 20).is_empty());
    }

    #[test]
    fn the_unrendered_channel_counts_in_the_means() {
        let (mut rendered, mut target) = (Image::filled(16, 16, 5, 0.0), Image::filled(16, 16, 5, 0.0));
        rendered.plane_mut(3).fill(0.5);
        target.plane_mut(3).fill(0.25);
        let mut v_image = Image::default();
        let loss = image_loss(&rendered, &target, [0.0; 3], [0.0; 3], 1.0, 3.0, &mut v_image);
        let three = image_loss(
            &Image {
                num_channels: 3,
                data: [rendered.plane(3), rendered.plane(0), rendered.plane(4)].concat(),
                ..rendered
            },
            &Image { num_channels: 3, data: [target.plane(3), target.plane(0), target.plane(4)].concat(), ..target },
            [0.0; 3],
            [0.0; 3],
            1.0,
            3.0,
            &mut v_image,
        );
        assert!((loss.segmentation - three.image).abs() < 1e-6 && loss.segmentation > 0.05);
    }
}
