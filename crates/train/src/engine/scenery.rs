//! Surroundings of a timestep that are drawn but not trained: the locked Gaussians, and the pixels around the drawn
//! tiles.

use tcgs_core::{Activated, Image};
use tcgs_render::TileMask;

/// The surroundings of a timestep that trains only some Gaussians, in some tiles of some views.
///
/// The engine's state then holds the *rows* of the timestep: first the active Gaussians, which are trained, then the
/// held ones. Held Gaussians are neighbours for the losses on motion and keep every bit.
#[derive(Clone, Debug)]
pub struct Scenery {
    /// Number of active rows: the first ones of the state.
    pub num_active: usize,
    /// The Gaussians of the scene, as drawn, that reach a drawn tile in any view; in the scene's order. All rows of the
    /// state are among them; each iteration draws these with the state's values. `D`, with 3 or 5 channels.
    pub drawn: Activated,
    /// `[rows]`, position in `drawn` of each row of the state.
    pub places: Vec<u32>,
    /// `[cameras]`, in the order of the targets.
    pub views: Vec<ViewScenery>,
}

/// The surroundings in one view.
#[derive(Clone, Debug)]
pub struct ViewScenery {
    /// The tiles that are drawn, compared and differentiated.
    pub tiles: TileMask,
    /// Positions in [`Scenery::drawn`] of the Gaussians that reach these tiles and of all rows of the state, ascending.
    /// Empty if there are no tiles.
    pub gaussians: Vec<u32>,
    /// `[gaussians, C]`, their colours as this camera sees them; none if every camera sees those of [`Scenery::drawn`].
    pub colors: Option<Vec<f32>>,
    /// `[C, H, W]`, the picture at the start of the timestep, before the camera's gain and offset; shown outside of the
    /// tiles. Empty if there are no tiles.
    pub picture: Image,
}
