//! A scenery as the shaders read it: lists of Gaussians and of tiles, and the pixels that the losses compare with.
//!
//! Rows of the state come first among the Gaussians, so that a shader recognises them by their index. Lists of views
//! keep the scene's order, in which Gaussians of equal depth are drawn.
//!
//! Each view has its drawn tiles and a *ring* around these: the tiles beside them, also across corners. SSIM of a pixel
//! reaches 5 pixels to each side, and the gradient of a pixel sums as far. So pixels more than 10 away change no
//! gradient in the drawn tiles, and a tile is 16 wide. A ring's pixels are constant, and lie in memory tile by tile.

use rayon::prelude::*;
use tcgs_core::{Activated, Image};
use tcgs_render::device::{ViewPart, pack};
use tcgs_render::{TILE, TileMask};

use crate::engine::{Scenery, Target, ViewScenery};

/// The slot of a tile that is neither drawn nor in the ring.
pub(crate) const NO_SLOT: u32 = u32::MAX;
/// Pixels of a tile.
const PIXELS: usize = TILE * TILE;

/// One view of a scenery, and where its lists and pixels begin, in values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct ListedView {
    /// The part of the scene that the renderer draws.
    pub part: ViewPart,
    /// Number of tiles drawn and in the ring.
    pub num_near: u32,
    /// Position of the first slot in [`SceneryLists::lists`].
    pub slots_at: u32,
    /// Position of the first pixel in [`SceneryLists::targets`].
    pub targets_at: u32,
    /// Position of the first value in [`SceneryLists::pictures`].
    pub pictures_at: u32,
    /// Position of the first value in [`SceneryLists::colors`].
    pub colors_at: u32,
}

/// A scenery in arrays.
#[derive(Debug)]
pub(crate) struct SceneryLists {
    /// `D`: the rows of the state, then the other Gaussians that are drawn.
    pub num_drawn: usize,
    /// Number of rows of the state among them.
    pub num_rows: usize,
    /// `[(11 + C) D]`, in the order of [`pack`].
    pub activated: Vec<f32>,
    /// View after view: `[L]` Gaussians in the scene's order; `[tiles of the image]` the slot of each, or [`NO_SLOT`];
    /// `[slots]` the tile of each, first those that are drawn, then the ring.
    pub lists: Vec<u32>,
    /// View after view, `[slots, 256]`: pixels of the target, [`target_word`]; 0 beyond the image.
    pub targets: Vec<u32>,
    /// View after view, `[ring, C, 256]`: pixels of the picture; 0 beyond the image.
    pub pictures: Vec<f32>,
    /// View after view, `[L, C]`: colours of the listed Gaussians as the view's camera sees them. Empty if all cameras
    /// see the colours of `activated`.
    pub colors: Vec<f32>,
    /// `[cameras]`
    pub views: Vec<ListedView>,
}

impl SceneryLists {
    /// - `targets`: `[cameras]`
    pub fn new(scenery: &Scenery, targets: &[Target]) -> Self {
        let Scenery { num_active, drawn, places, views } = scenery;
        assert_eq!(views.len(), targets.len(), "views of the scenery against targets");
        let (num_drawn, num_rows) = (drawn.num_gaussians(), places.len());
        let (order, number_of) = rows_first(places, num_drawn);
        let mut all = Self {
            num_drawn,
            num_rows,
            activated: pack(&drawn.select(&order)),
            lists: Vec::new(),
            targets: Vec::new(),
            pictures: Vec::new(),
            colors: Vec::new(),
            views: Vec::with_capacity(views.len()),
        };
        let pixels: Vec<Near> =
            views.par_iter().zip(targets).map(|(view, target)| Near::new(view, &target.image, drawn)).collect();
        for (view, near) in views.iter().zip(pixels) {
            let [num_listed, lists_at] = [view.gaussians.len(), all.lists.len()].map(|x| x as u32);
            let part = ViewPart {
                num_listed,
                num_rows: num_rows as u32,
                num_active: *num_active as u32,
                num_tiles: near.num_tiles as u32,
                lists_at,
            };
            all.views.push(ListedView {
                part,
                num_near: near.tiles.len() as u32,
                slots_at: lists_at + num_listed,
                targets_at: all.targets.len() as u32,
                pictures_at: all.pictures.len() as u32,
                colors_at: all.colors.len() as u32,
            });
            all.colors.extend(view.colors.iter().flatten());
            all.lists.extend(view.gaussians.iter().map(|&i| number_of[i as usize]));
            all.lists.extend(near.slots);
            all.lists.extend(near.tiles);
            all.targets.extend(near.targets);
            all.pictures.extend(near.pictures);
        }
        all
    }

