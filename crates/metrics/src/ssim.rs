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
//! 1. The window is separable: rows first, then columns, with six products per value because it is symmetric.
//! 2. Only the sum of the two squares is filtered, because the formula uses no other combination of them.
//! 3. Work is cut into strips of rows of one channel, and strips into spans of columns. The eleven rows filtered last
//!    of a span stay in the first-level cache. Neither size depends on the number of threads, so the results do not
//!    either.
//! 4. The forward pass saves the map's three derivatives rather than its statistics, so the backward pass is three
//!    filters.
//! 5. Loops run on arrays of one length, compiled for AVX-512 or AVX2 where the machine has them. There multiply-adds
//!    are fused, so machines differ in the last bits. A value has the same bits wherever an image is cut.

use std::ops::Range;

use multiversion::multiversion;
use multiversion::target::target_cfg_f;
use rayon::prelude::*;
use tcgs_core::Image;

use crate::assert_same_shape;

/// `C1 = (0.01 L)²` of Wang et al. 2004 for values of range `L = 1`.
pub const SSIM_C1: f32 = 0.01 * 0.01;

/// `C2 = (0.03 L)²` of Wang et al. 2004 for values of range `L = 1`.
pub const SSIM_C2: f32 = 0.03 * 0.03;

/// Pixels on each side of the window's centre. A value of the map depends on pixels up to this distance along either
/// axis, and its gradient on pixels up to twice this distance.
pub const SSIM_RADIUS: usize = 5;
const RADIUS: usize = SSIM_RADIUS;

/// Pixels on a side of the window.
pub(crate) const WINDOW_SIZE: usize = 2 * RADIUS + 1;

/// Weights of the window along one axis: `exp(-d² / (2 * 1.5²))` over the sum of all eleven, for distances `d = 0..=5`
/// in pixels, which is the centre and one side.
pub const SSIM_WINDOW: [f32; RADIUS + 1] =
    [0.266_011_72, 0.213_005_54, 0.109_360_69, 0.036_000_773, 0.007_598_758, 0.001_028_380_1];

/// Rows of a strip. Ten more are filtered to either side: a third more work along rows, for strips enough for many
/// cores.
const STRIP_ROWS: usize = 32;

/// Columns of a span: eleven rows of four filtered quantities take 22 kB.
const SPAN: usize = 128;

/// One row of a span.
type Row = [f32; SPAN];

/// State that [`ssim_fwd`] saves for [`ssim_bwd`]: three values per value of the image.
#[derive(Clone, Debug, Default)]
pub struct SsimSaved {
    /// Strips of the channels, one after another, each `[rows, 3, W]`: derivatives of the map to `mean_x`, `square_x`
    /// and `product`. Every strip is allocated by the thread that fills it.
    strips: Vec<Vec<f32>>,
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
    let strips_per_channel = rendered.height.div_ceil(STRIP_ROWS);
    let (sums, strips): (Vec<f64>, Vec<Vec<f32>>) = (0..rendered.num_channels * strips_per_channel)
        .into_par_iter()
        .map(|strip| {
            let (channel, first_row) = (strip / strips_per_channel, strip % strips_per_channel * STRIP_ROWS);
            let mut partials = vec![0.0; STRIP_ROWS.min(rendered.height - first_row) * 3 * width];
            let sum = strip_fwd(width, first_row, rendered.plane(channel), target.plane(channel), &mut partials);
            (sum, partials)
        })
        .unzip();
    let means = sums.chunks(strips_per_channel).map(|sums| sums.iter().sum::<f64>() / num_pixels as f64).collect();
    (means, SsimSaved { strips })
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

/// Backward of the map of [`ssim_fwd`] before its mean is taken, for images that are cut from larger ones.
/// *Accumulates* into `v_rendered`.
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
    let num_saved: usize = saved.strips.iter().map(Vec::len).sum();
    assert_eq!(num_saved, 3 * rendered.data.len(), "saved for [C, H, 3, W] of another image");
    let strips_per_channel = rendered.height.div_ceil(STRIP_ROWS);
    let (width, num_pixels) = (rendered.width, rendered.num_pixels());
    strips(&mut v_rendered.data, num_pixels, width).into_par_iter().for_each(|(channel, first_row, v_rows)| {
        let partials = &saved.strips[channel * strips_per_channel..][..strips_per_channel];
        strip_bwd(width, first_row, rendered.plane(channel), target.plane(channel), partials, v_map[channel], v_rows);
    });
}

