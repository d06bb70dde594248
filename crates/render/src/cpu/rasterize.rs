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
//! Departures, for speed: (1) splats are the outer loop and run over eight pixels of a row at a
//! time, inside the splat's own rows and columns; (2) a finished pixel is marked by the sign of its
//! transmittance; (3) backward walks front to back as well: what lies behind a splat is the
//! finished image less what was blended so far, so nothing per pixel is kept but the image.

use multiversion::multiversion;
use tcgs_core::Image;

use super::tiles::{Splat, Tiles};
use crate::RenderSettings;
use crate::settings::{MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE};
use crate::tiling::{PAIR_GRADS, TILE};

const LANES: usize = 8;
const BLOCKS: usize = TILE / LANES;
type Lanes = [f32; LANES];
const ZERO: Lanes = [0.0; LANES];

/// State of one tile, a row of blocks after another.
type Plane = [Lanes; TILE * BLOCKS];

/// Splats that a tile takes at a time. Copying them first lets the processor wait for many cache misses
/// at once, where blending would wait for one after another; and after each batch the tile is asked
/// whether all its pixels are finished.
const BATCH: usize = 32;

/// `exp(−x)` for `x >= 0`, to 2e-7 relative: a power of two by exponent bits and a degree-6 polynomial.
#[inline(always)]
fn exp_neg(x: f32) -> f32 {
    /// Adding this leaves an integer in the low mantissa bits.
    const MAGIC: f32 = 12_582_912.0;
    let y = -x.min(80.0) * std::f32::consts::LOG2_E;
    let shifted = y + MAGIC;
    let f = y - (shifted - MAGIC);
    let p = 1.540_353e-4_f32;
    let p = p * f + 1.333_355_8e-3;
    let p = p * f + 9.618_129e-3;
    let p = p * f + 5.550_411e-2;
    let p = p * f + 2.402_265e-1;
    let p = p * f + std::f32::consts::LN_2;
    let p = p * f + 1.0;
    f32::from_bits(p.to_bits().wrapping_add(shifted.to_bits() << 23))
}

/// What one splat does to eight pixels.
struct Blend {
    /// Offset of the pixel centres from the splat's, along x.
    dx: Lanes,
    alpha: Lanes,
    /// `alpha * transmittance`; 0 where the splat is skipped.
    blend_weight: Lanes,
    /// Whether alpha was clamped.
    clamped: [bool; LANES],
}

/// Blends a splat into the transmittance of eight pixels that start at `x`.
#[inline(always)]
fn blend(splat: &Splat, x: f32, dy: f32, transmittance: &mut Lanes) -> Blend {
    let [a, b, c] = splat.conic;
    let mut out = Blend { dx: ZERO, alpha: ZERO, blend_weight: ZERO, clamped: [false; LANES] };
    let (half_a, b_dy, half_c_dy2) = (0.5 * a, b * dy, 0.5 * c * dy * dy);
    for l in 0..LANES {
        let dx = x + l as f32 - splat.mean2d[0];
        let exponent = (half_a * dx + b_dy) * dx + half_c_dy2;
        let raw = splat.opacity * exp_neg(exponent.max(0.0));
        let alpha = raw.min(MAX_ALPHA as f32);
        let before = transmittance[l];
        let after = before * (1.0 - alpha);
        let reached = (alpha >= MIN_ALPHA as f32) & (before > 0.0);
        let finishes = after < MIN_TRANSMITTANCE as f32;
        let blended = reached & !finishes;
        out.dx[l] = dx;
        out.alpha[l] = alpha;
        out.blend_weight[l] = if blended { alpha * before } else { 0.0 };
        out.clamped[l] = raw > MAX_ALPHA as f32;
        transmittance[l] = if blended {
            after
        } else if reached {
            -before
        } else {
            before
        };
    }
    out
}

/// Rows and blocks of a tile that a splat reaches.
#[inline(always)]
fn reach(splat: &Splat, origin: [usize; 2]) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
    let clip = |range: [u32; 2], origin: usize| {
        (range[0] as usize).saturating_sub(origin)..(range[1] as usize - origin).min(TILE)
    };
    let columns = clip(splat.columns, origin[0]);
    (clip(splat.rows, origin[1]), columns.start / LANES..columns.end.div_ceil(LANES))
}

#[inline(always)]
fn finished(transmittance: &Plane) -> bool {
    transmittance.iter().all(|lanes| lanes.iter().all(|&t| t <= 0.0))
}

