//! What newborn Gaussians are trained in: the tiles that they reach, among the rest of the scene.

use tcgs_core::{Camera, View};
use tcgs_render::{TileMask, tiles_reached};

use super::activity::scenery_of;
use super::{Blocks, Gate, tiles_of};
use crate::engine::Scenery;
use crate::engine::cpu::Drawn;
use crate::state::State;

/// The surroundings of newborn Gaussians.
pub(crate) struct Nursery {
    pub scenery: Scenery,
    /// Positions of the views in which something is drawn.
    pub cameras: Vec<usize>,
}

impl Nursery {
    /// - `gate`: whose pictures are of `scene`
    /// - `small`: the state of the newborn, which come after all Gaussians of the scene
    /// - `unexplained`: `[views]`, drawn besides what the newborn reach
    pub fn new(gate: &Gate, scene: &State, small: &State, views: &[View], unexplained: &[Blocks]) -> Self {
        let pictures = gate.memory.as_ref().map_or(&[][..], |memory| &memory.pictures);
        let with_segmentation = pictures.first().is_some_and(|picture| picture.num_channels > 3);
        let born = Drawn::new(small, &gate.mask, with_segmentation);
        let mut all = Drawn::new(scene, &gate.mask, with_segmentation);
        let num_before = all.activated().num_gaussians();
        let rows: Vec<usize> = (num_before..num_before + born.activated().num_gaussians()).collect();
        all.extend(&born);
        let of_view = |(view, unexplained): (&View, &Blocks)| {
            let mut tiles = tiles_of(unexplained, view.image.width, view.image.height);
            tiles.union(&tiles_reached(born.activated(), &view.camera));
            tiles
        };
        let tiles: Vec<TileMask> = views.iter().zip(unexplained).map(of_view).collect();
        let cameras: Vec<&Camera> = views.iter().map(|view| &view.camera).collect();
        let scenery = scenery_of(&all, &rows, rows.len(), &tiles, pictures, &cameras);
        Self { scenery, cameras: (0..views.len()).filter(|&i| !tiles[i].is_empty()).collect() }
    }
}
