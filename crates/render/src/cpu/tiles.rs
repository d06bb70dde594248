//! The sorted list of splats of each tile.
//!
//! Depths are sorted once over all splats. Tiles then take their splats in that order, so each tile's list is sorted
//! too. One (tile, splat) combination is a *pair*; pairs lie tile by tile.

use std::ops::Range;

use multiversion::multiversion;
use rayon::prelude::*;
use tcgs_core::{Activated, Camera};

use crate::project::{SplatCamera, project};
use crate::settings::MIN_ALPHA;
use crate::tiling::{EXTENT_FACTOR, EXTENT_MARGIN_PX, TILE, tile_grid};
use crate::{Laps, PairCounts, TileMask};

/// Gaussians that one task projects.
const CHUNK: usize = 1 << 10;

/// A splat that reaches at least one pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Splat {
    pub mean2d: [f32; 2],
    pub conic: [f32; 3],
    pub opacity: f32,
    depth: f32,
    /// Half-open pixel ranges outside which alpha is below [`MIN_ALPHA`].
    pub columns: [u32; 2],
    pub rows: [u32; 2],
    /// Index of the Gaussian.
    pub gaussian: u32,
}

impl Splat {
    fn tile_range(range: [u32; 2]) -> Range<usize> {
        range[0] as usize / TILE..(range[1] as usize).div_ceil(TILE)
    }

    /// Columns and rows of the pixels that the splat may reach.
    fn pixels(&self) -> [Range<usize>; 2] {
        [self.columns, self.rows].map(|[first, end]| first as usize..end as usize)
    }

    fn meets(&self, mask: &TileMask) -> bool {
        let [columns, rows] = self.pixels();
        mask.meets(columns, rows)
    }
}

/// All splats of a view and the tiles they fall into.
#[derive(Debug)]
pub(super) struct Tiles {
    pub num_gaussians: usize,
    /// Width and height of the image, pixels.
    pub size: [usize; 2],
    pub splats: Vec<Splat>,
    /// Tiles in a row and in a column.
    pub grid: [usize; 2],
    /// `[tiles + 1]` first pair of each tile.
    pub starts: Vec<u32>,
    /// `[pairs]` index into `splats`, sorted by tile, then depth.
    pub pair_splats: Vec<u32>,
    /// `[splats + 1]` first of each splat's entries in `splat_pairs`.
    pub splat_starts: Vec<u32>,
    /// `[pairs]` the pairs of each splat: tile, and position among its pairs.
    pub splat_pairs: Vec<[u32; 2]>,
}

/// Half-open range of pixels whose centre lies within `center ± extent`, inside `0..size`.
#[inline(always)]
fn pixel_range(center: f32, extent: f32, size: usize) -> [u32; 2] {
    let first = (center - extent - 0.5).ceil().clamp(0.0, size as f32);
    let end = ((center + extent - 0.5).floor() + 1.0).clamp(0.0, size as f32);
    [first as u32, end as u32]
}

#[inline(always)]
fn splat(gaussians: &Activated, index: usize, camera: &Camera, splat_camera: &SplatCamera<f32>) -> Option<Splat> {
    let opacity = gaussians.opacities[index];
    if opacity < MIN_ALPHA as f32 || opacity.is_nan() {
        return None;
    }
    let p = project(gaussians.means[index], gaussians.quats[index], gaussians.scales[index], splat_camera)?;
    let opacity = if gaussians.is_antialiased { opacity * p.kept_opacity() } else { opacity };
    if opacity < MIN_ALPHA as f32 {
        return None;
    }
    // alpha >= MIN_ALPHA  <=>  exponent <= ln(opacity / MIN_ALPHA), an ellipse.
    let reach = 2.0 * (opacity / MIN_ALPHA as f32).ln().max(0.0);
    let extent = |variance: f32| (reach * variance).sqrt() * EXTENT_FACTOR + EXTENT_MARGIN_PX;
    let columns = pixel_range(p.mean2d[0], extent(p.covariance2d[0]), camera.width);
    let rows = pixel_range(p.mean2d[1], extent(p.covariance2d[2]), camera.height);
    (columns[0] < columns[1] && rows[0] < rows[1]).then_some(Splat {
        mean2d: p.mean2d,
        conic: p.conic,
        opacity,
        depth: p.depth,
        columns,
        rows,
        gaussian: index as u32,
    })
}

/// The splats of the Gaussians that reach a pixel, in the order of the Gaussians.
///
/// - `mask`: tiles to consider; `None` for all
fn splats(gaussians: &Activated, camera: &Camera, mask: Option<&TileMask>) -> Vec<Splat> {
    let (splat_camera, num_gaussians) = (SplatCamera::new(camera), gaussians.num_gaussians());
    let chunks: Vec<Vec<Splat>> = (0..num_gaussians)
        .into_par_iter()
        .step_by(CHUNK)
        .map(|begin| splats_of(gaussians, begin..(begin + CHUNK).min(num_gaussians), camera, &splat_camera, mask))
        .collect();
    chunks.concat()
}

