//! Structural similarity (Wang et al. 2004), forward and backward.
//!
//! Window: Gaussian, 11x11, sigma 1.5; zeros beyond the edge; C1 = 0.01², C2 = 0.03². With `G` the
//! window and `x`, `y` the rendered image and the target, for every channel:
//!
//! ```text
//! mean_x = G*x   mean_y = G*y   square_x = G*x²   square_y = G*y²   product = G*xy
//! variance_x = square_x - mean_x²   …   covariance = product - mean_x mean_y
//! ssim = (2 mean_x mean_y + C1)(2 covariance + C2) / ((mean_x² + mean_y² + C1)(variance_x + variance_y + C2))
//! ```
//!
//! It runs in every training iteration, so:
//! 1. the window is separable: rows first, then columns, six products a value since it is symmetric;
//! 2. work is cut into strips of rows of one channel, each filtering the rows it needs into a scratch
//!    that stays in the cache; strips do not depend on the number of threads, so neither do the results;
//! 3. the forward pass keeps the map's three derivatives rather than its statistics: the backward pass
//!    is then three filters;
//! 4. loops run on slices of equal length, compiled for AVX2 where the machine has it, and never
//!    contracted to fused multiply-adds: all machines give the same bits.

use multiversion::multiversion;
use rayon::prelude::*;
use tcgs_core::Image;

use crate::assert_same_shape;

/// `C1 = (0.01 L)²` of Wang et al. 2004 for values of range `L = 1`.
pub const SSIM_C1: f32 = 0.01 * 0.01;

/// `C2 = (0.03 L)²` of Wang et al. 2004 for values of range `L = 1`.
pub const SSIM_C2: f32 = 0.03 * 0.03;

/// Pixels on each side of the window's centre: a pixel's value of the map depends on those no farther away along either
/// axis, and so does its gradient on those no farther than twice as many.
pub const SSIM_RADIUS: usize = 5;
const RADIUS: usize = SSIM_RADIUS;

/// Pixels on a side of the window.
pub(crate) const WINDOW_SIZE: usize = 2 * RADIUS + 1;

/// Weights of the window along one axis: `exp(-d² / (2 * 1.5²))` over the sum of all eleven, for distances `d = 0..=5`
/// in pixels, which is the centre and one side.
pub const SSIM_WINDOW: [f32; RADIUS + 1] =
    [0.266_011_72, 0.213_005_54, 0.109_360_69, 0.036_000_773, 0.007_598_758, 0.001_028_380_1];

/// Rows of a strip. Ten more are filtered to either side: a third more work along rows, for a
/// scratch that fits the cache and strips enough for many cores.
const STRIP_ROWS: usize = 32;

/// What [`ssim_fwd`] keeps for [`ssim_bwd`]: three values a value of the image.
#[derive(Clone, Debug, Default)]
pub struct SsimSaved {
    /// `[C, H, 3, W]` derivatives of the map to `mean_x`, `square_x` and `product`.
    partials: Vec<f32>,
}

/// SSIM, averaged over pixels, then channels.
///
/// - `rendered`, `target`: `[C, H, W]`, of any size, not clamped
///
/// ```
/// let image = tcgs_core::Image::filled(20, 4, 3, 0.5);
/// assert!((tcgs_metrics::ssim(&image, &image) - 1.0).abs() < 1e-6);
/// ```
///
/// # Panics
/// If the images differ in shape or have no values.
pub fn ssim(rendered: &Image, target: &Image) -> f64 {
    let means = ssim_fwd(rendered, target).0;
    means.iter().sum::<f64>() / means.len() as f64
}

