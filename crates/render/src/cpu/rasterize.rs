//! Blending of a tile's splats, forward and backward.
//!
//! The simple version, for each pixel:
//!
//! ```text
//! transmittance = 1
//! for splat in the tile's splats, front to back:
//!     exponent = ½ dᵀ conic d                     d = pixel centre − mean2d
//!     alpha    = min(MAX_ALPHA, opacity · exp(−exponent));   skip if alpha < MIN_ALPHA
//!     if transmittance · (1 − alpha) < MIN_TRANSMITTANCE: stop
//!     image  += alpha · transmittance · color
//!     transmittance *= 1 − alpha
//! image += transmittance · background
//! ```
//!
//! Departures, for speed:
//! 1. Splats are the outer loop and run over eight or sixteen pixels of a row at a time, inside the splat's own rows
//!    and columns.
//! 2. The sign of the transmittance marks a finished pixel.
//! 3. Backward walks front to back as well. The colour behind a splat is the finished image minus the colour blended so
//!    far, so the image is the only state per pixel.
//! 4. The exponent has base 2.
//! 5. Where the processor has fused multiply-adds, sums of products are rounded once. So machines differ in the last
//!    bits; one machine always computes the same.

#![allow(clippy::too_many_arguments, reason = "all that a tile reads and writes")]

use std::ops::Range;

use multiversion::multiversion;
use multiversion::target::match_target;
use tcgs_core::Image;

use super::tiles::{Pair, Splat, Tiles};
use crate::RenderSettings;
use crate::settings::{COLOR_CHANNELS, MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE};
use crate::tiling::{PAIR_GRADS, TILE};

/// One value of each pixel of a tile, row by row.
pub(super) type Plane = [f32; TILE * TILE];

/// Splats that a tile takes at a time. Copying them first overlaps many cache misses, where blending would wait for one
/// after another. After each batch the tile checks whether all its pixels are finished.
const BATCH: usize = 32;

/// `a * b + c`, rounded once if `FUSED`. Without a processor instruction, a fused one is a slow call.
#[inline(always)]
fn mul_add<const FUSED: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

