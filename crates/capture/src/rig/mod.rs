//! Where cameras stand, found or mended from their own images.
//!
//! What lives here: `find` has COLMAP place cameras of which nothing is known (`program`, `model`), `refine` mends a calibration by bundle adjustment (`bundle`) of places that `matches` finds in several
//! cameras, after `meant` has found in which convention its poses are written, `still` finds cameras that move, `colors` compares exposure and white balance. What does not: reading the calibrations that other programs wrote (`calibration`), and which camera a
//! recording belongs to (`raw`).

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

pub(crate) use camera::median;
pub use colors::{ColorBalance, balance_colors};
pub use find::{FoundCameras, find_cameras, scale_cameras};
pub use program::has_colmap;
pub use refine::{Refinement, refine_cameras};
pub use still::moving_cameras;

#[cfg(test)]
mod tests;
