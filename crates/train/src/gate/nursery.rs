//! What newborn Gaussians are trained in: the tiles that they reach, among the rest of the scene.

use tcgs_core::{Activated, Image, View};
use tcgs_render::{gaussians_reaching, tiles_reached};

use super::{Blocks, Gate, tiles_of};
use crate::engine::cpu::drawn;
use crate::engine::{Scenery, ViewScenery};
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
        let (all, born) = (drawn(scene, &gate.mask, with_segmentation), drawn(small, &gate.mask, with_segmentation));
        let view = |(i, view): (usize, &View)| {
            let mut tiles = tiles_of(&unexplained[i], view.image.width, view.image.height);
            tiles.union(&tiles_reached(&born, &view.camera));
            if tiles.is_empty() {
                let drawn = Activated { num_channels: all.num_channels, ..Activated::default() };
                return ViewScenery { tiles, drawn, places: Vec::new(), picture: Image::default() };
            }
            let mut around: Vec<usize> =
                gaussians_reaching(&all, &view.camera, &tiles).into_iter().map(|i| i as usize).collect();
            around.sort_unstable();
            let mut drawn = all.select(&around);
            let places = (0..born.num_gaussians()).map(|row| (drawn.num_gaussians() + row) as u32).collect();
            drawn.extend(&born);
            ViewScenery { tiles, drawn, places, picture: pictures[i].clone() }
        };
        let views: Vec<ViewScenery> = views.iter().enumerate().map(view).collect();
        let cameras = (0..views.len()).filter(|&i| !views[i].tiles.is_empty()).collect();
        Self { scenery: Scenery { num_active: born.num_gaussians(), views }, cameras }
    }
}
