//! A set of an image's tiles: the ones that a rendering draws.

use std::ops::Range;

use crate::tiling::{TILE, tile_grid};

/// A set of the tiles of one image. Tiles are squares of [`TILE`] pixels, numbered row by row; those at the right and
/// lower edge may reach beyond the image.
///
/// ```
/// use tcgs_render::TileMask;
/// let mut tiles = TileMask::none(40, 20);
/// tiles.insert_pixels(15..17, 0..1);
/// assert_eq!((tiles.grid(), tiles.iter().collect::<Vec<_>>()), ([3, 2], vec![0, 1]));
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileMask {
    grid: [usize; 2],
    is_marked: Vec<bool>,
}

impl TileMask {
    /// No tile of an image of `width` x `height` pixels.
    pub fn none(width: usize, height: usize) -> Self {
        let grid = tile_grid(width, height);
        Self { grid, is_marked: vec![false; grid[0] * grid[1]] }
    }

    /// All tiles of an image of `width` x `height` pixels.
    pub fn all(width: usize, height: usize) -> Self {
        let none = Self::none(width, height);
        Self { is_marked: vec![true; none.is_marked.len()], ..none }
    }

    /// Tiles in a row and in a column.
    pub fn grid(&self) -> [usize; 2] {
        self.grid
    }

    /// The tile that holds a pixel.
    pub fn of_pixel(&self, [x, y]: [usize; 2]) -> usize {
        y / TILE * self.grid[0] + x / TILE
    }

    /// Whether the set holds a tile.
    ///
    /// # Panics
    /// If the image has no such tile.
    #[inline]
    pub fn contains(&self, tile: usize) -> bool {
        self.is_marked[tile]
    }

    /// Adds one tile.
    ///
    /// # Panics
    /// If the image has no such tile.
    pub fn insert(&mut self, tile: usize) {
        self.is_marked[tile] = true;
    }

    /// Adds the tiles that hold a pixel of `columns` and `rows`; pixels beyond the last tile are ignored.
    pub fn insert_pixels(&mut self, columns: Range<usize>, rows: Range<usize>) {
        for tile in self.tiles_of(columns, rows) {
            self.is_marked[tile] = true;
        }
    }

    /// Whether the set holds a tile with a pixel of `columns` and `rows`.
    pub fn meets(&self, columns: Range<usize>, rows: Range<usize>) -> bool {
        self.tiles_of(columns, rows).any(|tile| self.is_marked[tile])
    }

    fn tiles_of(&self, columns: Range<usize>, rows: Range<usize>) -> impl Iterator<Item = usize> + use<> {
        let [across, down] = self.grid;
        let range = |pixels: Range<usize>, end: usize| pixels.start / TILE..pixels.end.div_ceil(TILE).min(end);
        let (columns, rows) = (range(columns, across), range(rows, down));
        rows.flat_map(move |row| columns.clone().map(move |column| row * across + column))
    }

    /// Adds all tiles of `other`.
    ///
    /// # Panics
    /// If `other` is of an image with another number of tiles.
    pub fn union(&mut self, other: &Self) {
        assert_eq!(self.grid, other.grid, "tiles of two images");
        self.is_marked.iter_mut().zip(&other.is_marked).for_each(|(own, &other)| *own |= other);
    }

    /// The tiles of the set, in ascending order.
    pub fn iter(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.is_marked.len()).filter(|&tile| self.is_marked[tile])
    }

    /// Number of tiles in the set.
    pub fn len(&self) -> usize {
        self.iter().count()
    }

    /// Whether the set holds no tile.
    pub fn is_empty(&self) -> bool {
        self.iter().next().is_none()
    }

    /// Columns and rows of a tile's pixels in an image of `width` x `height` pixels.
    pub fn pixels(&self, tile: usize, width: usize, height: usize) -> [Range<usize>; 2] {
        let [x, y] = [tile % self.grid[0] * TILE, tile / self.grid[0] * TILE];
        [x..(x + TILE).min(width), y..(y + TILE).min(height)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_mark_the_tiles_that_hold_them() {
        let mut tiles = TileMask::none(50, 33);
        assert_eq!((tiles.grid(), tiles.is_empty()), ([4, 3], true));
        tiles.insert_pixels(0..16, 16..17);
        tiles.insert_pixels(47..200, 32..90);
        assert_eq!(tiles.iter().collect::<Vec<_>>(), [4, 10, 11]);
        assert!(tiles.meets(10..40, 20..21) && !tiles.meets(16..200, 0..32) && !tiles.meets(0..0, 16..17));
        let mut both = TileMask::none(50, 33);
        both.insert(0);
        both.union(&tiles);
        assert_eq!((both.len(), TileMask::all(50, 33).len()), (4, 12));
        assert_eq!(tiles.pixels(11, 50, 33), [48..50, 32..33]);
    }
}