/// The map and its second factor, `(2 covariance + C2) / (variance_x + variance_y + C2)`, averaged over the pixels
/// whose window lies inside the image; for each channel.
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
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn strip_fwd(width: usize, first_row: usize, x: &[f32], y: &[f32], partials: &mut [f32]) -> f64 {
    if target_cfg_f!(target_feature = "fma") {
        strip_fwd_in::<true>(width, first_row, x, y, partials)
    } else {
        strip_fwd_in::<false>(width, first_row, x, y, partials)
    }
}

/// [`strip_fwd`], with fused multiply-adds or without.
#[inline(always)]
fn strip_fwd_in<const FUSED: bool>(width: usize, first_row: usize, x: &[f32], y: &[f32], partials: &mut [f32]) -> f64 {
    let num_rows = partials.len() / (3 * width);
    let mut pass = Forward { moments: Moments { width, x, y }, partials, sum: 0.0 };
    filter::<4, FUSED>(width, first_row, num_rows, x.len() / width, &mut pass);
    pass.sum
}

/// Input and output of [`filter`]. It is a trait, although closures would read better, because closures are compiled
/// separately, without the processor's features.
trait Pass<const K: usize, const FUSED: bool> {
    /// Writes the `K` quantities of some columns of one row of the image.
    fn fill(&self, row: usize, columns: Range<usize>, padded: [&mut [f32]; K]);

    /// Takes the filtered quantities of some columns of one row of the strip; values beyond the columns are undefined.
    fn take(&mut self, row: usize, columns: Range<usize>, stats: &[Row; K]);
}

/// Both images, the sum of their squares and their product.
struct Moments<'a> {
    width: usize,
    /// `[H, W]`, rendered.
    x: &'a [f32],
    /// `[H, W]`, target.
    y: &'a [f32],
}

impl Moments<'_> {
    #[inline(always)]
    fn fill<const FUSED: bool>(&self, row: usize, columns: Range<usize>, padded: [&mut [f32]; 4]) {
        let [px, py, squares, product] = padded.map(|quantity| &mut quantity[..columns.len()]);
        let [x, y] = [self.x, self.y].map(|image| &image[row * self.width..][columns.clone()]);
        for i in 0..x.len() {
            let (x, y) = (x[i], y[i]);
            (px[i], py[i]) = (x, y);
            (squares[i], product[i]) = (mul_add::<FUSED>(x, x, y * y), x * y);
        }
    }
}

/// The formula.
struct Forward<'a> {
    moments: Moments<'a>,
    /// `[rows, 3, W]`
    partials: &'a mut [f32],
    /// Sum of the map.
    sum: f64,
}

impl<const FUSED: bool> Pass<4, FUSED> for Forward<'_> {
    #[inline(always)]
    fn fill(&self, row: usize, columns: Range<usize>, padded: [&mut [f32]; 4]) {
        self.moments.fill::<FUSED>(row, columns, padded);
    }

    #[inline(always)]
    fn take(&mut self, row: usize, columns: Range<usize>, stats: &[Row; 4]) {
        let width = self.moments.width;
        let (map, derivatives) = span_fwd::<FUSED>(stats);
        let out = &mut self.partials[row * 3 * width..][..3 * width];
        for (out, values) in out.chunks_exact_mut(width).zip(&derivatives) {
            out[columns.clone()].copy_from_slice(&values[..columns.len()]);
        }
        self.sum += sum_of(&map[..columns.len()]);
    }
}

/// Sums of the map and of its second factor over the inner pixels of some rows.
///
/// - `x`, `y`: `[H, W]`, rendered and target
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn inner_sums(width: usize, first_row: usize, num_rows: usize, x: &[f32], y: &[f32]) -> (f64, f64) {
    if target_cfg_f!(target_feature = "fma") {
        inner_sums_in::<true>(width, first_row, num_rows, x, y)
    } else {
        inner_sums_in::<false>(width, first_row, num_rows, x, y)
    }
}

/// [`inner_sums`], with fused multiply-adds or without.
#[inline(always)]
fn inner_sums_in<const FUSED: bool>(
    width: usize,
    first_row: usize,
    num_rows: usize,
    x: &[f32],
    y: &[f32],
) -> (f64, f64) {
    let mut pass = Inner { moments: Moments { width, x, y }, whole: 0.0, structure: 0.0 };
    filter::<4, FUSED>(width, first_row, num_rows, x.len() / width, &mut pass);
    (pass.whole, pass.structure)
}

/// The formula without derivatives.
struct Inner<'a> {
    moments: Moments<'a>,
    /// Sum of the map over inner columns.
    whole: f64,
    /// Sum of its second factor.
    structure: f64,
}

