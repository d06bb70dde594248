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
//! 4. The forward pass leaves the map's three derivatives rather than its statistics, so the backward pass is three
//!    filters. It follows strip by strip, while the derivatives are in the second-level cache; those of five rows to
//!    either side are computed again.
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

/// Rows of a strip. With a gradient the map is computed in five more on either side, which the strips beside compute,
/// too: a third more work, for strips enough for many cores.
const STRIP_ROWS: usize = 32;

/// Columns of a span: eleven rows of four filtered quantities take 22 kB.
const SPAN: usize = 128;

/// One row of a span.
type Row = [f32; SPAN];

/// One row of a span, and what the window sees beside it.
type Seen = [f32; SPAN + 2 * RADIUS];

/// Length of a row of derivatives: zeros as far as the window sees, the values, and zeros up to the end of a span that
/// begins at any column. So the backward pass needs no copies.
fn partials_len(width: usize) -> usize {
    width + SPAN + 2 * RADIUS
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
    let nowhere = [0..0, 0..0];
    let v_map = vec![0.0; rendered.num_channels];
    let (means, _) = ImagePair::new(rendered, target).ssim_grad(&v_map, nowhere, &mut [], |_, _, _| ());
    means.iter().sum::<f64>() / means.len() as f64
}

/// SSIM of each channel, averaged over its pixels, and its gradient. *Overwrites* `v_rendered`.
///
/// - `rendered`, `target`: `[C, H, W]`, of any size, not clamped
/// - `v_ssim`: `[C]`, gradient to each channel's mean
/// - `v_rendered`: `[C, H, W]`, gradient to `rendered`
/// - returns: `[C]`
///
/// ```
/// use tcgs_core::Image;
/// let (rendered, target) = (Image::filled(12, 12, 1, 0.4), Image::filled(12, 12, 1, 0.5));
/// let mut v_rendered = Image::filled(12, 12, 1, 0.0);
/// let means = tcgs_metrics::ssim_grad(&rendered, &target, &[1.0], &mut v_rendered);
/// assert!(means[0] < 1.0 && v_rendered.plane(0)[6 * 12 + 6] > 0.0, "brighter would be more similar");
/// ```
///
/// # Panics
/// If shapes disagree or the images have no values.
pub fn ssim_grad(rendered: &Image, target: &Image, v_ssim: &[f32], v_rendered: &mut Image) -> Vec<f64> {
    assert_same_shape(rendered, v_rendered);
    let v_map: Vec<f32> = v_ssim.iter().map(|v| v / rendered.num_pixels() as f32).collect();
    let whole = [0..rendered.width, 0..rendered.height];
    ImagePair::new(rendered, target).ssim_grad(&v_map, whole, &mut v_rendered.data, |_, _, _| ()).0
}

/// A rendered image and its target, as a training compares them: with a camera's gain and offset, and in a window.
/// Nothing is copied for either.
#[derive(Clone, Debug)]
pub struct ImagePair<'a> {
    rendered: &'a Image,
    target: &'a Image,
    /// `[C]` factors and offsets of the rendered image; empty for 1 and 0.
    correction: &'a [[f32; 2]],
    /// Columns and rows.
    window: [Range<usize>; 2],
}

impl<'a> ImagePair<'a> {
    /// - `rendered`, `target`: `[C, H, W]`, of any size, not clamped
    ///
    /// # Panics
    /// If the images differ in shape.
    pub fn new(rendered: &'a Image, target: &'a Image) -> Self {
        assert_same_shape(rendered, target);
        Self { rendered, target, correction: &[], window: [0..rendered.width, 0..rendered.height] }
    }

    /// Compares `factor * rendered + offset`.
    ///
    /// - `correction`: `[C]` factors and offsets
    ///
    /// # Panics
    /// If there is another number of them.
    pub fn corrected(self, correction: &'a [[f32; 2]]) -> Self {
        assert_eq!(correction.len(), self.rendered.num_channels, "factors and offsets of [C]");
        Self { correction, ..self }
    }

    /// Compares some columns and rows, as if the images had no others.
    ///
    /// # Panics
    /// If they reach beyond the images.
    pub fn within(self, columns: Range<usize>, rows: Range<usize>) -> Self {
        assert!(columns.end <= self.rendered.width && rows.end <= self.rendered.height, "a window of the images");
        Self { window: [columns, rows], ..self }
    }

