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
    /// The Gaussians of the scene that reach a tile that is drawn, in any view, as drawn, in the scene's order; all rows
    /// of the state are among them, and each iteration draws these as the state has them. `D`, with 3 or 5 channels.
    pub drawn: Activated,
    /// `[rows]`, where in `drawn` each row of the state stands.
    pub places: Vec<u32>,
    /// `[cameras]`, in the order of the targets.
    pub views: Vec<ViewScenery>,
}

/// The surroundings in one view.
#[derive(Clone, Debug)]
pub struct ViewScenery {
    /// The tiles that are drawn, compared and differentiated.
    pub tiles: TileMask,
    /// Positions in [`Scenery::drawn`] of the Gaussians that reach these tiles, and of all rows of the state, ascending; none
    /// if there are no tiles.
    pub gaussians: Vec<u32>,
    /// `[gaussians, C]`, their colours as this camera sees them; none where every camera sees those of
    /// [`Scenery::drawn`].
    pub colors: Option<Vec<f32>>,
    /// `[C, H, W]`, the picture at the start of the timestep, before the camera's gain and offset: what is seen outside
    /// of the tiles. Empty if there are no tiles.
    pub picture: Image,
}
