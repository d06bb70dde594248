//! The files of a COLMAP model.
//!
//! What lives here: `model` reads cameras and images, `points` reads points, `bytes` is shared by both. What does not:
//! the way from a model to a capture (`kinds/colmap.rs`).

mod bytes;
mod model;
mod points;

use std::path::{Path, PathBuf};

pub use model::{ColmapModel, PosedImage};
pub(crate) use points::{points_file, points_in, read_points};

/// Where a model may be, in a capture's folder.
const MODEL_FOLDERS: [&str; 4] = ["sparse/0", "sparse", "colmap/sparse/0", "colmap_0/sparse/0"];

/// The folder of the model, if there is one.
pub(crate) fn model_folder(capture: &Path) -> Option<PathBuf> {
    let has_cameras = |folder: &PathBuf| ["cameras.bin", "cameras.txt"].iter().any(|name| folder.join(name).is_file());
    MODEL_FOLDERS.iter().map(|folder| capture.join(folder)).find(has_cameras)
}
