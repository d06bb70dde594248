//! Division of an image into tiles, and bounds of a splat's tiles: the same in every renderer.

/// Tile side in pixels. On the CPU: wide enough that a row fills two vectors of eight lanes, small enough that a tile's
/// state stays in the first-level cache. On a GPU a tile's pixels are one workgroup.
pub const TILE: usize = 16;

/// The half extent of a splat in pixels is widened by this factor, so that rounding never drops a pixel that reaches
/// [`MIN_ALPHA`](crate::settings::MIN_ALPHA).
pub(crate) const EXTENT_FACTOR: f32 = 1.001;

/// The half extent is then widened by this many pixels.
pub(crate) const EXTENT_MARGIN_PX: f32 = 0.05;

/// Gradients of one pair of tile and splat before those of its colours: `mean2d` (2), `conic` (3), opacity, and the
/// densification statistic's `mean2d` (2).
pub(crate) const PAIR_GRADS: usize = 8;

/// Tiles in a row and in a column of an image; the last ones may reach beyond it.
pub fn tile_grid(width: usize, height: usize) -> [usize; 2] {
    [width.div_ceil(TILE), height.div_ceil(TILE)]
}