/// SSIM of each channel, averaged over its pixels.
///
/// - `rendered`, `target`: `[C, H, W]`, of any size, not clamped
/// - returns: `[C]`, and what [`ssim_bwd`] needs
///
/// ```
/// use tcgs_core::Image;
/// use tcgs_metrics::{ssim_bwd, ssim_fwd};
/// let (rendered, target) = (Image::filled(12, 12, 1, 0.4), Image::filled(12, 12, 1, 0.5));
/// let (means, saved) = ssim_fwd(&rendered, &target);
/// let mut v_rendered = Image::filled(12, 12, 1, 0.0);
/// ssim_bwd(&rendered, &target, &saved, &[1.0], &mut v_rendered);
/// assert!(means[0] < 1.0 && v_rendered.plane(0)[6 * 12 + 6] > 0.0, "brighter would be more similar");
/// ```
///
/// # Panics
/// If the images differ in shape or have no values.
pub fn ssim_fwd(rendered: &Image, target: &Image) -> (Vec<f64>, SsimSaved) {
    assert_same_shape(rendered, target);
    assert!(!rendered.data.is_empty(), "ssim of an image without values");
    let (width, num_pixels) = (rendered.width, rendered.num_pixels());
    let mut partials = vec![0.0; 3 * rendered.data.len()];
    let sums: Vec<f64> = strips(&mut partials, 3 * num_pixels, 3 * width)
        .into_par_iter()
        .map(|(channel, first_row, out)| {
            strip_fwd(width, first_row, rendered.plane(channel), target.plane(channel), out)
        })
        .collect();
    let strips_per_channel = rendered.height.div_ceil(STRIP_ROWS);
    let means = sums.chunks(strips_per_channel).map(|sums| sums.iter().sum::<f64>() / num_pixels as f64).collect();
    (means, SsimSaved { partials })
}

/// Backward of [`ssim_fwd`]. *Accumulates* into `v_rendered`.
///
/// - `saved`: of the same images
/// - `v_ssim`: `[C]`, gradient to each channel's mean
/// - `v_rendered`: `[C, H, W]`, gradient to `rendered`
///
/// # Panics
/// If shapes disagree.
pub fn ssim_bwd(rendered: &Image, target: &Image, saved: &SsimSaved, v_ssim: &[f32], v_rendered: &mut Image) {
    let v_map: Vec<f32> = v_ssim.iter().map(|v| v / rendered.num_pixels() as f32).collect();
    ssim_map_bwd(rendered, target, saved, &v_map, v_rendered);
}

/// Backward of the map of [`ssim_fwd`] before its mean is taken, for images that are cut from larger ones. *Accumulates*
/// into `v_rendered`.
///
/// - `saved`: of the same images
/// - `v_map`: `[C]`, gradient to the map, the same at every pixel of a channel
/// - `v_rendered`: `[C, H, W]`, gradient to `rendered`
///
/// # Panics
/// If shapes disagree.
pub fn ssim_map_bwd(rendered: &Image, target: &Image, saved: &SsimSaved, v_map: &[f32], v_rendered: &mut Image) {
    assert_same_shape(rendered, target);
    assert_same_shape(rendered, v_rendered);
    assert_eq!(v_map.len(), rendered.num_channels, "a gradient of [{}] against [C]", v_map.len());
    assert_eq!(saved.partials.len(), 3 * rendered.data.len(), "saved for [C, H, 3, W] of another image");
    let (width, num_pixels) = (rendered.width, rendered.num_pixels());
    strips(&mut v_rendered.data, num_pixels, width).into_par_iter().for_each(|(channel, first_row, v_rows)| {
        let partials = &saved.partials[3 * num_pixels * channel..][..3 * num_pixels];
        strip_bwd(width, first_row, rendered.plane(channel), target.plane(channel), partials, v_map[channel], v_rows);
    });
}

