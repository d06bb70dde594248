//! A view of a timestep that trains a part of the scene: its rows drawn among all that is locked, in some tiles.

use rayon::prelude::*;
use tcgs_core::{Activated, Image};
use tcgs_render::{CpuLocked, CpuRasterizer, Laps, RenderGrads, Scope};

use super::image_loss::{ImageLoss, image_loss_in};
use super::settings_of;
use crate::engine::{Scenery, Step, Target, ViewScenery};
use crate::parameters::Parameters;

/// One view's part of a [`Scenery`].
#[derive(Clone, Debug)]
pub(super) struct Stage {
    /// The view's tiles, and there the splats of all that is locked.
    locked: CpuLocked,
    /// Gaussians that reach the tiles. Each iteration overwrites the values of the state's rows.
    drawn: Activated,
    /// `[rows]`, position in `drawn` of each row of the state; empty if there are no tiles.
    places: Vec<usize>,
    /// Which of `drawn` are trained: the first rows of the state.
    is_trained: Vec<bool>,
    /// `[C, H, W]`, redrawn in the tiles.
    picture: Image,
}

impl Stage {
    /// The stages of all views.
    pub fn all(scenery: Scenery, targets: &[Target]) -> Vec<Self> {
        let Scenery { num_active, drawn, places, views } = scenery;
        assert_eq!(views.len(), targets.len(), "a target for each view");
        let of = |(ViewScenery { tiles, gaussians, colors, picture }, target): (ViewScenery, &Target)| {
            let indices: Vec<usize> = gaussians.iter().map(|&i| i as usize).collect();
            let place = |row: &u32| gaussians.binary_search(row).expect("a view has all rows");
            let places: Vec<usize> = if gaussians.is_empty() { Vec::new() } else { places.iter().map(place).collect() };
            let mut is_trained = vec![false; gaussians.len()];
            places.iter().take(num_active).for_each(|&place| is_trained[place] = true);
            let mut drawn = drawn.select(&indices);
            if let Some(colors) = colors {
                assert_eq!(colors.len(), drawn.colors.len(), "colours that a camera sees");
                drawn.colors = colors;
            }
            let moving = places.iter().map(|&place| place as u32).collect();
            let locked = CpuLocked::new(&drawn, &target.camera, tiles, moving);
            Self { locked, drawn, places, is_trained, picture }
        };
        views.into_par_iter().zip(targets).map(of).collect()
    }

    /// Overwrites the values of the state's rows.
    fn place(&mut self, rows: &Activated) {
        assert_eq!(rows.num_gaussians(), self.places.len(), "rows to place");
        let channels = self.drawn.num_channels;
        assert_eq!(rows.num_channels, channels, "channels of the rows");
        for (row, &place) in self.places.iter().enumerate() {
            self.drawn.means[place] = rows.means[row];
            self.drawn.quats[place] = rows.quats[row];
            self.drawn.scales[place] = rows.scales[row];
            self.drawn.opacities[place] = rows.opacities[row];
            self.drawn.colors[place * channels..][..channels]
                .copy_from_slice(&rows.colors[row * channels..][..channels]);
        }
    }

    /// Renders the state's rows among their scenery, in the tiles of the view, and takes the losses back to the rows.
    ///
    /// - `v_image`: memory for the gradient of the image; overwritten in the tiles drawn
    /// - returns: the losses, and the gradients to `rows`: 0 for those that are not trained
    pub fn render(
        &mut self,
        rows: &Activated,
        target: &Target,
        p: &Parameters,
        step: &Step<'_>,
        v_image: &mut Image,
        laps: &mut Laps,
    ) -> (ImageLoss, RenderGrads) {
        let (settings, camera) = (settings_of(step), &target.camera);
        self.place(rows);
        let Self { locked, drawn, places, is_trained, picture } = self;
        let sorted = CpuRasterizer.forward_in(drawn, camera, &settings, Scope::Locked(locked), picture, laps);
        let [gain, offset] = [p.camera_gains[step.camera], p.camera_offsets[step.camera]];
        let weights = step.weights;
        let (image, segmentation) = (weights.image, weights.segmentation);
        let tiles = locked.tiles();
        let loss = image_loss_in(picture, &target.image, tiles, gain, offset, image, segmentation, v_image);
        laps.lap("image losses");
        let grads =
            CpuRasterizer.backward_in(drawn, camera, &settings, &sorted, picture, v_image, Some(is_trained), laps);
        let of_rows = RenderGrads {
            activated: grads.activated.select(places, drawn.num_channels),
            v_means2d_ndc: places.iter().map(|&i| grads.v_means2d_ndc[i]).collect(),
            visible: places.iter().map(|&i| grads.visible[i]).collect(),
        };
        (loss, of_rows)
    }
}
