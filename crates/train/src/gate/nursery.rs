//! The scenery in which newborn and young Gaussians are trained: the tiles that they reach, among the rest of the
//! scene.

use tcgs_core::{Camera, View};
use tcgs_render::{TileMask, tiles_reached};

use super::activity::scenery_of;
use super::{Blocks, Gate, tiles_of};
use crate::engine::Scenery;
use crate::engine::cpu::Drawn;

/// The surroundings of a few Gaussians that learn all their attributes.
pub(crate) struct Nursery {
    pub scenery: Scenery,
    /// Positions of the views in which something is drawn.
    pub cameras: Vec<usize>,
}

impl Nursery {
    /// - `gate`: holds the pictures of the scene
    /// - `all`: the scene, including the Gaussians that learn
    /// - `rows`: indices of the Gaussians that learn
    /// - `unexplained`: `[views]`, drawn in addition to the tiles that they reach
    pub fn new(gate: &Gate, all: &Drawn, rows: &[usize], views: &[View], unexplained: Option<&[Blocks]>) -> Self {
        let pictures = gate.memory.as_ref().map_or(&[][..], |memory| &memory.pictures);
        let few = all.activated().select(rows);
        let of_view = |(i, view): (usize, &View)| {
            let mut tiles = tiles_reached(&few, &view.camera);
            if let Some(unexplained) = unexplained {
                tiles.union(&tiles_of(&unexplained[i], view.image.width, view.image.height));
            }
            tiles
        };
        let tiles: Vec<TileMask> = views.iter().enumerate().map(of_view).collect();
        let cameras: Vec<&Camera> = views.iter().map(|view| &view.camera).collect();
        let scenery = scenery_of(all, rows, rows.len(), &tiles, pictures, &cameras);
        Self { scenery, cameras: (0..views.len()).filter(|&i| !tiles[i].is_empty()).collect() }
    }
}
