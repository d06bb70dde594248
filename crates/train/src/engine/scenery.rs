//! What a timestep is drawn with but not trained on: the Gaussians that are locked, and the pixels around the tiles that
//! are drawn.

use tcgs_core::{Activated, Image};
use tcgs_render::TileMask;

/// The surroundings of a timestep that trains only some Gaussians, in some tiles of some views.
///
/// The engine's state then holds the *rows* of the timestep: first the active Gaussians, which are trained, then those
/// that are held, which the losses on motion need as neighbours and which keep every bit.
#[derive(Clone, Debug)]
pub struct Scenery {
    /// Number of active rows: the first ones of the state.
    pub num_active: usize,
    /// `[cameras]`, in the order of the targets.
    pub views: Vec<ViewScenery>,
}

/// The surroundings in one view.
#[derive(Clone, Debug)]
pub struct ViewScenery {
    /// The tiles that are drawn, compared and differentiated.
    pub tiles: TileMask,
    /// The Gaussians of the scene that reach these tiles, as drawn, in the scene's order, and all rows of the state
    /// among them; those rows' own values are overwritten by each iteration. `N`, with 3 or 5 channels.
    pub drawn: Activated,
    /// `[rows]`, where in `drawn` each row of the state stands.
    pub places: Vec<u32>,
    /// `[C, H, W]`, the picture at the start of the timestep, before the camera's gain and offset: what is seen outside
    /// of the tiles.
    pub picture: Image,
}

impl ViewScenery {
    /// Overwrites the values of the state's rows.
    ///
    /// - `rows`: the state's Gaussians, as drawn; as many channels as [`Self::drawn`] has
    ///
    /// # Panics
    /// If there are other numbers of rows or channels.
    pub fn place(&mut self, rows: &Activated) {
        assert_eq!(rows.num_gaussians(), self.places.len(), "rows to place");
        let channels = self.drawn.num_channels;
        assert_eq!(rows.num_channels, channels, "channels of the rows");
        for (row, &place) in self.places.iter().enumerate() {
            let place = place as usize;
            self.drawn.means[place] = rows.means[row];
            self.drawn.quats[place] = rows.quats[row];
            self.drawn.scales[place] = rows.scales[row];
            self.drawn.opacities[place] = rows.opacities[row];
            self.drawn.colors[place * channels..][..channels]
                .copy_from_slice(&rows.colors[row * channels..][..channels]);
        }
    }
}