    /// Width and height of the window, pixels.
    fn size(&self) -> [usize; 2] {
        self.window.each_ref().map(ExactSizeIterator::len)
    }

    /// A row of the window, in both images, before the correction.
    pub fn row(&self, channel: usize, row: usize) -> [&'a [f32]; 2] {
        let [columns, rows] = &self.window;
        [self.rendered, self.target]
            .map(|image| &image.plane(channel)[(rows.start + row) * image.width..][columns.clone()])
    }

    /// Factor and offset of a channel.
    fn correction_of(&self, channel: usize) -> [f32; 2] {
        self.correction.get(channel).copied().unwrap_or([1.0, 0.0])
    }

    fn moments(&self, channel: usize) -> Moments<'a> {
        let [width, height] = self.size();
        let [columns, rows] = &self.window;
        let [x, y] =
            [self.rendered, self.target].map(|image| &image.plane(channel)[rows.start * image.width + columns.start..]);
        Moments { width, height, stride: self.rendered.width, x, y, correction: self.correction_of(channel) }
    }

    /// SSIM of each channel, averaged over the pixels of the window, and the gradient of its map in a part of it.
    ///
    /// - `v_map`: `[C]`, gradient to the map before its mean is taken, the same at every pixel of a channel
    /// - `part`: columns and rows of the window; may be empty
    /// - `v_part`: `[C, rows, columns]`, gradient to these pixels after the correction; overwritten
    /// - `finish`: gets each row of `v_part`, with its channel and its number, while it is in the processor's cache
    /// - returns: `[C]` the means, and `[C, rows]` what `finish` returns
    ///
    /// # Panics
    /// If shapes disagree or the window has no pixels.
    pub fn ssim_grad<T: Send>(
        &self,
        v_map: &[f32],
        part: [Range<usize>; 2],
        v_part: &mut [f32],
        finish: impl Fn(usize, usize, &mut [f32]) -> T + Sync,
    ) -> (Vec<f64>, Vec<T>) {
        let (channels, [width, height], [columns, rows]) = (self.rendered.num_channels, self.size(), part);
        assert!(channels * width * height > 0, "ssim of an image without values");
        assert!(columns.end <= width && rows.end <= height, "a part of the window");
        assert_eq!(v_part.len(), channels * rows.len() * columns.len(), "gradient to the part");
        assert_eq!(v_map.len(), channels, "a gradient of [{}] against [C]", v_map.len());
        let num_strips = height.div_ceil(STRIP_ROWS);
        let rows_of = |strip: usize| strip * STRIP_ROWS..((strip + 1) * STRIP_ROWS).min(height);
        let mut rest = v_part;
        let strips: Vec<_> = (0..channels * num_strips)
            .map(|i| {
                let (channel, own) = (i / num_strips, rows_of(i % num_strips));
                let start = rows.start.clamp(own.start, own.end);
                let part = [columns.clone(), start..rows.end.clamp(start, own.end)];
                let v_rows = rest.split_off_mut(..part[1].len() * columns.len()).expect("a gradient of this length");
                Strip { channel, own, part, v_map: v_map[channel], v_rows }
            })
            .collect();
        let (sums, finished): (Vec<f64>, Vec<Vec<T>>) = strips
            .into_par_iter()
            .map_init(Vec::new, |partials, mut strip| {
                let sum = strip.run(self.moments(strip.channel), partials);
                let Strip { channel, part: [columns, own_rows], v_rows, .. } = strip;
                let v_rows = v_rows.chunks_mut(columns.len().max(1)).zip(own_rows);
                (sum, v_rows.map(|(v_row, row)| finish(channel, row - rows.start, v_row)).collect())
            })
            .unzip();
        let num_pixels = (width * height) as f64;
        let means = sums.chunks(num_strips).map(|sums| sums.iter().sum::<f64>() / num_pixels).collect();
        (means, finished.into_iter().flatten().collect())
    }
}

