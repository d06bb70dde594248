//! The sorted list of splats of each tile.
//!
//! Splats are sorted once by depth. Tiles then take them in that order, so each tile's list is sorted too. One (tile,
//! splat) combination is a *pair*; pairs lie tile by tile.

use std::ops::Range;

use multiversion::multiversion;
use rayon::prelude::*;
use tcgs_core::{Activated, Camera, Pinhole};

use crate::project::{SplatCamera, project};
use crate::settings::{BLUR_VARIANCE, MIN_ALPHA};
use crate::tiling::{EXTENT_FACTOR, EXTENT_MARGIN_PX, TILE, tile_grid};
use crate::{Laps, PairCounts, TileMask};

/// Gaussians that one task projects.
const CHUNK: usize = 1 << 10;

/// Most parts of the splats, which make their pairs at the same time.
const PARTS: usize = 16;

/// Error of the exponent in blending, relative to its terms. They are rounded, and their sum may be far smaller.
const SPAN_ROUNDING: f64 = 1e-6;

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

/// A splat in a tile.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pair {
    /// Index of the splat.
    pub splat: u32,
    /// Half-open range of the tile's rows outside which alpha is below [`MIN_ALPHA`].
    pub rows: [u8; 2],
}

impl Splat {
    fn tile_range(range: [u32; 2]) -> Range<usize> {
        range[0] as usize / TILE..(range[1] as usize).div_ceil(TILE)
    }

    /// Columns and rows of the pixels that the splat may reach.
    fn pixels(&self) -> [Range<usize>; 2] {
        [self.columns, self.rows].map(|[first, end]| first as usize..end as usize)
    }

    /// Half-open range of pixel rows that the splat reaches in each of its columns of tiles: where its ellipse
    /// `a x² + 2 b x y + c y² = reach` meets them. Wide splats have fewer rows in one column than in all together.
    ///
    /// - `see`: receives each column of tiles, and its rows
    #[inline(always)]
    fn for_each_span(&self, mut see: impl FnMut(usize, [u32; 2])) {
        let tiles = Self::tile_range(self.columns);
        if tiles.len() == 1 {
            see(tiles.start, self.rows);
            return;
        }
        let ([a, b, c], [x, y]) = (self.conic.map(f64::from), self.mean2d.map(f64::from));
        let determinant = a * c - b * b;
        if determinant.is_nan() || determinant <= 0.0 {
            tiles.for_each(|tile| see(tile, self.rows));
            return;
        }
        let margin = f64::from(EXTENT_MARGIN_PX);
        let [first, end] = self.columns.map(|column| f64::from(column) - x);
        let [top, bottom] = self.rows.map(|row| f64::from(row) - y);
        let [width, height] = [end.max(-first), bottom.max(-top)];
        let rounding = SPAN_ROUNDING * (a * width * width + c * height * height);
        let reach = reach(self.opacity) * f64::from(EXTENT_FACTOR).powi(2) + rounding;
        // The lowest and the highest point are this far aside. Half the height at `x` is the root of `square(x)`.
        let aside = b * (reach / (a * determinant)).sqrt();
        let (tilt, square) = (-b / c, |x: f64| reach / c - determinant / (c * c) * x * x);
        for tile in tiles {
            let edge = (tile * TILE) as f64 - x;
            let [left, right] = [edge.max(first) + 0.5 - margin, (edge + TILE as f64).min(end) - 0.5 + margin];
            let [low, high] = [aside, -aside].map(|x| x.clamp(left, right));
            let [below, above] = [low, high].map(square);
            if below.min(above) < 0.0 {
                continue;
            }
            let begin = (y + tilt * low - below.sqrt() - margin - 0.5).ceil().max(0.0) as u32;
            let end = ((y + tilt * high + above.sqrt() + margin - 0.5).floor() + 1.0).max(0.0) as u32;
            let span = [begin.max(self.rows[0]), end.min(self.rows[1])];
            if span[0] < span[1] {
                see(tile, span);
            }
        }
    }