    /// Most Gaussians that one view lists.
    pub fn max_listed(&self) -> usize {
        self.views.iter().map(|view| view.part.num_listed).max().unwrap_or(0) as usize
    }

    /// Most tiles that one view draws, and most with the ring.
    pub fn max_tiles(&self) -> [usize; 2] {
        let max = |of: fn(&ListedView) -> u32| self.views.iter().map(of).max().unwrap_or(0) as usize;
        [max(|view| view.part.num_tiles), max(|view| view.num_near)]
    }
}

/// An order with the rows first, and each Gaussian's position in it.
fn rows_first(places: &[u32], num_drawn: usize) -> (Vec<usize>, Vec<u32>) {
    let mut order: Vec<usize> = places.iter().map(|&place| place as usize).collect();
    let mut is_row = vec![false; num_drawn];
    order.iter().for_each(|&i| is_row[i] = true);
    order.extend((0..num_drawn).filter(|&i| !is_row[i]));
    let mut number_of = vec![0; num_drawn];
    order.iter().enumerate().for_each(|(number, &i)| number_of[i] = number as u32);
    (order, number_of)
}

/// The tiles of one view, those around them, and their pixels.
struct Near {
    num_tiles: usize,
    slots: Vec<u32>,
    tiles: Vec<u32>,
    targets: Vec<u32>,
    pictures: Vec<f32>,
}

impl Near {
    fn new(view: &ViewScenery, target: &Image, drawn: &Activated) -> Self {
        let ViewScenery { tiles: mask, picture, .. } = view;
        let mut tiles: Vec<u32> = mask.iter().map(|tile| tile as u32).collect();
        let num_tiles = tiles.len();
        tiles.extend(ring(mask));
        let [columns, rows] = mask.grid();
        let mut slots = vec![NO_SLOT; columns * rows];
        tiles.iter().enumerate().for_each(|(slot, &tile)| slots[tile as usize] = slot as u32);
        let mut targets = vec![0; tiles.len() * PIXELS];
        let mut pictures = vec![0.0; (tiles.len() - num_tiles) * drawn.num_channels * PIXELS];
        for (slot, &tile) in tiles.iter().enumerate() {
            let [xs, ys] = mask.pixels(tile as usize, target.width, target.height);
            for (y, row) in ys.enumerate() {
                for (x, column) in xs.clone().enumerate() {
                    let (pixel, within) = (row * target.width + column, y * TILE + x);
                    targets[slot * PIXELS + within] = target_word(target, pixel);
                    if slot >= num_tiles {
                        for channel in 0..drawn.num_channels {
                            let at = ((slot - num_tiles) * drawn.num_channels + channel) * PIXELS + within;
                            pictures[at] = picture.plane(channel)[pixel];
                        }
                    }
                }
            }
        }
        Self { num_tiles, slots, tiles, targets, pictures }
    }
}

/// The tiles beside those of a set, also across corners, without the set; ascending.
fn ring(mask: &TileMask) -> impl Iterator<Item = u32> + '_ {
    let [columns, rows] = mask.grid();
    let around = move |x: usize, end: usize| x.saturating_sub(1)..(x + 2).min(end);
    (0..columns * rows)
        .filter(move |&tile| {
            let mut beside = around(tile / columns, rows)
                .flat_map(|row| around(tile % columns, columns).map(move |column| row * columns + column));
            !mask.contains(tile) && beside.any(|other| mask.contains(other))
        })
        .map(|tile| tile as u32)
}