/// Rows of one channel: the map is summed over them, and the gradient written in some of them.
struct Strip<'a> {
    channel: usize,
    own: Range<usize>,
    /// Columns and rows where the gradient is wanted.
    part: [Range<usize>; 2],
    /// Gradient to the map.
    v_map: f32,
    /// `[rows, columns]` the gradient.
    v_rows: &'a mut [f32],
}

impl Strip<'_> {
    /// Returns the map's sum.
    ///
    /// - `partials`: memory that only strips of the same width have used
    fn run(&mut self, moments: Moments<'_>, partials: &mut Vec<f32>) -> f64 {
        let (own, [columns, rows]) = (self.own.clone(), self.part.clone());
        let mut seen = own.clone();
        if !self.v_rows.is_empty() {
            seen.start = seen.start.min(rows.start.saturating_sub(RADIUS));
            seen.end = seen.end.max((rows.end + RADIUS).min(moments.height));
        }
        let length = |num_rows: usize| num_rows * 3 * partials_len(moments.width);
        if partials.is_empty() {
            partials.resize(length(STRIP_ROWS + 2 * RADIUS), 0.0);
        }
        let partials = &mut partials[..length(seen.len())];
        let sum = strip_fwd(moments, own, seen.clone(), partials);
        if !self.v_rows.is_empty() {
            strip_bwd(moments, columns, rows, seen.start, partials, self.v_map, self.v_rows);
        }
        sum
    }
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
                inner_sums(ImagePair::new(rendered, target).moments(channel), first_row, num_rows)
            })
            .collect();
        let sum = strips.into_iter().fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
        (sum.0 / num_pixels, sum.1 / num_pixels)
    });
    means.collect()
}

/// Fills the derivatives of some rows and returns the map's sum over some of them.
///
/// - `own`: rows to sum over
/// - `rows`: rows to fill
/// - `partials`: `[rows, 3, partials_len(W)]`, derivatives of the map to `mean_x`, `square_x` and `product`; zeros on
///   both sides of a row's values
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn strip_fwd(moments: Moments<'_>, own: Range<usize>, rows: Range<usize>, partials: &mut [f32]) -> f64 {
    let (columns, height) = (0..moments.width, moments.height);
    let own = own.start - rows.start..own.end - rows.start;
    let mut pass = Forward { moments, own, partials, sum: 0.0 };
    if target_cfg_f!(target_feature = "fma") {
        filter::<4, true>(columns, rows, height, &mut pass);
    } else {
        filter::<4, false>(columns, rows, height, &mut pass);
    }
    pass.sum
}

/// Input and output of [`filter`]. It is a trait, although closures would read better, because closures are compiled
/// separately, without the processor's features.
trait Pass<const K: usize, const FUSED: bool> {
    /// The `K` quantities in one row of the image: of a span that begins at a column, and of what the window sees
    /// beside it; zero beyond the image.
    ///
    /// - `own`: memory for them, which holds zeros or another row of the same span
    fn see<'a>(&'a self, row: usize, begin: usize, own: &'a mut [Seen; K]) -> [&'a Seen; K];

    /// Takes the filtered quantities of some columns of one row of the strip; values beyond the columns are undefined.
    fn take(&mut self, row: usize, columns: Range<usize>, stats: &[Row; K]);
}

/// Both images, the sum of their squares and their product, in one channel of a window.
#[derive(Clone, Copy)]
struct Moments<'a> {
    width: usize,
    height: usize,
    /// From a row to the next.
    stride: usize,
    /// From the window's first pixel on: the rendered image before the correction.
    x: &'a [f32],
    /// From the window's first pixel on: the target.
    y: &'a [f32],
    /// Factor and offset of `x`.
    correction: [f32; 2],
}

