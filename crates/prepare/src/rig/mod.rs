//! Cameras of a rig, found or mended from their own images.
//!
//! What lives here:
//!
//! - `find` has COLMAP place unknown cameras (`program`, `model`).
//! - `refine` mends a calibration by bundle adjustment (`bundle`) of places that `matches` finds in several cameras.
//! - `meant` first finds the convention in which the calibration's poses are written.
//! - `still` finds cameras that move.
//! - `colors` compares exposure and white balance.
//!
//! What does not: reading the calibrations of other programs (`calibration`), and assigning recordings to cameras
//! (`raw`).

mod bundle;
mod camera;
mod color_fit;
mod colors;
mod corners;
mod find;
mod frames;
mod matches;
mod meant;
mod model;
mod normal;
mod patch;
mod program;
mod refine;
mod similarity;
mod still;

pub use colors::{ColorBalance, balance_colors};
pub use find::{FoundCameras, find_cameras, scale_cameras};
pub use program::has_colmap;
pub use refine::{Refinement, refine_cameras};
pub use still::moving_cameras;

#[cfg(test)]
mod tests;