/// A pixel of a target as one word of 8 bits per channel: red in the lowest byte, then green, blue and foreground.
/// Foreground is 0 without segmentation.
pub(crate) fn target_word(image: &Image, pixel: usize) -> u32 {
    let channel = |c: usize| if c < image.num_channels { image.plane(c)[pixel] } else { 0.0 };
    u32::from_le_bytes([0, 1, 2, 3].map(|c| (channel(c) * 255.0).round() as u8))
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Camera, Gaussians, activate};

    use super::*;

    const SIZE: [usize; 2] = [70, 50];

    fn scenery() -> (Scenery, Vec<Target>) {
        let mut gaussians = Gaussians::zeros(6);
        gaussians.means_mut().iter_mut().enumerate().for_each(|(i, mean)| mean[0] = i as f32);
        let [width, height] = SIZE;
        let mut tiles = TileMask::none(width, height);
        [6, 19].into_iter().for_each(|tile| tiles.insert(tile));
        let mut picture = Image::filled(width, height, 3, 0.0);
        picture.data.iter_mut().enumerate().for_each(|(i, value)| *value = i as f32);
        let image = Image { data: picture.data.iter().map(|v| (v % 256.0) / 255.0).collect(), ..picture.clone() };
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, width, height);
        let target = Target { camera, image };
        let none = ViewScenery {
            tiles: TileMask::none(width, height),
            gaussians: Vec::new(),
            colors: None,
            picture: Image::default(),
        };
        let view = ViewScenery { tiles, gaussians: vec![0, 1, 2, 4, 5], colors: None, picture };
        let views = vec![none, view.clone(), ViewScenery { gaussians: (0..6).collect(), ..view }];
        let scenery = Scenery { num_active: 1, drawn: activate(&gaussians), places: vec![4, 1], views };
        (scenery, vec![target; 3])
    }

    #[test]
    fn rows_come_first_and_lists_keep_the_scenes_order() {
        let (scenery, targets) = scenery();
        let lists = SceneryLists::new(&scenery, &targets);
        assert_eq!((lists.num_drawn, lists.num_rows), (6, 2));
        let firsts: Vec<f32> = lists.activated[..18].iter().step_by(3).copied().collect();
        assert_eq!(firsts, [4.0, 1.0, 0.0, 2.0, 3.0, 5.0]);
        let listed = |view: &ListedView| &lists.lists[view.part.lists_at as usize..][..view.part.num_listed as usize];
        assert_eq!(listed(&lists.views[1]), [2, 1, 3, 0, 5]);
        assert_eq!(listed(&lists.views[2]), [2, 1, 3, 4, 0, 5]);
        assert_eq!((lists.views[0].part.num_listed, lists.views[0].num_near), (0, 0));
    }

    #[test]
    fn a_ring_surrounds_the_tiles_and_has_the_pictures_pixels() {
        let (scenery, targets) = scenery();
        let lists = SceneryLists::new(&scenery, &targets);
        let view = lists.views[2];
        // 5 x 4 tiles; 6 lies inside, 19 is the last one.
        let ring = [0, 1, 2, 5, 7, 10, 11, 12, 13, 14, 18];
        let slots = &lists.lists[view.slots_at as usize..][..20];
        let near = &lists.lists[view.slots_at as usize + 20..][..view.num_near as usize];
        assert_eq!(near, [&[6, 19], &ring[..]].concat());
        assert_eq!((slots[6], slots[19], slots[0], slots[3]), (0, 1, 2, NO_SLOT));
        assert_eq!(lists.max_tiles(), [2, 13]);
        assert_eq!(lists.pictures.len(), 2 * 11 * 3 * PIXELS);
        // Tile 18 has columns 48 to 63 and rows 48 and 49; its pixel (50, 49) in the second channel.
        let pixel = 49 * SIZE[0] + 50;
        let at = view.pictures_at as usize + (10 * 3 + 1) * PIXELS + TILE + 2;
        assert_eq!(lists.pictures[at], scenery.views[2].picture.plane(1)[pixel]);
        let word = lists.targets[view.targets_at as usize + 12 * PIXELS + TILE + 2];
        assert_eq!(word, target_word(&targets[2].image, pixel));
        assert_eq!(word.to_le_bytes()[3], 0);
        // Below the image there is nothing.
        assert_eq!(lists.pictures[at + TILE], 0.0);
    }
}
