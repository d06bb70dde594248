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
//! 1. Splats are the outer loop and run over as many pixels of a row at a time as the processor's vectors have lanes,
//!    inside the splat's own rows and columns. The alphas of all its rows are computed before any of them is blended:
//!    they do not depend on what is in front, so the processor overlaps their long chains of operations.
//! 2. The sign of the transmittance marks a finished pixel.
//! 3. Backward walks front to back as well. The colour behind a splat is the finished image minus the colour blended so
//!    far, so the image is the only state per pixel.
//! 4. The exponent has base 2.
//! 5. Where the processor has fused multiply-adds, sums of products are rounded once. So machines differ in the last
//!    bits; one machine always computes the same.

#![allow(clippy::too_many_arguments, reason = "all that a tile reads and writes")]

use std::ops::Range;
use std::sync::LazyLock;

use fearless_simd::prelude::*;
use fearless_simd::{Level, dispatch};
use tcgs_core::Image;

use super::blend::{RowTerms, blend, raw_alphas};
use super::tiles::{Pair, Splat, Tiles};
use crate::RenderSettings;
use crate::settings::COLOR_CHANNELS;
use crate::tiling::{PAIR_GRADS, TILE};

/// One value of each pixel of a tile, row by row.
pub(super) type Plane = [f32; TILE * TILE];

/// Splats that a tile takes at a time. Copying them first overlaps many cache misses, where blending would wait for one
/// after another. After each batch the tile checks whether all its pixels are finished.
const BATCH: usize = 32;

/// The vectors of this processor.
static LEVEL: LazyLock<Level> = LazyLock::new(Level::new);

/// Blends a splat into a run of pixels of a tile. Returns its blending weights.
#[inline(always)]
fn blend_run<S: Simd>(simd: S, raw: S::f32s, transmittance: &mut Plane, at: usize) -> S::f32s {
    let blended = blend(simd, raw, load(simd, transmittance, at));
    store(blended.transmittance, transmittance, at);
    blended.blend_weight
}

/// A pair's splat, copied, with its colours.
struct Taken<const C: usize> {
    splat: Splat,
    rows: [u8; 2],
    color: [f32; C],
}

impl<const C: usize> Taken<C> {
    /// Runs of `length` pixels that the splat reaches in each of its rows of a tile, and these rows.
    ///
    /// - `left`: of the tile, pixels
    #[inline(always)]
    fn runs(&self, length: usize, left: usize) -> (Range<usize>, Range<usize>) {
        let [first, end] = self.splat.columns.map(|column| column as usize);
        let [top, bottom] = self.rows.map(usize::from);
        (first.saturating_sub(left) / length..(end - left).min(TILE).div_ceil(length), top..bottom)
    }

    /// Distances of a run of columns from the splat's centre.
    ///
    /// - `left`: of the tile, pixels
    #[inline(always)]
    fn dx<S: Simd>(&self, simd: S, left: usize, column: usize) -> S::f32s {
        let x = left as f32 + 0.5 - self.splat.mean2d[0] + (column * S::f32s::LEN) as f32;
        S::f32s::from_fn(simd, |lane| lane as f32) + x
    }