    /// The splat's pairs.
    ///
    /// - `mask`: the tiles that have pairs; `None` for all
    /// - `see`: receives each tile, and the rows in it
    #[inline(always)]
    fn for_each_pair(&self, grid: [usize; 2], mask: Option<&TileMask>, mut see: impl FnMut(u32, [u8; 2])) {
        self.for_each_span(|column, span| {
            for row in Self::tile_range(span) {
                let tile = row * grid[0] + column;
                if mask.is_none_or(|mask| mask.contains(tile)) {
                    see(tile as u32, span.map(|end| (end as usize).saturating_sub(row * TILE).min(TILE) as u8));
                }
            }
        });
    }

    /// Sorts like depths, which are positive, and equal depths by Gaussian.
    fn key(&self) -> u64 {
        u64::from(self.depth.to_bits()) << 32 | u64::from(self.gaussian)
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
    /// Sorted by depth.
    pub splats: Vec<Splat>,
    /// Tiles in a row and in a column.
    pub grid: [usize; 2],
    /// `[tiles + 1]` first pair of each tile.
    pub starts: Vec<u32>,
    /// Sorted by tile, then depth.
    pub pairs: Vec<Pair>,
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

/// `a x² + 2 b x y + c y²` at which a splat's alpha is [`MIN_ALPHA`], with its conic `a, b, c`.
#[inline(always)]
fn reach(opacity: f32) -> f64 {
    f64::from(2.0 * (opacity / MIN_ALPHA as f32).ln().max(0.0))
}

/// Opacity up to which a splat's size has one bound. Dropout raises opacities above 1.
const MOST_OPAQUE: f32 = 2.0;

/// Tells Gaussians beside the image by a bound of their splats' size, which is cheaper than a projection.
struct Frame<'a> {
    camera: &'a SplatCamera<f32>,
    size: [f32; 2],
    /// Half extent of a splat as opaque as [`MOST_OPAQUE`], in standard deviations.
    deviations: f32,
    /// Bound of a splat's standard deviation along each axis, for a scale of 1 at a depth of 1, pixels.
    widths: [f32; 2],
}

impl<'a> Frame<'a> {
    fn new(camera: &'a SplatCamera<f32>) -> Self {
        let SplatCamera { pinhole, slope_min, slope_max } = camera;
        Self {
            camera,
            size: [pinhole.width as f32, pinhole.height as f32],
            deviations: (reach(MOST_OPAQUE) as f32).sqrt() * EXTENT_FACTOR,
            widths: std::array::from_fn(|i| pinhole.focal[i] * (1.0 + slope_max[i].max(-slope_min[i]))),
        }
    }