/// The splats of consecutive Gaussians. It is compiled for AVX2 as well, which rounds by an instruction rather than by
/// a call; the bits are the same.
#[multiversion(targets("x86_64+avx2"))]
fn splats_of(
    gaussians: &Activated,
    indices: Range<usize>,
    camera: &Camera,
    splat_camera: &SplatCamera<f32>,
    mask: Option<&TileMask>,
) -> Vec<Splat> {
    let mut splats = Vec::with_capacity(indices.len());
    for index in indices {
        if let Some(splat) = splat(gaussians, index, camera, splat_camera)
            && mask.is_none_or(|mask| splat.meets(mask))
        {
            splats.push(splat);
        }
    }
    splats
}

/// The tiles of an image that Gaussians reach. A tile is reached if, in one of its pixels, a single Gaussian seen alone
/// has an alpha of at least [`MIN_ALPHA`]. A few more tiles count too, because a bounding box replaces each ellipse.
pub fn tiles_reached(gaussians: &Activated, camera: &Camera) -> TileMask {
    let mut tiles = TileMask::none(camera.width, camera.height);
    for splat in splats(gaussians, camera, None) {
        let [columns, rows] = splat.pixels();
        tiles.insert_pixels(columns, rows);
    }
    tiles
}

/// Indices of the Gaussians that reach a set of tiles in the sense of [`tiles_reached`], ascending.
///
/// # Panics
/// If `mask` is not of the camera's size.
pub fn gaussians_reaching(gaussians: &Activated, camera: &Camera, mask: &TileMask) -> Vec<u32> {
    assert_eq!(mask.grid(), tile_grid(camera.width, camera.height), "a mask of another image's tiles");
    splats(gaussians, camera, Some(mask)).iter().map(|splat| splat.gaussian).collect()
}

/// Counts the splats of an image, and its pairs of a splat and a tile, without holding them in memory.
pub fn count_pairs(gaussians: &Activated, camera: &Camera) -> PairCounts {
    let splats = splats(gaussians, camera, None);
    let pairs_of = |s: &Splat| Splat::tile_range(s.rows).len() * Splat::tile_range(s.columns).len();
    PairCounts { pairs: splats.par_iter().map(pairs_of).sum(), splats: splats.len() }
}

impl Tiles {
    /// - `mask`: the tiles to draw, which alone have pairs; `None` for all
    ///
    /// # Panics
    /// If there are more than `u32::MAX` pairs; see [`count_pairs`].
    pub fn new(gaussians: &Activated, camera: &Camera, mask: Option<&TileMask>, laps: &mut Laps) -> Self {
        let splats = splats(gaussians, camera, mask);
        laps.lap("project");

        // Depths are positive, so their bits sort like their values; equal depths sort by index.
        let mut order: Vec<u64> =
            splats.par_iter().enumerate().map(|(i, s)| u64::from(s.depth.to_bits()) << 32 | i as u64).collect();
        order.par_sort_unstable();

        let grid = tile_grid(camera.width, camera.height);
        let mut starts = vec![0_u32; grid[0] * grid[1] + 1];
        let mut splat_starts = Vec::with_capacity(splats.len() + 1);
        let mut num_pairs = 0_u64;
        for s in &splats {
            splat_starts.push(num_pairs as u32);
            for row in Splat::tile_range(s.rows) {
                for column in Splat::tile_range(s.columns) {
                    let tile = row * grid[0] + column;
                    if mask.is_none_or(|mask| mask.contains(tile)) {
                        starts[tile + 1] += 1;
                        num_pairs += 1;
                    }
                }
            }
        }
        assert!(num_pairs <= u32::MAX.into(), "{num_pairs} pairs of splats and tiles, expected at most {}", u32::MAX);
        splat_starts.push(num_pairs as u32);
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }

        let mut next = starts.clone();
        let mut pair_splats = vec![0; num_pairs as usize];
        let mut splat_pairs = vec![[0; 2]; num_pairs as usize];
        for key in order {
            let index = key as u32;
            let s = &splats[index as usize];
            let mut entry = splat_starts[index as usize] as usize;
            for row in Splat::tile_range(s.rows) {
                for column in Splat::tile_range(s.columns) {
                    let tile = row * grid[0] + column;
                    if mask.is_none_or(|mask| mask.contains(tile)) {
                        let slot = &mut next[tile];
                        pair_splats[*slot as usize] = index;
                        splat_pairs[entry] = [tile as u32, *slot - starts[tile]];
                        *slot += 1;
                        entry += 1;
                    }
                }
            }
        }
        laps.lap("sort");
        let (num_gaussians, size) = (gaussians.num_gaussians(), [camera.width, camera.height]);
        Self { num_gaussians, size, splats, grid, starts, pair_splats, splat_starts, splat_pairs }
    }

    /// Pairs of one tile.
    pub fn pairs(&self, tile: usize) -> Range<usize> {
        self.starts[tile] as usize..self.starts[tile + 1] as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_range_holds_the_centres_inside() {
        assert_eq!(pixel_range(4.0, 1.0, 16), [3, 5]); // centres 3.5 and 4.5
        assert_eq!(pixel_range(4.5, 1.0, 16), [3, 6]); // 3.5, 4.5, 5.5: bounds included
        assert_eq!(pixel_range(-3.0, 1.0, 16), [0, 0]);
        assert_eq!(pixel_range(20.0, 100.0, 16), [0, 16]);
    }
}