    /// [`raw_alphas`] in some rows of a run of columns. Overwrites these rows.
    ///
    /// - `top`: of the tile, pixels
    /// - `dx`: from [`Self::dx`]
    #[inline(always)]
    fn raw_alphas<S: Simd>(&self, simd: S, top: usize, dx: S::f32s, rows: Range<usize>, raws: &mut [S::f32s; TILE]) {
        let splat = &self.splat;
        for (row, raw) in rows.clone().zip(&mut raws[rows]) {
            let dy = (top + row) as f32 + 0.5 - splat.mean2d[1];
            *raw = raw_alphas(simd, RowTerms::new(splat, dy), dx);
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

/// A run of pixels.
#[inline(always)]
fn load<S: Simd>(simd: S, plane: &Plane, at: usize) -> S::f32s {
    S::f32s::from_slice(simd, &plane[at..at + S::f32s::LEN])
}

/// Overwrites a run of pixels.
#[inline(always)]
fn store<V: SimdBase<S, Element = f32>, S: Simd>(values: V, plane: &mut Plane, at: usize) {
    values.store_slice(&mut plane[at..at + V::LEN]);
}

/// Forward of one tile.
///
/// - `colors`: `[N, C]`
pub(super) fn rasterize_fwd<const C: usize>(
    tiles: &Tiles,
    tile: usize,
    colors: &[f32],
    width: usize,
    height: usize,
    settings: &RenderSettings,
) -> TileImage<C> {
    dispatch!(*LEVEL, simd => fwd::<_, C>(simd, tiles, tile, colors, width, height, settings))
}

/// [`rasterize_fwd`] in runs of as many pixels as a vector has lanes.
#[inline(always)]
fn fwd<S: Simd, const C: usize>(
    simd: S,
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
    let mut raws = [S::f32s::splat(simd, 0.0); TILE];
    for pairs in tiles.pairs_of(tile).chunks(BATCH) {
        if finished(&transmittance) {
            break;
        }
        take_batch::<C>(tiles, pairs, colors, &mut batch);
        for taken in &batch {
            let (runs, rows) = taken.runs(S::f32s::LEN, origin[0]);
            for column in runs {
                taken.raw_alphas(simd, origin[1], taken.dx(simd, origin[0], column), rows.clone(), &mut raws);
                for row in rows.clone() {
                    let at = row * TILE + column * S::f32s::LEN;
                    let weights = blend_run(simd, raws[row], &mut transmittance, at);
                    for (plane, &color) in planes.iter_mut().zip(&taken.color) {
                        store(weights.mul_add(color, load(simd, plane, at)), plane, at);
                    }
                }
            }
        }
    }
    let background = settings.background.unwrap_or_default();
    for at in (0..TILE * TILE).step_by(S::f32s::LEN) {
        let t = load(simd, &transmittance, at).abs();
        store(t, &mut transmittance, at);
        for (plane, background) in planes.iter_mut().zip(background) {
            store(t.mul_add(background, load(simd, plane, at)), plane, at);
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
fn sum<S: Simd>(values: S::f32s) -> f32 {
    let mut lanes = [0.0; TILE];
    let mut len = S::f32s::LEN;
    values.store_slice(&mut lanes[..len]);
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
    let is_partial = (1..C).contains(&settings.statistic_channels);
    macro_rules! bwd {
        ($learned:ident, $partial:literal) => {
            dispatch!(*LEVEL, simd => bwd::<_, C, $learned, $partial>(
                simd, tiles, tile, colors, settings, image, v_image, wanted, v_pairs
            ))
        };
    }
    match (is_partial, num_learned(settings, C) == C) {
        (true, true) => bwd!(C, true),
        (true, false) => bwd!(COLOR_CHANNELS, true),
        (false, true) => bwd!(C, false),
        (false, false) => bwd!(COLOR_CHANNELS, false),
    }
}

/// Number of leading channels whose colours have a gradient.
pub(super) fn num_learned(settings: &RenderSettings, num_channels: usize) -> usize {
    if settings.learned_channels <= COLOR_CHANNELS { num_channels.min(COLOR_CHANNELS) } else { num_channels }
}

/// `Σ channels color · v` at a run of pixels: of all channels, and of the statistic's if `PARTIAL`.
#[inline(always)]
fn shown<S: Simd, const C: usize, const PARTIAL: bool>(simd: S, color: &[f32; C], v: &[S::f32s; C]) -> [S::f32s; 2] {
    let zero = S::f32s::splat(simd, 0.0);
    let (mut own, mut own_statistic) = (zero, zero);
    for c in 0..C {
        if PARTIAL && c == COLOR_CHANNELS {
            own_statistic = own;
        }
        own = v[c].mul_add(color[c], own);
    }
    [own, own_statistic]
}

/// Takes what a splat shows at a run of pixels from what lies behind the splats before it. Returns what is left.
#[inline(always)]
fn take_away<S: Simd>(simd: S, weights: S::f32s, own: S::f32s, behind: &mut Plane, at: usize) -> S::f32s {
    let left = (-weights).mul_add(own, load(simd, behind, at));
    store(left, behind, at);
    left
}

/// [`rasterize_bwd`] in runs of as many pixels as a vector has lanes. The statistic has separate sums only if it counts
/// some channels and not all.
///
/// - `K`: [`num_learned`]
/// - `PARTIAL`: whether the statistic counts some channels and not all
#[inline(always)]
fn bwd<S: Simd, const C: usize, const K: usize, const PARTIAL: bool>(
    simd: S,
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
    let zero = S::f32s::splat(simd, 0.0);
    let mut raws = [zero; TILE];
    for (pairs, v_pairs) in pairs[..=last].chunks(BATCH).zip(v_pairs.chunks_mut(BATCH * (PAIR_GRADS + K))) {
        if finished(&transmittance) {
            break;
        }
        take_batch::<C>(tiles, pairs, colors, &mut batch);
        for (taken, v_pair) in batch.iter().zip(v_pairs.chunks_exact_mut(PAIR_GRADS + K)) {
            let Taken { splat, color, .. } = taken;
            let (runs, rows) = taken.runs(S::f32s::LEN, origin[0]);
            let v_at = |at: usize| -> [S::f32s; C] { std::array::from_fn(|c| load(simd, &v_planes[c], at)) };
            if !is_wanted(splat.gaussian) {
                for column in runs {
                    taken.raw_alphas(simd, origin[1], taken.dx(simd, origin[0], column), rows.clone(), &mut raws);
                    for row in rows.clone() {
                        let at = row * TILE + column * S::f32s::LEN;
                        let weights = blend_run(simd, raws[row], &mut transmittance, at);
                        let [own, own_statistic] = shown::<_, C, PARTIAL>(simd, color, &v_at(at));
                        take_away(simd, weights, own, &mut behind, at);
                        if PARTIAL {
                            take_away(simd, weights, own_statistic, &mut behind_statistic, at);
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
                let dx = taken.dx(simd, origin[0], column);
                taken.raw_alphas(simd, origin[1], dx, rows.clone(), &mut raws);
                // A lane has the same dx in all rows, so its factors come after the sums over rows.
                let (mut g_0, mut g_dy, mut g_dy2, mut s_0, mut s_dy) = (zero, zero, zero, zero, zero);
                for row in rows.clone() {
                    let dy = (origin[1] + row) as f32 + 0.5 - splat.mean2d[1];
                    let at = row * TILE + column * S::f32s::LEN;
                    let v = v_at(at);
                    let [own, own_statistic] = shown::<_, C, PARTIAL>(simd, color, &v);
                    let blended = blend(simd, raws[row], load(simd, &transmittance, at));
                    store(blended.transmittance, &mut transmittance, at);
                    let (weights, alpha) = (blended.blend_weight, blended.alpha);
                    for c in 0..K {
                        v_color[c] = weights.mul_add(v[c], v_color[c]);
                    }
                    let moves = weights.simd_gt(zero) & !blended.clamped;
                    let ratio = alpha / (-alpha + 1.0);
                    let gradient = |own, behind: S::f32s| moves.select((-ratio).mul_add(behind, weights * own), zero);
                    let g = gradient(own, take_away(simd, weights, own, &mut behind, at));
                    g_0 += g;
                    g_dy = g.mul_add(dy, g_dy);
                    g_dy2 = g.mul_add(dy * dy, g_dy2);
                    if PARTIAL {
                        let s =
                            gradient(own_statistic, take_away(simd, weights, own_statistic, &mut behind_statistic, at));
                        s_0 += s;
                        s_dy = s.mul_add(dy, s_dy);
                    }
                }
                g_sum += g_0;
                g_x = g_0.mul_add(dx, g_x);
                g_xx = (g_0 * dx).mul_add(dx, g_xx);
                g_y += g_dy;
                g_xy = g_dy.mul_add(dx, g_xy);
                g_yy += g_dy2;
                if PARTIAL {
                    s_x = s_0.mul_add(dx, s_x);
                    s_y += s_dy;
                }
            }
            let sum = sum::<S>;
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
pub(super) fn rasterize_weights<const C: usize>(tiles: &Tiles, tile: usize, shares: &Image, sums: &mut [f32]) {
    dispatch!(*LEVEL, simd => weights::<_, C>(simd, tiles, tile, shares, sums));
}

/// [`rasterize_weights`] in runs of as many pixels as a vector has lanes.
#[inline(always)]
fn weights<S: Simd, const C: usize>(simd: S, tiles: &Tiles, tile: usize, shares: &Image, sums: &mut [f32]) {
    let origin = origin(tiles, tile);
    let mut transmittance = start_transmittance(origin, shares.width, shares.height);
    let planes: [Plane; C] = cut(shares, origin);
    let mut batch: Vec<Taken<0>> = Vec::with_capacity(BATCH);
    let zero = S::f32s::splat(simd, 0.0);
    let mut raws = [zero; TILE];
    for (pairs, sums) in tiles.pairs_of(tile).chunks(BATCH).zip(sums.chunks_mut(BATCH * C)) {
        if finished(&transmittance) {
            sums.fill(0.0);
            continue;
        }
        take_batch::<0>(tiles, pairs, &[], &mut batch);
        for (taken, sums) in batch.iter().zip(sums.chunks_exact_mut(C)) {
            let (runs, rows) = taken.runs(S::f32s::LEN, origin[0]);
            let mut lanes = [zero; C];
            for column in runs {
                taken.raw_alphas(simd, origin[1], taken.dx(simd, origin[0], column), rows.clone(), &mut raws);
                for row in rows.clone() {
                    let at = row * TILE + column * S::f32s::LEN;
                    let weights = blend_run(simd, raws[row], &mut transmittance, at);
                    for (lanes, plane) in lanes.iter_mut().zip(&planes) {
                        *lanes = weights.mul_add(load(simd, plane, at), *lanes);
                    }
                }
            }
            for (value, lanes) in sums.iter_mut().zip(lanes) {
                *value = sum::<S>(lanes);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Activated, Camera};

    use super::*;
    use crate::Laps;

    /// Pictures and gradients of all tiles of a few splats, by the vectors of a level.
    fn drawn_by(level: Level) -> Vec<f32> {
        const C: usize = 5;
        let [width, height] = [37, 29];
        let camera = Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], [0.0, -1.0, 0.0], 40.0, width, height);
        let at = |i: usize, phase: f32| (1.7 * i as f32 + phase).sin();
        let n = 60;
        let gaussians = Activated {
            means: (0..n).map(|i| [at(i, 0.0), at(i, 2.0), at(i, 4.0)]).collect(),
            quats: vec![[0.8, 0.6, 0.0, 0.0]; n],
            scales: (0..n).map(|i| [0.3 + 0.2 * at(i, 1.0), 0.1, 0.2 + 0.1 * at(i, 3.0)]).collect(),
            opacities: (0..n).map(|i| 0.6 + 0.4 * at(i, 5.0)).collect(),
            colors: (0..n * C).map(|i| 0.5 + 0.5 * at(i, 0.3)).collect(),
            num_channels: C,
            ..Activated::default()
        };
        let (settings, laps) = (RenderSettings::default(), &mut Laps::begin());
        let tiles = Tiles::new(&gaussians, &camera, None, None, laps);
        let mut image = Image::filled(width, height, C, 0.0);
        let v_image = Image { data: (0..image.data.len()).map(|i| at(i, 0.7)).collect(), ..image.clone() };
        let mut values = Vec::new();
        for tile in 0..tiles.starts.len() - 1 {
            let colors = &gaussians.colors;
            let drawn = dispatch!(level, simd => fwd::<_, C>(simd, &tiles, tile, colors, width, height, &settings));
            let origin = origin(&tiles, tile);
            for (channel, plane) in drawn.planes.iter().enumerate() {
                values.extend(plane);
                for (i, &value) in plane.iter().enumerate() {
                    let (x, y) = (origin[0] + i % TILE, origin[1] + i / TILE);
                    if x < width && y < height {
                        image.plane_mut(channel)[y * width + x] = value;
                    }
                }
            }
            values.extend(drawn.transmittance);
        }
        for tile in 0..tiles.starts.len() - 1 {
            let mut v_pairs = vec![0.0; tiles.pairs_of(tile).len() * (PAIR_GRADS + C)];
            dispatch!(level, simd => bwd::<_, C, C, true>(
                simd, &tiles, tile, &gaussians.colors, &settings, &image, &v_image, None, &mut v_pairs
            ));
            values.extend(v_pairs);
            let mut sums = vec![0.0; tiles.pairs_of(tile).len() * C];
            dispatch!(level, simd => weights::<_, C>(simd, &tiles, tile, &v_image, &mut sums));
            values.extend(sums);
        }
        values
    }

    #[test]
    fn vectors_of_every_length_draw_the_same() {
        let (found, expected) = (drawn_by(Level::baseline()), drawn_by(*LEVEL));
        assert!(found.len() == expected.len() && expected.iter().filter(|value| **value != 0.0).count() > 5000);
        for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
            assert!((found - expected).abs() < 1e-4 * (1.0 + expected.abs()), "{i}: {found} against {expected}");
        }
    }
}