/// The map and its second factor, `(2 covariance + C2) / (variance_x + variance_y + C2)`, averaged over the pixels whose
/// window lies inside the image; for each channel.
///
/// # Panics
/// If the images differ in shape or have no such pixels.
pub(crate) fn inner_means(rendered: &Image, target: &Image) -> Vec<(f64, f64)> {
    assert_same_shape(rendered, target);
    let (width, height) = (rendered.width, rendered.height);
    assert!(width.min(height) >= WINDOW_SIZE, "a window inside of {width}x{height} pixels");
    let inner_rows = RADIUS..height - RADIUS;
    let num_pixels = (inner_rows.len() * (width - 2 * RADIUS)) as f64;
    let means = (0..rendered.num_channels).map(|channel| {
        let strips: Vec<(f64, f64)> = (inner_rows.clone().into_par_iter().step_by(STRIP_ROWS))
            .map(|first_row| {
                let num_rows = STRIP_ROWS.min(inner_rows.end - first_row);
                inner_sums(width, first_row, num_rows, rendered.plane(channel), target.plane(channel))
            })
            .collect();
        let sum = strips.into_iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        (sum.0 / num_pixels, sum.1 / num_pixels)
    });
    means.collect()
}

/// Cuts `[C, H, row_len]` into strips: channel, first row, values.
fn strips(data: &mut [f32], channel_len: usize, row_len: usize) -> Vec<(usize, usize, &mut [f32])> {
    let channels = data.chunks_mut(channel_len).enumerate();
    channels
        .flat_map(|(channel, plane)| {
            let strips = plane.chunks_mut(STRIP_ROWS * row_len).enumerate();
            strips.map(move |(i, strip)| (channel, i * STRIP_ROWS, strip))
        })
        .collect()
}

/// Fills the derivatives of one strip and returns the map's sum over it.
///
/// - `x`, `y`: `[H, W]`, rendered and target
/// - `partials`: `[rows, 3, W]`
#[multiversion(targets("x86_64+avx2"))]
fn strip_fwd(width: usize, first_row: usize, x: &[f32], y: &[f32], partials: &mut [f32]) -> f64 {
    let filtered = filter_moments(width, first_row, partials.len() / (3 * width), x, y);
    let mut stats = vec![0.0; 5 * width];
    let mut sum = 0.0;
    for (row, out) in partials.chunks_exact_mut(3 * width).enumerate() {
        filter_columns::<5>(width, row, &filtered, &mut stats);
        sum += row_fwd(width, &stats, out);
    }
    sum
}

/// Sums of the map and of its second factor over the inner pixels of some rows.
///
/// - `x`, `y`: `[H, W]`, rendered and target
#[multiversion(targets("x86_64+avx2"))]
fn inner_sums(width: usize, first_row: usize, num_rows: usize, x: &[f32], y: &[f32]) -> (f64, f64) {
    let filtered = filter_moments(width, first_row, num_rows, x, y);
    let mut stats = vec![0.0; 5 * width];
    let (mut whole, mut structure) = (0.0, 0.0);
    for row in 0..num_rows {
        filter_columns::<5>(width, row, &filtered, &mut stats);
        let [mean_x, mean_y, square_x, square_y, product] = split::<5>(width, &stats);
        for i in RADIUS..width - RADIUS {
            let (x, y) = (mean_x[i], mean_y[i]);
            let variances = (square_x[i] - x * x) + (square_y[i] - y * y);
            let similarity = (2.0 * (product[i] - x * y) + SSIM_C2) / (variances + SSIM_C2);
            whole += f64::from((2.0 * x * y + SSIM_C1) / (x * x + y * y + SSIM_C1) * similarity);
            structure += f64::from(similarity);
        }
    }
    (whole, structure)
}

/// Both images, their squares and their product, filtered along the rows that a strip needs: [`filter_rows`].
#[inline(always)]
fn filter_moments(width: usize, first_row: usize, num_rows: usize, x: &[f32], y: &[f32]) -> Vec<f32> {
    filter_rows::<5>(width, first_row, num_rows, x.len() / width, |row, padded| {
        let (x, y) = (&x[row * width..][..width], &y[row * width..][..width]);
        let [px, py, pxx, pyy, pxy] = padded;
        for i in 0..width {
            (px[i], py[i]) = (x[i], y[i]);
            (pxx[i], pyy[i], pxy[i]) = (x[i] * x[i], y[i] * y[i], x[i] * y[i]);
        }
    })
}