impl<const FUSED: bool> Pass<4, FUSED> for Inner<'_> {
    #[inline(always)]
    fn fill(&self, row: usize, columns: Range<usize>, padded: [&mut [f32]; 4]) {
        self.moments.fill::<FUSED>(row, columns, padded);
    }

    #[inline(always)]
    fn take(&mut self, _: usize, columns: Range<usize>, [mean_x, mean_y, squares, product]: &[Row; 4]) {
        let [mut map, mut similarities] = [[0.0; SPAN]; 2];
        for i in 0..SPAN {
            let (x, y) = (mean_x[i], mean_y[i]);
            let variances = squares[i] - (x * x + y * y);
            let similarity = (2.0 * (product[i] - x * y) + SSIM_C2) / (variances + SSIM_C2);
            map[i] = (2.0 * x * y + SSIM_C1) / (x * x + y * y + SSIM_C1) * similarity;
            similarities[i] = similarity;
        }
        let begin = RADIUS.max(columns.start) - columns.start;
        let end = (self.moments.width - RADIUS).min(columns.end).saturating_sub(columns.start).max(begin);
        self.whole += sum_of(&map[begin..end]);
        self.structure += sum_of(&similarities[begin..end]);
    }
}

/// Sum of at most [`SPAN`] values, in eight lanes.
#[inline(always)]
fn sum_of(values: &[f32]) -> f64 {
    let mut lanes = [0.0_f64; 8];
    let (eights, rest) = values.as_chunks::<8>();
    for eight in eights {
        for l in 0..8 {
            lanes[l] += f64::from(eight[l]);
        }
    }
    for (lane, &value) in lanes.iter_mut().zip(rest) {
        *lane += f64::from(value);
    }
    lanes.iter().sum()
}

/// The formula, from filtered statistics: the map and its three derivatives, in one row of a span.
#[inline(always)]
fn span_fwd<const FUSED: bool>([mean_x, mean_y, squares, product]: &[Row; 4]) -> (Row, [Row; 3]) {
    let mut map = [0.0; SPAN];
    let [mut v_mean, mut v_square, mut v_product] = [[0.0; SPAN]; 3];
    for i in 0..SPAN {
        let (x, y) = (mean_x[i], mean_y[i]);
        let means = mul_add::<FUSED>(x, x, y * y);
        let (both, covariance) = (2.0 * x * y, mul_add::<FUSED>(-x, y, product[i]));
        let (a1, a2) = (both + SSIM_C1, mul_add::<FUSED>(2.0, covariance, SSIM_C2));
        let (b1, b2) = (means + SSIM_C1, (squares[i] - means) + SSIM_C2);
        let (inverse_b1, inverse_b2) = (1.0 / b1, 1.0 / b2);
        let inverse = inverse_b1 * inverse_b2;
        let ssim = a1 * a2 * inverse;
        // With the squares and the product held fixed, the mean acts on the variance and covariance too.
        v_mean[i] = 2.0 * mul_add::<FUSED>(y * (a2 - a1), inverse, -(x * ssim * (inverse_b1 - inverse_b2)));
        v_square[i] = -ssim * inverse_b2;
        v_product[i] = 2.0 * a1 * inverse;
        map[i] = ssim;
    }
    (map, [v_mean, v_square, v_product])
}

/// Adds one strip's gradient: `G*v_mean + 2 x (G*v_square) + y (G*v_product)`, the window being its own transpose.
///
/// - `partials`: the strips of the channel, `[rows, 3, W]` each
/// - `v_rows`: `[rows, W]`
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn strip_bwd(
    width: usize,
    first_row: usize,
    x: &[f32],
    y: &[f32],
    partials: &[Vec<f32>],
    v_map: f32,
    v_rows: &mut [f32],
) {
    if target_cfg_f!(target_feature = "fma") {
        strip_bwd_in::<true>(width, first_row, x, y, partials, v_map, v_rows);
    } else {
        strip_bwd_in::<false>(width, first_row, x, y, partials, v_map, v_rows);
    }
}

/// [`strip_bwd`], with fused multiply-adds or without.
#[inline(always)]
fn strip_bwd_in<const FUSED: bool>(
    width: usize,
    first_row: usize,
    x: &[f32],
    y: &[f32],
    partials: &[Vec<f32>],
    v_map: f32,
    v_rows: &mut [f32],
) {
    let num_rows = v_rows.len() / width;
    let mut pass = Backward { width, first_row, x, y, partials, v_map, v_rows };
    filter::<3, FUSED>(width, first_row, num_rows, x.len() / width, &mut pass);
}