    /// Whether a Gaussian up to as opaque as [`MOST_OPAQUE`] is before the camera and beside its image.
    #[inline(always)]
    fn is_beside(&self, mean: [f32; 3], scale: [f32; 3]) -> bool {
        let Pinhole { focal, principal, .. } = &self.camera.pinhole;
        let point = self.camera.pinhole.camera_point(mean);
        let (depth, largest) = (point[2], scale.into_iter().fold(0.0, |most: f32, scale| most.max(scale.abs())));
        let is_beside = |i: usize| {
            let blurred = self.widths[i] * largest + BLUR_VARIANCE.sqrt() as f32 * depth;
            let extent = self.deviations * blurred + (1.0 + EXTENT_MARGIN_PX) * depth;
            // The centre, in pixels times depth.
            let center = focal[i] * point[i] + principal[i] * depth;
            center + extent < 0.0 || center - extent > self.size[i] * depth
        };
        depth > 0.0 && (is_beside(0) || is_beside(1))
    }
}

#[inline(always)]
fn splat(gaussians: &Activated, index: usize, frame: &Frame<'_>) -> Option<Splat> {
    let opacity = gaussians.opacities[index];
    let (mean, scale) = (gaussians.means[index], gaussians.scales[index]);
    if opacity < MIN_ALPHA as f32 || opacity.is_nan() {
        return None;
    }
    if opacity <= MOST_OPAQUE && frame.is_beside(mean, scale) {
        return None;
    }
    let p = project(mean, gaussians.quats[index], scale, frame.camera)?;
    let opacity = if gaussians.is_antialiased { opacity * p.kept_opacity() } else { opacity };
    if opacity < MIN_ALPHA as f32 {
        return None;
    }
    let reach = reach(opacity) as f32;
    let extent = |variance: f32| (reach * variance).sqrt() * EXTENT_FACTOR + EXTENT_MARGIN_PX;
    let columns = pixel_range(p.mean2d[0], extent(p.covariance2d[0]), frame.camera.pinhole.width);
    let rows = pixel_range(p.mean2d[1], extent(p.covariance2d[2]), frame.camera.pinhole.height);
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
/// - `among`: indices of the Gaussians to consider, ascending; `None` for all
/// - `mask`: tiles to consider; `None` for all
fn splats(gaussians: &Activated, camera: &Camera, among: Option<&[u32]>, mask: Option<&TileMask>) -> Vec<Splat> {
    let (splat_camera, num_gaussians) =
        (SplatCamera::new(camera), among.map_or(gaussians.num_gaussians(), <[u32]>::len));
    let chunks: Vec<Vec<Splat>> = (0..num_gaussians)
        .into_par_iter()
        .step_by(CHUNK)
        .map(|begin| splats_of(gaussians, among, begin..(begin + CHUNK).min(num_gaussians), &splat_camera, mask))
        .collect();
    chunks.concat()
}

/// The splats of consecutive Gaussians among some. It is compiled for AVX2 as well, which rounds by an instruction
/// rather than by a call; the bits are the same.
#[multiversion(targets("x86_64+avx2"))]
fn splats_of(
    gaussians: &Activated,
    among: Option<&[u32]>,
    indices: Range<usize>,
    camera: &SplatCamera<f32>,
    mask: Option<&TileMask>,
) -> Vec<Splat> {
    let mut splats = Vec::with_capacity(indices.len());
    let frame = Frame::new(camera);
    for index in indices {
        let gaussian = among.map_or(index, |among| among[index] as usize);
        if let Some(splat) = splat(gaussians, gaussian, &frame)
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
    for splat in splats(gaussians, camera, None, None) {
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
    splats(gaussians, camera, None, Some(mask)).iter().map(|splat| splat.gaussian).collect()
}

/// Counts the splats of an image, and its pairs of a splat and a tile, without holding them in memory.
pub fn count_pairs(gaussians: &Activated, camera: &Camera) -> PairCounts {
    let splats = splats(gaussians, camera, None, None);
    let num_pairs = |splat: &Splat| {
        let mut pairs = 0;
        splat.for_each_span(|_, span| pairs += Splat::tile_range(span).len());
        pairs
    };
    PairCounts { pairs: splats.par_iter().map(num_pairs).sum(), splats: splats.len() }
}

/// Splats of Gaussians that stay the same while others move, and their pairs, in some tiles of a view.
#[derive(Clone, Debug)]
pub(super) struct Locked {
    /// Indices of the Gaussians that move, ascending.
    moving: Vec<u32>,
    /// Sorted by depth.
    splats: Vec<Splat>,
    /// `[splats + 1]` first of each splat's entries in `pairs`.
    starts: Vec<u32>,
    /// Tile, and rows in it.
    pairs: Vec<(u32, [u8; 2])>,
}

impl Locked {
    pub fn new(gaussians: &Activated, camera: &Camera, mask: &TileMask, mut moving: Vec<u32>) -> Self {
        moving.sort_unstable();
        let mut splats = splats(gaussians, camera, None, Some(mask));
        splats.retain(|splat| moving.binary_search(&splat.gaussian).is_err());
        splats.sort_unstable_by_key(Splat::key);
        let (mut starts, mut pairs) = (vec![0], Vec::new());
        for splat in &splats {
            splat.for_each_pair(mask.grid(), Some(mask), |tile, rows| pairs.push((tile, rows)));
            starts.push(pairs.len() as u32);
        }
        Self { moving, splats, starts, pairs }
    }

    fn pairs_of(&self, splat: usize) -> &[(u32, [u8; 2])] {
        &self.pairs[self.starts[splat] as usize..self.starts[splat + 1] as usize]
    }
}

/// The splats to sort: locked ones, which are sorted already, and others.
struct Sources<'a> {
    locked: Option<&'a Locked>,
    /// In the order of the Gaussians.
    others: Vec<Splat>,
}

impl Sources<'_> {
    /// The places of all splats, sorted by depth. The locked ones have the first places, and the others come after.
    fn order(&self) -> Vec<u32> {
        // As `Splat::key`, since the others are in the order of the Gaussians.
        let key = |(i, splat): (usize, &Splat)| u64::from(splat.depth.to_bits()) << 32 | i as u64;
        let mut order: Vec<u64> = self.others.par_iter().enumerate().map(key).collect();
        order.par_sort_unstable();
        let others = order.iter().map(|&key| key as u32);
        let Some(Locked { splats: locked, .. }) = self.locked else { return others.collect() };
        let mut others = others.map(|other| other + locked.len() as u32).peekable();
        let mut merged = Vec::with_capacity(locked.len() + self.others.len());
        for (place, splat) in locked.iter().enumerate() {
            while let Some(other) = others.next_if(|&other| self.splat(other).key() < splat.key()) {
                merged.push(other);
            }
            merged.push(place as u32);
        }
        merged.extend(others);
        merged
    }

    /// The pairs of the splat at a place; none if it is not locked.
    fn locked_pairs(&self, place: u32) -> Option<&[(u32, [u8; 2])]> {
        self.locked
            .filter(|locked| (place as usize) < locked.splats.len())
            .map(|locked| locked.pairs_of(place as usize))
    }

    fn splat(&self, place: u32) -> &Splat {
        let locked = self.locked.map_or(&[][..], |locked| &locked.splats);
        locked.get(place as usize).unwrap_or_else(|| &self.others[place as usize - locked.len()])
    }
}

/// The pairs of some splats that follow one another in depth.
struct Part {
    /// Sorted by tile, then depth.
    pairs: Vec<Pair>,
    /// `[tiles + 1]` first pair of each tile.
    starts: Vec<u32>,
    /// `[splats]` number of pairs of each splat.
    counts: Vec<u32>,
    /// `[pairs]` the pairs of each splat: tile, and position among the part's pairs of that tile.
    splat_pairs: Vec<[u32; 2]>,
}

impl Part {
    /// - `splats`: sorted by depth
    /// - `places`: theirs in `sources`
    /// - `first`: index of the first of them
    fn new(
        splats: &[Splat],
        places: &[u32],
        first: usize,
        sources: &Sources<'_>,
        grid: [usize; 2],
        mask: Option<&TileMask>,
    ) -> Self {
        let mut found: Vec<(u32, Pair)> = Vec::with_capacity(4 * splats.len());
        let mut counts = Vec::with_capacity(splats.len());
        let mut starts = vec![0; grid[0] * grid[1] + 1];
        for (i, (splat, &place)) in splats.iter().zip(places).enumerate() {
            let begin = found.len();
            let mut see = |tile: u32, rows: [u8; 2]| {
                found.push((tile, Pair { splat: (first + i) as u32, rows }));
                starts[tile as usize + 1] += 1;
            };
            match sources.locked_pairs(place) {
                Some(pairs) => pairs.iter().for_each(|&(tile, rows)| see(tile, rows)),
                None => splat.for_each_pair(grid, mask, see),
            }
            counts.push((found.len() - begin) as u32);
        }
        sum_up(&mut starts);
        let mut next = starts.clone();
        let mut pairs = vec![Pair::default(); found.len()];
        let place = |(tile, pair): (u32, Pair)| {
            let slot = next[tile as usize];
            next[tile as usize] += 1;
            pairs[slot as usize] = pair;
            [tile, slot - starts[tile as usize]]
        };
        let splat_pairs = found.into_iter().map(place).collect();
        Self { pairs, starts, counts, splat_pairs }
    }

    /// Pairs of one tile.
    fn pairs_of(&self, tile: usize) -> &[Pair] {
        &self.pairs[self.starts[tile] as usize..self.starts[tile + 1] as usize]
    }
}

/// From counts after a first 0 to the first of each.
fn sum_up(starts: &mut [u32]) {
    (1..starts.len()).for_each(|i| starts[i] += starts[i - 1]);
}

impl Tiles {
    /// - `mask`: the tiles to draw, which alone have pairs; `None` for all
    /// - `locked`: the Gaussians that are as they were, in the same tiles
    ///
    /// # Panics
    /// If there are more than `u32::MAX` pairs; see [`count_pairs`].
    pub fn new(
        gaussians: &Activated,
        camera: &Camera,
        mask: Option<&TileMask>,
        locked: Option<&Locked>,
        laps: &mut Laps,
    ) -> Self {
        let others = splats(gaussians, camera, locked.map(|locked| locked.moving.as_slice()), mask);
        let sources = Sources { locked, others };
        laps.lap("project");

        let order = sources.order();
        let splats: Vec<Splat> = order.par_iter().map(|&place| *sources.splat(place)).collect();

        let grid = tile_grid(camera.width, camera.height);
        let num_tiles = grid[0] * grid[1];
        let part_size = CHUNK.max(splats.len().div_ceil(PARTS));
        let part = |(i, (splats, places)): (usize, (&[Splat], &[u32]))| {
            Part::new(splats, places, i * part_size, &sources, grid, mask)
        };
        let chunks = splats.par_chunks(part_size).zip(order.par_chunks(part_size));
        let mut parts: Vec<Part> = chunks.enumerate().map(part).collect();
        let num_pairs: usize = parts.iter().map(|part| part.pairs.len()).sum();
        assert!(num_pairs <= u32::MAX as usize, "{num_pairs} pairs of splats and tiles, expected at most {}", u32::MAX);

        let mut splat_starts = vec![0];
        splat_starts.extend(parts.iter().flat_map(|part| &part.counts));
        sum_up(&mut splat_starts);
        let mut starts = vec![0; num_tiles + 1];
        // `[parts, tiles]` pairs of each tile in the parts before.
        let mut before: Vec<Vec<u32>> = Vec::with_capacity(parts.len());
        for part in &parts {
            before.push(starts[1..].to_vec());
            (0..num_tiles).for_each(|tile| starts[tile + 1] += part.pairs_of(tile).len() as u32);
        }
        sum_up(&mut starts);
        let splat_pairs: Vec<Vec<[u32; 2]>> = parts
            .par_iter_mut()
            .zip(&before)
            .map(|(part, before)| {
                let mut splat_pairs = std::mem::take(&mut part.splat_pairs);
                splat_pairs.iter_mut().for_each(|[tile, position]| *position += before[*tile as usize]);
                splat_pairs
            })
            .collect();
        let splat_pairs = splat_pairs.concat();
        let tile_rows: Vec<Vec<Pair>> = (0..grid[1])
            .into_par_iter()
            .map(|row| {
                let tiles = row * grid[0]..(row + 1) * grid[0];
                let mut pairs = Vec::with_capacity((starts[tiles.end] - starts[tiles.start]) as usize);
                tiles.for_each(|tile| parts.iter().for_each(|part| pairs.extend_from_slice(part.pairs_of(tile))));
                pairs
            })
            .collect();
        let pairs = tile_rows.concat();
        laps.lap("sort");
        let (num_gaussians, size) = (gaussians.num_gaussians(), [camera.width, camera.height]);
        Self { num_gaussians, size, splats, grid, starts, pairs, splat_starts, splat_pairs }
    }

    /// Pairs of one tile.
    pub fn pairs_of(&self, tile: usize) -> &[Pair] {
        &self.pairs[self.starts[tile] as usize..self.starts[tile + 1] as usize]
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