/// Overwrites: the splats of some pairs, with their colours.
///
/// - `colors`: `[N, C]`
#[inline(always)]
fn take_batch<const C: usize>(tiles: &Tiles, pairs: &[u32], colors: &[f32], batch: &mut Vec<(Splat, [f32; C])>) {
    batch.clear();
    batch.extend(pairs.iter().map(|&pair_splat| {
        let splat = tiles.splats[pair_splat as usize];
        (splat, *colors[splat.gaussian as usize * C..].first_chunk().expect("colors hold [N, C]"))
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
        std::array::from_fn(|l| {
            let (x, y) = (origin[0] + i % BLOCKS * LANES + l, origin[1] + i / BLOCKS);
            if x < width && y < height { 1.0 } else { -1.0 }
        })
    })
}

/// Forward of one tile.
///
/// - `colors`: `[N, C]`
#[multiversion(targets("x86_64+avx2"))]
pub(super) fn rasterize_fwd<const C: usize>(
    tiles: &Tiles,
    tile: usize,
    colors: &[f32],
    width: usize,
    height: usize,
    settings: &RenderSettings,
) -> TileImage<C> {
    let origin = origin(tiles, tile);
    let mut transmittance = start_transmittance(origin, width, height);
    let mut planes = [[ZERO; TILE * BLOCKS]; C];
    let mut batch: Vec<(Splat, [f32; C])> = Vec::with_capacity(BATCH);
    for pairs in tiles.pair_splats[tiles.pairs(tile)].chunks(BATCH) {
        if finished(&transmittance) {
            break;
        }
        take_batch::<C>(tiles, pairs, colors, &mut batch);
        for (splat, color) in &batch {
            let (rows, blocks) = reach(splat, origin);
            for row in rows {
                let dy = (origin[1] + row) as f32 + 0.5 - splat.mean2d[1];
                for block in blocks.clone() {
                    let i = row * BLOCKS + block;
                    let x = (origin[0] + block * LANES) as f32 + 0.5;
                    let blended = blend(splat, x, dy, &mut transmittance[i]);
                    for (plane, color) in planes.iter_mut().zip(color) {
                        for l in 0..LANES {
                            plane[i][l] += blended.blend_weight[l] * color;
                        }
                    }
                }
            }
        }
    }
    for i in 0..TILE * BLOCKS {
        for l in 0..LANES {
            let t = transmittance[i][l].abs();
            transmittance[i][l] = t;
            for (plane, background) in planes.iter_mut().zip(settings.background) {
                plane[i][l] += t * background;
            }
        }
    }
    TileImage { planes, transmittance }
}

/// One plane of an image, cut to a tile; zero outside the image.
#[inline(always)]
fn cut(image: &Image, channel: usize, origin: [usize; 2]) -> Plane {
    let plane = image.plane(channel);
    let mut out = [ZERO; TILE * BLOCKS];
    let width = TILE.min(image.width - origin[0]);
    for row in 0..TILE.min(image.height - origin[1]) {
        let line = &plane[(origin[1] + row) * image.width + origin[0]..][..width];
        out[row * BLOCKS..][..BLOCKS].as_flattened_mut()[..width].copy_from_slice(line);
    }
    out
}

#[inline(always)]
fn sum(lanes: Lanes) -> f32 {
    ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]))
}