/// The gradient; fields as the arguments of [`strip_bwd`].
struct Backward<'a> {
    width: usize,
    first_row: usize,
    x: &'a [f32],
    y: &'a [f32],
    partials: &'a [Vec<f32>],
    v_map: f32,
    v_rows: &'a mut [f32],
}

impl<const FUSED: bool> Pass<3, FUSED> for Backward<'_> {
    #[inline(always)]
    fn fill(&self, row: usize, columns: Range<usize>, padded: [&mut [f32]; 3]) {
        let partials = &self.partials[row / STRIP_ROWS][row % STRIP_ROWS * 3 * self.width..][..3 * self.width];
        for (padded, row) in padded.into_iter().zip(split::<3>(self.width, partials)) {
            padded.copy_from_slice(&row[columns.clone()]);
        }
    }

    #[inline(always)]
    fn take(&mut self, row: usize, columns: Range<usize>, [v_mean, v_square, v_product]: &[Row; 3]) {
        let start = (self.first_row + row) * self.width;
        let [x, y] = [self.x, self.y].map(|image| &image[start..][columns.clone()]);
        let v_row = &mut self.v_rows[row * self.width..][columns];
        for (i, (v, (&x, &y))) in v_row.iter_mut().zip(x.iter().zip(y)).enumerate() {
            let of_square = mul_add::<FUSED>(2.0 * x, v_square[i], v_mean[i]);
            *v += self.v_map * mul_add::<FUSED>(y, v_product[i], of_square);
        }
    }
}

/// `a * b + c`, rounded once if `FUSED`. Without the processor's own instruction a fused one is a slow call.
#[inline(always)]
fn mul_add<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// Filters `K` quantities with the window, span by span and row by row.
#[inline(always)]
fn filter<const K: usize, const FUSED: bool>(
    width: usize,
    first_row: usize,
    num_rows: usize,
    height: usize,
    pass: &mut impl Pass<K, FUSED>,
) {
    // Quantities of one row, with zeros beyond the image, and the rows filtered along themselves, the last eleven.
    let mut padded;
    let mut ring = [[[0.0; SPAN]; K]; WINDOW_SIZE];
    let mut filtered = [[0.0; SPAN]; K];
    for begin in (0..width).step_by(SPAN) {
        let columns = begin..(begin + SPAN).min(width);
        let seen = begin.saturating_sub(RADIUS)..(begin + SPAN + RADIUS).min(width);
        padded = [[0.0; SPAN + 2 * RADIUS]; K];
        for i in 0..num_rows + 2 * RADIUS {
            let slot = &mut ring[i % WINDOW_SIZE];
            match (first_row + i).checked_sub(RADIUS).filter(|&row| row < height) {
                Some(row) => {
                    let at = seen.start + RADIUS - begin;
                    let mut rows = padded.iter_mut().map(|padded| &mut padded[at..at + seen.len()]);
                    pass.fill(row, seen.clone(), std::array::from_fn(|_| rows.next().unwrap_or_default()));
                    for (padded, out) in padded.iter().zip(slot) {
                        blend::<FUSED>(std::array::from_fn(|tap| first_of(&padded[tap..])), out);
                    }
                }
                None => *slot = [[0.0; SPAN]; K],
            }
            if let Some(row) = i.checked_sub(2 * RADIUS) {
                for (k, out) in filtered.iter_mut().enumerate() {
                    blend::<FUSED>(std::array::from_fn(|tap| &ring[(row + tap) % WINDOW_SIZE][k]), out);
                }
                pass.take(row, columns.clone(), &filtered);
            }
        }
    }
}

#[inline(always)]
fn first_of(values: &[f32]) -> &Row {
    values.first_chunk().expect("a span and its border")
}

/// One pass of the window: weighs eleven rows, from one side to the other.
#[inline(always)]
fn blend<const FUSED: bool>(taps: [&Row; WINDOW_SIZE], out: &mut Row) {
    let [a5, a4, a3, a2, a1, centre, b1, b2, b3, b4, b5] = taps;
    let w = SSIM_WINDOW;
    for i in 0..SPAN {
        let near = mul_add::<FUSED>(w[1], a1[i] + b1[i], w[0] * centre[i]);
        let middle = mul_add::<FUSED>(w[2], a2[i] + b2[i], w[3] * (a3[i] + b3[i]));
        let far = mul_add::<FUSED>(w[4], a4[i] + b4[i], w[5] * (a5[i] + b5[i]));
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