/// The formula, from filtered statistics, over one row.
///
/// - `stats`: `[5, W]`
/// - `partials`: `[3, W]`
#[inline(always)]
fn row_fwd(width: usize, stats: &[f32], partials: &mut [f32]) -> f64 {
    let [mean_x, mean_y, square_x, square_y, product] = split::<5>(width, stats);
    let (v_mean, rest) = partials.split_at_mut(width);
    let (v_square, v_product) = rest.split_at_mut(width);
    let (v_square, v_product) = (&mut v_square[..width], &mut v_product[..width]);
    let mut sum = 0.0;
    for i in 0..width {
        let (x, y) = (mean_x[i], mean_y[i]);
        let covariance = product[i] - x * y;
        let variances = (square_x[i] - x * x) + (square_y[i] - y * y);
        let (a1, a2) = (2.0 * x * y + SSIM_C1, 2.0 * covariance + SSIM_C2);
        let (b1, b2) = (x * x + y * y + SSIM_C1, variances + SSIM_C2);
        let (inverse_b1, inverse_b2) = (1.0 / b1, 1.0 / b2);
        let inverse = inverse_b1 * inverse_b2;
        let ssim = a1 * a2 * inverse;
        // With the squares and the product held fixed, the mean acts on the variance and covariance too.
        v_mean[i] = 2.0 * (y * (a2 - a1) * inverse - x * ssim * (inverse_b1 - inverse_b2));
        v_square[i] = -ssim * inverse_b2;
        v_product[i] = 2.0 * a1 * inverse;
        sum += f64::from(ssim);
    }
    sum
}

/// Adds one strip's gradient: `G*v_mean + 2 x (G*v_square) + y (G*v_product)`, the window being its own transpose.
///
/// - `partials`: `[H, 3, W]`
/// - `v_rows`: `[rows, W]`
#[multiversion(targets("x86_64+avx2"))]
fn strip_bwd(width: usize, first_row: usize, x: &[f32], y: &[f32], partials: &[f32], v_map: f32, v_rows: &mut [f32]) {
    let num_rows = v_rows.len() / width;
    let filtered = filter_rows::<3>(width, first_row, num_rows, x.len() / width, |row, padded| {
        let rows = split::<3>(width, &partials[row * 3 * width..][..3 * width]);
        for (padded, row) in padded.into_iter().zip(rows) {
            padded.copy_from_slice(row);
        }
    });
    let mut stats = vec![0.0; 3 * width];
    for (row, v_row) in v_rows.chunks_exact_mut(width).enumerate() {
        filter_columns::<3>(width, row, &filtered, &mut stats);
        let [v_mean, v_square, v_product] = split::<3>(width, &stats);
        let start = (first_row + row) * width;
        let (x, y) = (&x[start..][..width], &y[start..][..width]);
        for i in 0..width {
            v_row[i] += v_map * (v_mean[i] + 2.0 * x[i] * v_square[i] + y[i] * v_product[i]);
        }
    }
}

/// Filters `K` quantities along the rows that a strip needs.
///
/// - `fill`: writes the `K` quantities of one row of the image
/// - returns: `[num_rows + 10, K, W]`; rows beyond the image are zero
#[inline(always)]
fn filter_rows<const K: usize>(
    width: usize,
    first_row: usize,
    num_rows: usize,
    height: usize,
    fill: impl Fn(usize, [&mut [f32]; K]),
) -> Vec<f32> {
    let padded_width = width + 2 * RADIUS;
    let mut padded = vec![0.0; K * padded_width];
    let mut filtered = vec![0.0; (num_rows + 2 * RADIUS) * K * width];
    for (i, out) in filtered.chunks_exact_mut(K * width).enumerate() {
        let Some(row) = (first_row + i).checked_sub(RADIUS).filter(|&row| row < height) else { continue };
        let mut quantities = padded.chunks_exact_mut(padded_width).map(|row| &mut row[RADIUS..][..width]);
        fill(row, std::array::from_fn(|_| quantities.next().unwrap_or_default()));
        for (padded, out) in padded.chunks_exact(padded_width).zip(out.chunks_exact_mut(width)) {
            blend(std::array::from_fn(|tap| &padded[tap..][..width]), out);
        }
    }
    filtered
}