impl Moments<'_> {
    /// Some columns of a row, in both images.
    #[inline(always)]
    fn pixels(&self, row: usize, columns: Range<usize>) -> [&[f32]; 2] {
        [self.x, self.y].map(|image| &image[row * self.stride..][columns.clone()])
    }

    /// [`Pass::see`]
    #[inline(always)]
    fn see<'a, const FUSED: bool>(&self, row: usize, begin: usize, own: &'a mut [Seen; 4]) -> [&'a Seen; 4] {
        let columns = begin.saturating_sub(RADIUS)..(begin + SPAN + RADIUS).min(self.width);
        let at = columns.start + RADIUS - begin;
        let [px, py, squares, product] = own.each_mut().map(|quantity| &mut quantity[at..at + columns.len()]);
        let ([x, y], [factor, offset]) = (self.pixels(row, columns), self.correction);
        for i in 0..x.len() {
            let (x, y) = (factor * x[i] + offset, y[i]);
            (px[i], py[i]) = (x, y);
            (squares[i], product[i]) = (mul_add::<FUSED>(x, x, y * y), x * y);
        }
        own.each_ref()
    }
}

/// The formula.
struct Forward<'a> {
    moments: Moments<'a>,
    /// Rows of `partials` whose map is summed.
    own: Range<usize>,
    /// `[rows, 3, partials_len(W)]`
    partials: &'a mut [f32],
    /// Sum of the map.
    sum: f64,
}

impl<const FUSED: bool> Pass<4, FUSED> for Forward<'_> {
    #[inline(always)]
    fn see<'a>(&'a self, row: usize, begin: usize, own: &'a mut [Seen; 4]) -> [&'a Seen; 4] {
        self.moments.see::<FUSED>(row, begin, own)
    }

    #[inline(always)]
    fn take(&mut self, row: usize, columns: Range<usize>, stats: &[Row; 4]) {
        let length = partials_len(self.moments.width);
        let (v_mean, rest) = self.partials[row * 3 * length..][..3 * length].split_at_mut(length);
        let (v_square, v_product) = rest.split_at_mut(length);
        let mut spans = [v_mean, v_square, v_product].map(|row| span_mut(row, RADIUS + columns.start));
        let map = span_fwd::<FUSED>(stats, spans.each_mut().map(|span| &mut **span));
        if self.own.contains(&row) {
            self.sum += sum_of(&map[..columns.len()]);
        }
        spans.iter_mut().for_each(|span| span[columns.len()..].fill(0.0));
    }
}

/// Sums of the map and of its second factor over the inner pixels of some rows.
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn inner_sums(moments: Moments<'_>, first_row: usize, num_rows: usize) -> (f64, f64) {
    let (columns, rows, height) = (0..moments.width, first_row..first_row + num_rows, moments.height);
    let mut pass = Inner { moments, whole: 0.0, structure: 0.0 };
    if target_cfg_f!(target_feature = "fma") {
        filter::<4, true>(columns, rows, height, &mut pass);
    } else {
        filter::<4, false>(columns, rows, height, &mut pass);
    }
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
    fn see<'a>(&'a self, row: usize, begin: usize, own: &'a mut [Seen; 4]) -> [&'a Seen; 4] {
        self.moments.see::<FUSED>(row, begin, own)
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

/// The formula, from filtered statistics: writes the map's three derivatives in one row of a span. Returns the map.
#[inline(always)]
fn span_fwd<const FUSED: bool>(
    [mean_x, mean_y, squares, product]: &[Row; 4],
    [v_mean, v_square, v_product]: [&mut Row; 3],
) -> Row {
    let mut map = [0.0; SPAN];
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
    map
}

/// Overwrites one strip's gradient: `G*v_mean + 2 x (G*v_square) + y (G*v_product)`, the window being its own
/// transpose.
///
/// - `columns`, `rows`: where the gradient is wanted
/// - `first_seen`, `partials`: the first row of `[rows, 3, partials_len(W)]`, which has all rows that the window sees
/// - `v_rows`: `[rows, columns]`
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
fn strip_bwd(
    moments: Moments<'_>,
    columns: Range<usize>,
    rows: Range<usize>,
    first_seen: usize,
    partials: &[f32],
    v_map: f32,
    v_rows: &mut [f32],
) {
    let (first_row, height) = (rows.start, moments.height);
    let mut pass = Backward { moments, columns: columns.clone(), first_row, first_seen, partials, v_map, v_rows };
    if target_cfg_f!(target_feature = "fma") {
        filter::<3, true>(columns, rows, height, &mut pass);
    } else {
        filter::<3, false>(columns, rows, height, &mut pass);
    }
}

/// The gradient; fields as the arguments of [`strip_bwd`].
struct Backward<'a> {
    moments: Moments<'a>,
    columns: Range<usize>,
    first_row: usize,
    first_seen: usize,
    partials: &'a [f32],
    v_map: f32,
    v_rows: &'a mut [f32],
}