/// Backward of one tile. Overwrites `v_pairs`.
///
/// - `colors`: `[N, C]`
/// - `image`, `v_image`: `[C, H, W]`, the finished image and its gradient
/// - `v_pairs`: `[pairs of the tile, PAIR_GRADS + C]`
#[multiversion(targets("x86_64+avx2"))]
pub(super) fn rasterize_bwd<const C: usize>(
    tiles: &Tiles,
    tile: usize,
    colors: &[f32],
    settings: &RenderSettings,
    image: &Image,
    v_image: &Image,
    v_pairs: &mut [f32],
) {
    let origin = origin(tiles, tile);
    let mut transmittance = start_transmittance(origin, image.width, image.height);
    let v_planes: [Plane; C] = std::array::from_fn(|channel| cut(v_image, channel, origin));
    // Σ over channels of image · v_image, less what was blended so far: all channels, statistic's alone.
    let mut behind = [ZERO; TILE * BLOCKS];
    let mut behind_statistic = [ZERO; TILE * BLOCKS];
    for (channel, v_plane) in v_planes.iter().enumerate() {
        let plane = cut(image, channel, origin);
        for i in 0..TILE * BLOCKS {
            for l in 0..LANES {
                behind[i][l] += plane[i][l] * v_plane[i][l];
                if channel < settings.statistic_channels {
                    behind_statistic[i][l] += plane[i][l] * v_plane[i][l];
                }
            }
        }
    }
    let statistic: [f32; C] = std::array::from_fn(|c| f32::from(u8::from(c < settings.statistic_channels)));

    let mut batch: Vec<(Splat, [f32; C])> = Vec::with_capacity(BATCH);
    let pairs = tiles.pair_splats[tiles.pairs(tile)].chunks(BATCH);
    for (pairs, v_pairs) in pairs.zip(v_pairs.chunks_mut(BATCH * (PAIR_GRADS + C))) {
        if finished(&transmittance) {
            v_pairs.fill(0.0);
            continue;
        }
        take_batch::<C>(tiles, pairs, colors, &mut batch);
        for ((splat, color), v_pair) in batch.iter().zip(v_pairs.chunks_exact_mut(PAIR_GRADS + C)) {
            let statistic_color: [f32; C] = std::array::from_fn(|c| color[c] * statistic[c]);
            let (rows, blocks) = reach(splat, origin);
            // Moments of g = −∂L/∂exponent about the splat's centre.
            let (mut g_sum, mut g_x, mut g_y, mut g_xx, mut g_xy, mut g_yy) = (ZERO, ZERO, ZERO, ZERO, ZERO, ZERO);
            let (mut s_x, mut s_y) = (ZERO, ZERO);
            let mut v_color = [ZERO; C];
            for row in rows {
                let dy = (origin[1] + row) as f32 + 0.5 - splat.mean2d[1];
                for block in blocks.clone() {
                    let i = row * BLOCKS + block;
                    let x = (origin[0] + block * LANES) as f32 + 0.5;
                    let blended = blend(splat, x, dy, &mut transmittance[i]);
                    let mut own = ZERO;
                    let mut own_statistic = ZERO;
                    for c in 0..C {
                        for l in 0..LANES {
                            let v = v_planes[c][i][l];
                            own[l] += color[c] * v;
                            own_statistic[l] += statistic_color[c] * v;
                            v_color[c][l] += blended.blend_weight[l] * v;
                        }
                    }
                    for l in 0..LANES {
                        let (weight, alpha) = (blended.blend_weight[l], blended.alpha[l]);
                        behind[i][l] -= weight * own[l];
                        behind_statistic[i][l] -= weight * own_statistic[l];
                        let moves = (weight > 0.0) & !blended.clamped[l];
                        let ratio = alpha / (1.0 - alpha);
                        let g = if moves { weight * own[l] - behind[i][l] * ratio } else { 0.0 };
                        let s = if moves { weight * own_statistic[l] - behind_statistic[i][l] * ratio } else { 0.0 };
                        let dx = blended.dx[l];
                        let g_dx = g * dx;
                        g_sum[l] += g;
                        g_x[l] += g_dx;
                        g_y[l] += g * dy;
                        g_xx[l] += g_dx * dx;
                        g_xy[l] += g_dx * dy;
                        g_yy[l] += g * dy * dy;
                        s_x[l] += s * dx;
                        s_y[l] += s * dy;
                    }
                }
            }
            let [a, b, c] = splat.conic;
            let (x, y, sx, sy) = (sum(g_x), sum(g_y), sum(s_x), sum(s_y));
            v_pair[..PAIR_GRADS].copy_from_slice(&[
                a * x + b * y,
                b * x + c * y,
                -0.5 * sum(g_xx),
                -sum(g_xy),
                -0.5 * sum(g_yy),
                sum(g_sum) / splat.opacity,
                a * sx + b * sy,
                b * sx + c * sy,
            ]);
            for (v, lanes) in v_pair[PAIR_GRADS..].iter_mut().zip(v_color) {
                *v = sum(lanes);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp_neg_follows_exp() {
        for i in 0..60_000 {
            let x = i as f32 * 1e-3;
            let (found, expected) = (f64::from(exp_neg(x)), (-f64::from(x)).exp());
            assert!((found / expected - 1.0).abs() < 4e-7 + f64::from(x) * 1e-7, "{x}: {found} against {expected}");
        }
    }
}