/// `2^−x` for `0 <= x <= 32`, to 2e-7 relative: a power of two by exponent bits and a degree-6 polynomial.
#[inline(always)]
fn exp2_neg<const FUSED: bool>(x: f32) -> f32 {
    /// Adding this leaves an integer in the low mantissa bits.
    const MAGIC: f32 = 12_582_912.0;
    /// Largest `x`. What it leaves of any opacity is far below [`MIN_ALPHA`], and its products with gradients are still
    /// normal numbers: subnormal ones take some processors a hundred times as long.
    const MOST: f32 = 32.0;
    let x = if x < MOST { x } else { MOST };
    let shifted = MAGIC - x;
    let f = (MAGIC - shifted) - x;
    let p = mul_add::<FUSED>(1.540_353e-4, f, 1.333_355_8e-3);
    let p = mul_add::<FUSED>(p, f, 9.618_129e-3);
    let p = mul_add::<FUSED>(p, f, 5.550_411e-2);
    let p = mul_add::<FUSED>(p, f, 2.402_265e-1);
    let p = mul_add::<FUSED>(p, f, std::f32::consts::LN_2);
    let p = mul_add::<FUSED>(p, f, 1.0);
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

/// The terms of a splat's exponent of 2 in one row of pixels: `(aa * dx + b_dy) * dx + cc_dy2`.
#[derive(Clone, Copy)]
struct RowTerms {
    aa: f32,
    b_dy: f32,
    cc_dy2: f32,
    opacity: f32,
}

impl RowTerms {
    #[inline(always)]
    fn new(splat: &Splat, dy: f32) -> Self {
        const LOG2_E: f32 = std::f32::consts::LOG2_E;
        let [a, b, c] = splat.conic;
        Self { aa: 0.5 * LOG2_E * a, b_dy: LOG2_E * b * dy, cc_dy2: 0.5 * LOG2_E * c * dy * dy, opacity: splat.opacity }
    }
}

/// Alphas of a splat in a run of pixels, before they are clamped. They do not depend on what is in front, so the rows of
/// a splat come one after another before any is blended: the processor overlaps these long chains of operations, which
/// it cannot do with the longer ones of blending between them.
///
/// - `x`: `dx` of the first pixel
#[inline(always)]
fn raw_alphas<const L: usize, const FUSED: bool>(terms: RowTerms, x: f32) -> [f32; L] {
    let mut raws = [0.0; L];
    for l in 0..L {
        let dx = x + l as f32;
        let exponent = mul_add::<FUSED>(mul_add::<FUSED>(terms.aa, dx, terms.b_dy), dx, terms.cc_dy2);
        let exponent = if exponent > 0.0 { exponent } else { 0.0 };
        raws[l] = terms.opacity * exp2_neg::<FUSED>(exponent);
    }
    raws
}

/// Effect of one splat on one pixel.
struct Blend {
    alpha: f32,
    /// `alpha * transmittance`; 0 where the splat is skipped.
    blend_weight: f32,
    /// Whether alpha was clamped.
    clamped: bool,
    /// Transmittance behind the splat; negative where the pixel is finished.
    transmittance: f32,
}

/// Blends a splat into a pixel.
///
/// - `raw`: from [`raw_alphas`]
#[inline(always)]
fn blend<const FUSED: bool>(raw: f32, before: f32) -> Blend {
    let clamped = raw > MAX_ALPHA as f32;
    let alpha = if clamped { MAX_ALPHA as f32 } else { raw };
    let weight = alpha * before;
    // `before - weight` would lose digits where alpha is near 1.
    let after = if FUSED { (-alpha).mul_add(before, before) } else { before * (1.0 - alpha) };
    let reached = (alpha >= MIN_ALPHA as f32) & (before > 0.0);
    let blended = reached & (after >= MIN_TRANSMITTANCE as f32);
    let skipped = if reached { -before } else { before };
    Blend {
        alpha,
        blend_weight: if blended { weight } else { 0.0 },
        clamped,
        transmittance: if blended { after } else { skipped },
    }
}

/// Blends a splat into a run of pixels. Returns its blending weights.
#[inline(always)]
fn blend_run<const L: usize, const FUSED: bool>(raws: &[f32; L], transmittance: &mut [f32; L]) -> [f32; L] {
    let mut weights = [0.0; L];
    for l in 0..L {
        let blended = blend::<FUSED>(raws[l], transmittance[l]);
        weights[l] = blended.blend_weight;
        transmittance[l] = blended.transmittance;
    }
    weights
}

/// A pair's splat, copied, with its colours.
struct Taken<const C: usize> {
    splat: Splat,
    rows: [u8; 2],
    color: [f32; C],
}

impl<const C: usize> Taken<C> {
    /// Runs of `L` pixels that the splat reaches in each of its rows of a tile, and these rows.
    ///
    /// - `left`: of the tile, pixels
    #[inline(always)]
    fn runs<const L: usize>(&self, left: usize) -> (Range<usize>, Range<usize>) {
        let [first, end] = self.splat.columns.map(|column| column as usize);
        let [top, bottom] = self.rows.map(usize::from);
        (first.saturating_sub(left) / L..(end - left).min(TILE).div_ceil(L), top..bottom)
    }

    /// [`raw_alphas`] in some rows of a run of columns. Overwrites these rows.
    ///
    /// - `origin`: of the tile, pixels
    #[inline(always)]
    fn raw_alphas<const L: usize, const FUSED: bool>(
        &self,
        origin: [usize; 2],
        column: usize,
        rows: Range<usize>,
        raws: &mut [[f32; L]; TILE],
    ) {
        let splat = &self.splat;
        let x = origin[0] as f32 + 0.5 - splat.mean2d[0] + (column * L) as f32;
        for row in rows {
            let dy = (origin[1] + row) as f32 + 0.5 - splat.mean2d[1];
            raws[row] = raw_alphas::<L, FUSED>(RowTerms::new(splat, dy), x);
        }
    }
}

#[inline(always)]
fn finished(transmittance: &Plane) -> bool {
    transmittance.iter().all(|&t| t <= 0.0)
}

/// Overwrites: copies the splats of some pairs, with their colours.
///
/// - `colors`: `[N, C]`
#[inline(always)]
fn take_batch<const C: usize>(tiles: &Tiles, pairs: &[Pair], colors: &[f32], batch: &mut Vec<Taken<C>>) {
    batch.clear();
    batch.extend(pairs.iter().map(|pair| {
        let splat = tiles.splats[pair.splat as usize];
        let color = *colors[splat.gaussian as usize * C..].first_chunk().expect("colors hold [N, C]");
        Taken { splat, rows: pair.rows, color }
    }));
}

/// A finished tile: `C` planes and the transmittance.
pub(super) struct TileImage<const C: usize> {
    pub planes: [Plane; C],
    pub transmittance: Plane,
}

fn origin(tiles: &Tiles, tile: usize) -> [usize; 2] {
    [tile % tiles.grid[0] * TILE, tile / tiles.grid[0] * TILE]
}

/// Marks the pixels of a tile that lie outside the image as finished.
#[inline(always)]
fn start_transmittance(origin: [usize; 2], width: usize, height: usize) -> Plane {
    std::array::from_fn(|i| {
        let (x, y) = (origin[0] + i % TILE, origin[1] + i / TILE);
        if x < width && y < height { 1.0 } else { -1.0 }
    })
}

/// A run of `L` pixels.
#[inline(always)]
fn run<const L: usize>(plane: &Plane, at: usize) -> &[f32; L] {
    plane[at..at + L].try_into().expect("a run of L pixels")
}

/// A run of `L` pixels, to change in place.
#[inline(always)]
fn run_mut<const L: usize>(plane: &mut Plane, at: usize) -> &mut [f32; L] {
    (&mut plane[at..at + L]).try_into().expect("a run of L pixels")
}

/// Forward of one tile.
///
/// - `colors`: `[N, C]`
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub(super) fn rasterize_fwd<const C: usize>(
    tiles: &Tiles,
    tile: usize,
    colors: &[f32],
    width: usize,
    height: usize,
    settings: &RenderSettings,
) -> TileImage<C> {
    match_target! {
        "x86_64+avx512f" => fwd::<C, 16, true>(tiles, tile, colors, width, height, settings),
        "x86_64+fma" => fwd::<C, 8, true>(tiles, tile, colors, width, height, settings),
        _ => fwd::<C, 8, false>(tiles, tile, colors, width, height, settings),
    }
}

/// [`rasterize_fwd`] in runs of `L` pixels.
#[inline(always)]
fn fwd<const C: usize, const L: usize, const FUSED: bool>(
    tiles: &Tiles,
    tile: usize,
    colors: &[f32],
    width: usize,
    height: usize,
    settings: &RenderSettings,
) -> TileImage<C> {
    let origin = origin(tiles, tile);
    let mut transmittance = start_transmittance(origin, width, height);
    let mut planes = [[0.0; TILE * TILE]; C];
    let mut batch: Vec<Taken<C>> = Vec::with_capacity(BATCH);
    let mut raws = [[0.0; L]; TILE];
    for pairs in tiles.pairs_of(tile).chunks(BATCH) {
        if finished(&transmittance) {
            break;
        }
        take_batch::<C>(tiles, pairs, colors, &mut batch);
        for taken in &batch {
            let (runs, rows) = taken.runs::<L>(origin[0]);
            for column in runs {
                taken.raw_alphas::<L, FUSED>(origin, column, rows.clone(), &mut raws);
                for row in rows.clone() {
                    let at = row * TILE + column * L;
                    let weights = blend_run::<L, FUSED>(&raws[row], run_mut(&mut transmittance, at));
                    for (plane, &color) in planes.iter_mut().zip(&taken.color) {
                        let plane = run_mut::<L>(plane, at);
                        for l in 0..L {
                            plane[l] = mul_add::<FUSED>(weights[l], color, plane[l]);
                        }
                    }
                }
            }
        }
    }
    let background = settings.background.unwrap_or_default();
    for i in 0..TILE * TILE {
        let t = transmittance[i].abs();
        transmittance[i] = t;
        for (plane, background) in planes.iter_mut().zip(background) {
            plane[i] = mul_add::<FUSED>(t, background, plane[i]);
        }
    }
    TileImage { planes, transmittance }
}

/// The planes of an image, cut to a tile; zero outside the image.
#[inline(always)]
fn cut<const C: usize>(image: &Image, origin: [usize; 2]) -> [Plane; C] {
    let mut planes = [[0.0; TILE * TILE]; C];
    for (channel, out) in planes.iter_mut().enumerate() {
        for (row, line) in lines(image, channel, origin) {
            out[row * TILE..][..line.len()].copy_from_slice(line);
        }
    }
    planes
}

/// The rows of a tile in one plane of an image, as far as they lie in the image.
#[inline(always)]
fn lines(image: &Image, channel: usize, origin: [usize; 2]) -> impl Iterator<Item = (usize, &[f32])> {
    let width = TILE.min(image.width - origin[0]);
    let rows = image.plane(channel).chunks_exact(image.width).skip(origin[1]).take(TILE);
    rows.map(move |row| &row[origin[0]..][..width]).enumerate()
}

/// Sum of the lanes, by halving.
#[inline(always)]
fn sum<const L: usize>(mut lanes: [f32; L]) -> f32 {
    let mut len = L;
    while len > 1 {
        len /= 2;
        for l in 0..len {
            lanes[l] += lanes[l + len];
        }
    }
    lanes[0]
}

/// Backward of one tile.
///
/// - `colors`: `[N, C]`
/// - `image`, `v_image`: `[C, H, W]`, the finished image and its gradient
/// - `wanted`: `[N]`, whether the gradients of a Gaussian's pairs are computed; `None` for all
/// - `v_pairs`: `[pairs of the tile, PAIR_GRADS + num_learned]`, zeros
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub(super) fn rasterize_bwd<const C: usize>(
    tiles: &Tiles,
    tile: usize,
    colors: &[f32],
    settings: &RenderSettings,
    image: &Image,
    v_image: &Image,
    wanted: Option<&[bool]>,
    v_pairs: &mut [f32],
) {
    match_target! {
        "x86_64+avx512f" => bwd_counting::<C, 16, true>(tiles, tile, colors, settings, image, v_image, wanted, v_pairs),
        "x86_64+fma" => bwd_counting::<C, 8, true>(tiles, tile, colors, settings, image, v_image, wanted, v_pairs),
        _ => bwd_counting::<C, 8, false>(tiles, tile, colors, settings, image, v_image, wanted, v_pairs),
    }
}

/// Number of leading channels whose colours have a gradient.
pub(super) fn num_learned(settings: &RenderSettings, num_channels: usize) -> usize {
    if settings.learned_channels <= COLOR_CHANNELS { num_channels.min(COLOR_CHANNELS) } else { num_channels }
}

/// [`rasterize_bwd`] in runs of `L` pixels. The statistic has separate sums only if it counts some channels and not
/// all.
#[inline(always)]
fn bwd_counting<const C: usize, const L: usize, const FUSED: bool>(
    tiles: &Tiles,
    tile: usize,
    colors: &[f32],
    settings: &RenderSettings,
    image: &Image,
    v_image: &Image,
    wanted: Option<&[bool]>,
    v_pairs: &mut [f32],
) {
    let is_partial = (1..C).contains(&settings.statistic_channels);
    macro_rules! bwd {
        ($learned:ident, $partial:literal) => {
            bwd::<C, $learned, L, FUSED, $partial>(tiles, tile, colors, settings, image, v_image, wanted, v_pairs)
        };
    }
    match (is_partial, num_learned(settings, C) == C) {
        (true, true) => bwd!(C, true),
        (true, false) => bwd!(COLOR_CHANNELS, true),
        (false, true) => bwd!(C, false),
        (false, false) => bwd!(COLOR_CHANNELS, false),
    }
}

/// `Σ channels color · v` at a run of pixels: of all channels, and of the statistic's if `PARTIAL`.
#[inline(always)]
fn shown<const C: usize, const L: usize, const FUSED: bool, const PARTIAL: bool>(
    color: &[f32; C],
    v_planes: &[Plane; C],
    at: usize,
) -> [[f32; L]; 2] {
    let (mut own, mut own_statistic) = ([0.0; L], [0.0; L]);
    for c in 0..C {
        if PARTIAL && c == COLOR_CHANNELS {
            own_statistic = own;
        }
        let v = run::<L>(&v_planes[c], at);
        for l in 0..L {
            own[l] = mul_add::<FUSED>(color[c], v[l], own[l]);
        }
    }
    [own, own_statistic]
}

/// Takes what a splat shows at a run of pixels from what lies behind the splats before it.
#[inline(always)]
fn take_away<const L: usize, const FUSED: bool>(weights: &[f32; L], own: &[f32; L], behind: &mut Plane, at: usize) {
    let behind = run_mut::<L>(behind, at);
    for l in 0..L {
        behind[l] = mul_add::<FUSED>(-weights[l], own[l], behind[l]);
    }
}

/// - `K`: [`num_learned`]
/// - `PARTIAL`: whether the statistic counts some channels and not all
#[inline(always)]
fn bwd<const C: usize, const K: usize, const L: usize, const FUSED: bool, const PARTIAL: bool>(
    tiles: &Tiles,
    tile: usize,
    colors: &[f32],
    settings: &RenderSettings,
    image: &Image,
    v_image: &Image,
    wanted: Option<&[bool]>,
    v_pairs: &mut [f32],
) {
    let is_wanted = |gaussian: u32| wanted.is_none_or(|wanted| wanted[gaussian as usize]);
    let pairs = tiles.pairs_of(tile);
    // Splats behind the last wanted one are skipped: the finished image has their colours.
    let Some(last) = pairs.iter().rposition(|pair| is_wanted(tiles.splats[pair.splat as usize].gaussian)) else {
        return;
    };
    let origin = origin(tiles, tile);
    let mut transmittance = start_transmittance(origin, image.width, image.height);
    let v_planes: [Plane; C] = cut(v_image, origin);
    // Σ over channels of image · v_image, minus the part blended so far: for all channels, and for the statistic's
    // alone.
    let mut behind = [0.0; TILE * TILE];
    let mut behind_statistic = [0.0; TILE * TILE];
    for (channel, v_plane) in v_planes.iter().enumerate() {
        if PARTIAL && channel == COLOR_CHANNELS {
            behind_statistic = behind;
        }
        for (row, line) in lines(image, channel, origin) {
            let ends = row * TILE..row * TILE + line.len();
            for ((behind, &color), &v) in behind[ends.clone()].iter_mut().zip(line).zip(&v_plane[ends]) {
                *behind += color * v;
            }
        }
    }

    let mut batch: Vec<Taken<C>> = Vec::with_capacity(BATCH);
    let mut raws = [[0.0; L]; TILE];
    for (pairs, v_pairs) in pairs[..=last].chunks(BATCH).zip(v_pairs.chunks_mut(BATCH * (PAIR_GRADS + K))) {
        if finished(&transmittance) {
            break;
        }
        take_batch::<C>(tiles, pairs, colors, &mut batch);
        for (taken, v_pair) in batch.iter().zip(v_pairs.chunks_exact_mut(PAIR_GRADS + K)) {
            let Taken { splat, color, .. } = taken;
            let (runs, rows) = taken.runs::<L>(origin[0]);
            let left = origin[0] as f32 + 0.5 - splat.mean2d[0];
            let zero = [0.0; L];
            if !is_wanted(splat.gaussian) {
                for column in runs {
                    taken.raw_alphas::<L, FUSED>(origin, column, rows.clone(), &mut raws);
                    for row in rows.clone() {
                        let at = row * TILE + column * L;
                        let weights = blend_run::<L, FUSED>(&raws[row], run_mut(&mut transmittance, at));
                        let [own, own_statistic] = shown::<C, L, FUSED, PARTIAL>(color, &v_planes, at);
                        take_away::<L, FUSED>(&weights, &own, &mut behind, at);
                        if PARTIAL {
                            take_away::<L, FUSED>(&weights, &own_statistic, &mut behind_statistic, at);
                        }
                    }
                }
                continue;
            }
            // Moments of g = −∂L/∂exponent about the splat's centre.
            let (mut g_sum, mut g_x, mut g_y, mut g_xx, mut g_xy, mut g_yy) = (zero, zero, zero, zero, zero, zero);
            let (mut s_x, mut s_y) = (zero, zero);
            let mut v_color = [zero; K];
            for column in runs {
                let x = left + (column * L) as f32;
                taken.raw_alphas::<L, FUSED>(origin, column, rows.clone(), &mut raws);
                // A lane has the same dx in all rows, so its factors come after the sums over rows.
                let (mut g_0, mut g_dy, mut g_dy2, mut s_0, mut s_dy) = (zero, zero, zero, zero, zero);
                for row in rows.clone() {
                    let dy = (origin[1] + row) as f32 + 0.5 - splat.mean2d[1];
                    let at = row * TILE + column * L;
                    let transmittance = run_mut::<L>(&mut transmittance, at);
                    let behind = run_mut::<L>(&mut behind, at);
                    let behind_statistic = run_mut::<L>(&mut behind_statistic, at);
                    let v: [&[f32; L]; C] = std::array::from_fn(|c| run::<L>(&v_planes[c], at));
                    // One loop: of several short ones the compiler would mix the lanes.
                    for l in 0..L {
                        let (mut own, mut own_statistic) = (0.0, 0.0);
                        for c in 0..C {
                            if PARTIAL && c == COLOR_CHANNELS {
                                own_statistic = own;
                            }
                            own = mul_add::<FUSED>(color[c], v[c][l], own);
                        }
                        let blended = blend::<FUSED>(raws[row][l], transmittance[l]);
                        transmittance[l] = blended.transmittance;
                        let (weight, alpha) = (blended.blend_weight, blended.alpha);
                        for c in 0..K {
                            v_color[c][l] = mul_add::<FUSED>(weight, v[c][l], v_color[c][l]);
                        }
                        behind[l] = mul_add::<FUSED>(-weight, own, behind[l]);
                        let moves = (weight > 0.0) & !blended.clamped;
                        let ratio = alpha / (1.0 - alpha);
                        let g = mul_add::<FUSED>(-ratio, behind[l], weight * own);
                        let g = if moves { g } else { 0.0 };
                        g_0[l] += g;
                        g_dy[l] = mul_add::<FUSED>(g, dy, g_dy[l]);
                        g_dy2[l] = mul_add::<FUSED>(g, dy * dy, g_dy2[l]);
                        if PARTIAL {
                            behind_statistic[l] = mul_add::<FUSED>(-weight, own_statistic, behind_statistic[l]);
                            let s = mul_add::<FUSED>(-ratio, behind_statistic[l], weight * own_statistic);
                            let s = if moves { s } else { 0.0 };
                            s_0[l] += s;
                            s_dy[l] = mul_add::<FUSED>(s, dy, s_dy[l]);
                        }
                    }
                }
                for l in 0..L {
                    let dx = x + l as f32;
                    g_sum[l] += g_0[l];
                    g_x[l] = mul_add::<FUSED>(g_0[l], dx, g_x[l]);
                    g_xx[l] = mul_add::<FUSED>(g_0[l] * dx, dx, g_xx[l]);
                    g_y[l] += g_dy[l];
                    g_xy[l] = mul_add::<FUSED>(g_dy[l], dx, g_xy[l]);
                    g_yy[l] += g_dy2[l];
                    if PARTIAL {
                        s_x[l] = mul_add::<FUSED>(s_0[l], dx, s_x[l]);
                        s_y[l] += s_dy[l];
                    }
                }
            }
            let [a, b, c] = splat.conic;
            let along = |x: f32, y: f32| [a * x + b * y, b * x + c * y];
            let mean2d = along(sum(g_x), sum(g_y));
            let statistic = match settings.statistic_channels {
                0 => [0.0; 2],
                _ if PARTIAL => along(sum(s_x), sum(s_y)),
                _ => mean2d,
            };
            v_pair[..PAIR_GRADS].copy_from_slice(&[
                mean2d[0],
                mean2d[1],
                -0.5 * sum(g_xx),
                -sum(g_xy),
                -0.5 * sum(g_yy),
                sum(g_sum) / splat.opacity,
                statistic[0],
                statistic[1],
            ]);
            for (v, lanes) in v_pair[PAIR_GRADS..].iter_mut().zip(v_color) {
                *v = sum(lanes);
            }
        }
    }
}

/// Blending weights of the splats of one tile. The same bits as the gradients to colours by [`rasterize_bwd`] with
/// `shares` as the gradient to the image. Overwrites `sums`.
///
/// - `shares`: `[C, H, W]`
/// - `sums`: `[pairs of the tile, C]`, `Σ pixels share · blending weight` of each pair
#[multiversion(targets("x86_64+avx2+fma+avx512f+avx512vl+avx512dq+avx512bw", "x86_64+avx2+fma"))]
pub(super) fn rasterize_weights<const C: usize>(tiles: &Tiles, tile: usize, shares: &Image, sums: &mut [f32]) {
    match_target! {
        "x86_64+avx512f" => weights::<C, 16, true>(tiles, tile, shares, sums),
        "x86_64+fma" => weights::<C, 8, true>(tiles, tile, shares, sums),
        _ => weights::<C, 8, false>(tiles, tile, shares, sums),
    }
}

/// [`rasterize_weights`] in runs of `L` pixels.
#[inline(always)]
fn weights<const C: usize, const L: usize, const FUSED: bool>(
    tiles: &Tiles,
    tile: usize,
    shares: &Image,
    sums: &mut [f32],
) {
    let origin = origin(tiles, tile);
    let mut transmittance = start_transmittance(origin, shares.width, shares.height);
    let planes: [Plane; C] = cut(shares, origin);
    let mut batch: Vec<Taken<0>> = Vec::with_capacity(BATCH);
    let mut raws = [[0.0; L]; TILE];
    for (pairs, sums) in tiles.pairs_of(tile).chunks(BATCH).zip(sums.chunks_mut(BATCH * C)) {
        if finished(&transmittance) {
            sums.fill(0.0);
            continue;
        }
        take_batch::<0>(tiles, pairs, &[], &mut batch);
        for (taken, sums) in batch.iter().zip(sums.chunks_exact_mut(C)) {
            let (runs, rows) = taken.runs::<L>(origin[0]);
            let mut lanes = [[0.0; L]; C];
            for column in runs {
                taken.raw_alphas::<L, FUSED>(origin, column, rows.clone(), &mut raws);
                for row in rows.clone() {
                    let at = row * TILE + column * L;
                    let weights = blend_run::<L, FUSED>(&raws[row], run_mut(&mut transmittance, at));
                    for (lanes, plane) in lanes.iter_mut().zip(&planes) {
                        let shares = run::<L>(plane, at);
                        for l in 0..L {
                            lanes[l] = mul_add::<FUSED>(weights[l], shares[l], lanes[l]);
                        }
                    }
                }
            }
            for (value, lanes) in sums.iter_mut().zip(lanes) {
                *value = sum(lanes);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp2_neg_follows_exp2() {
        for i in 0..32_000 {
            let x = i as f32 * 1e-3;
            let expected = (-f64::from(x)).exp2();
            for found in [exp2_neg::<true>(x), exp2_neg::<false>(x)].map(f64::from) {
                assert!((found / expected - 1.0).abs() < 4e-7, "{x}: {found} against {expected}");
            }
        }
    }

    #[test]
    fn far_from_a_splat_products_stay_normal() {
        // A gradient of the image is a weight divided by the number of values.
        let gradient = 1e-9_f32;
        for x in [32.0, 1e3, f32::MAX] {
            for least in [exp2_neg::<true>(x), exp2_neg::<false>(x)] {
                assert!((least * MIN_TRANSMITTANCE as f32 * gradient).is_normal() && least < 0.1 * MIN_ALPHA as f32);
            }
        }
    }
}