/// Filters `K` quantities down the columns, for one row of a strip.
///
/// - `filtered`: of [`filter_rows`]
/// - `out`: `[K, W]`
#[inline(always)]
fn filter_columns<const K: usize>(width: usize, row: usize, filtered: &[f32], out: &mut [f32]) {
    blend(std::array::from_fn(|tap| &filtered[(row + tap) * K * width..][..K * width]), out);
}

/// One pass of the window: weighs eleven slices, as long as `out` each, from one side to the other.
#[inline(always)]
fn blend(taps: [&[f32]; 2 * RADIUS + 1], out: &mut [f32]) {
    let len = out.len();
    let [a5, a4, a3, a2, a1, centre, b1, b2, b3, b4, b5] = taps.map(|tap| &tap[..len]);
    for i in 0..len {
        let near = SSIM_WINDOW[0] * centre[i] + SSIM_WINDOW[1] * (a1[i] + b1[i]);
        let middle = SSIM_WINDOW[2] * (a2[i] + b2[i]) + SSIM_WINDOW[3] * (a3[i] + b3[i]);
        let far = SSIM_WINDOW[4] * (a4[i] + b4[i]) + SSIM_WINDOW[5] * (a5[i] + b5[i]);
        out[i] = near + (middle + far);
    }
}

/// `[K, W]` as `K` slices.
#[inline(always)]
fn split<const K: usize>(width: usize, rows: &[f32]) -> [&[f32]; K] {
    std::array::from_fn(|k| &rows[k * width..][..width])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_is_the_normalised_gaussian() {
        let gauss = |d: usize| (-((d * d) as f64) / (2.0 * 1.5 * 1.5)).exp();
        let sum = gauss(0) + 2.0 * (1..=RADIUS).map(gauss).sum::<f64>();
        for (d, &weight) in SSIM_WINDOW.iter().enumerate() {
            assert_eq!(weight, (gauss(d) / sum) as f32, "distance {d}");
        }
    }

    #[test]
    fn constant_images_match_a_sum_by_hand() {
        // One pixel: everything but the window's centre is zero.
        let (x, y) = (Image::filled(1, 1, 1, 0.8), Image::filled(1, 1, 1, 0.4));
        let weight = f64::from(SSIM_WINDOW[0]).powi(2);
        let (mx, my) = (weight * 0.8, weight * 0.4);
        let covariance = weight * 0.32 - mx * my;
        let variances = weight * (0.64 + 0.16) - mx * mx - my * my;
        let expected =
            (2.0 * mx * my + 1e-4) * (2.0 * covariance + 9e-4) / ((mx * mx + my * my + 1e-4) * (variances + 9e-4));
        assert!((ssim(&x, &y) - expected).abs() < 1e-6);
    }

    #[test]
    fn the_backward_pass_accumulates() {
        let (x, y) = (Image::filled(7, 40, 2, 0.8), Image::filled(7, 40, 2, 0.4));
        let saved = ssim_fwd(&x, &y).1;
        let mut once = Image::filled(7, 40, 2, 0.0);
        ssim_bwd(&x, &y, &saved, &[1.0, -2.0], &mut once);
        let mut onto_one = Image::filled(7, 40, 2, 1.0);
        ssim_bwd(&x, &y, &saved, &[1.0, -2.0], &mut onto_one);
        assert!(once.data.iter().zip(&onto_one.data).all(|(a, b)| 1.0 + a == *b));
    }
}