impl<const FUSED: bool> Pass<3, FUSED> for Backward<'_> {
    #[inline(always)]
    fn see<'a>(&'a self, row: usize, begin: usize, _: &'a mut [Seen; 3]) -> [&'a Seen; 3] {
        let length = partials_len(self.moments.width);
        let row = &self.partials[(row - self.first_seen) * 3 * length..][..3 * length];
        std::array::from_fn(|k| first_of(&row[k * length + begin..]))
    }

    #[inline(always)]
    fn take(&mut self, row: usize, columns: Range<usize>, [v_mean, v_square, v_product]: &[Row; 3]) {
        let v_row = &mut self.v_rows[row * self.columns.len()..][..self.columns.len()];
        let v_row = &mut v_row[columns.start - self.columns.start..columns.end - self.columns.start];
        let [x, y] = self.moments.pixels(self.first_row + row, columns);
        let [factor, offset] = self.moments.correction;
        for (i, (v, (&x, &y))) in v_row.iter_mut().zip(x.iter().zip(y)).enumerate() {
            let x = factor * x + offset;
            let of_square = mul_add::<FUSED>(2.0 * x, v_square[i], v_mean[i]);
            *v = self.v_map * mul_add::<FUSED>(y, v_product[i], of_square);
        }
    }
}

/// `a * b + c`, rounded once if `FUSED`. Without the processor's own instruction a fused one is a slow call.
#[inline(always)]
fn mul_add<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// Filters `K` quantities with the window, span by span and row by row.
///
/// - `columns`, `rows`: where the filtered quantities are wanted
/// - `height`: of the image
#[inline(always)]
fn filter<const K: usize, const FUSED: bool>(
    columns: Range<usize>,
    rows: Range<usize>,
    height: usize,
    pass: &mut impl Pass<K, FUSED>,
) {
    // Quantities of one row, and the rows filtered along themselves, the last eleven.
    let mut own;
    let mut ring = [[[0.0; SPAN]; K]; WINDOW_SIZE];
    let mut filtered = [[0.0; SPAN]; K];
    for begin in columns.clone().step_by(SPAN) {
        own = [[0.0; SPAN + 2 * RADIUS]; K];
        for i in 0..rows.len() + 2 * RADIUS {
            let slot = &mut ring[i % WINDOW_SIZE];
            match (rows.start + i).checked_sub(RADIUS).filter(|&row| row < height) {
                Some(row) => {
                    for (seen, out) in pass.see(row, begin, &mut own).into_iter().zip(slot) {
                        blend::<FUSED>(std::array::from_fn(|tap| first_of(&seen[tap..])), out);
                    }
                }
                None => *slot = [[0.0; SPAN]; K],
            }
            if let Some(row) = i.checked_sub(2 * RADIUS) {
                for (k, out) in filtered.iter_mut().enumerate() {
                    blend::<FUSED>(std::array::from_fn(|tap| &ring[(row + tap) % WINDOW_SIZE][k]), out);
                }
                pass.take(row, begin..(begin + SPAN).min(columns.end), &filtered);
            }
        }
    }
}

#[inline(always)]
fn first_of<const N: usize>(values: &[f32]) -> &[f32; N] {
    values.first_chunk().expect("a span and its border")
}

/// A span of a row of derivatives.
#[inline(always)]
fn span_mut(row: &mut [f32], at: usize) -> &mut Row {
    row[at..].first_chunk_mut().expect("a row of derivatives holds a whole span after any column")
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
    fn the_gradient_overwrites() {
        let (x, y) = (Image::filled(7, 40, 2, 0.8), Image::filled(7, 40, 2, 0.4));
        let mut once = Image::filled(7, 40, 2, 0.0);
        ssim_grad(&x, &y, &[1.0, -2.0], &mut once);
        let mut onto_one = Image::filled(7, 40, 2, 1.0);
        ssim_grad(&x, &y, &[1.0, -2.0], &mut onto_one);
        assert_eq!(once, onto_one);
    }
}
