//! Cameras that a file brings along, as views to start from.

use tcgs_codec::Archive;
use tcgs_core::Camera;

/// A camera of the capture that the scene was made of.
#[derive(Clone, Debug, PartialEq)]
pub struct FileCamera {
    /// Its name in the capture.
    pub name: String,
    /// Where it stood and what it saw.
    pub camera: Camera,
}

/// The cameras of a file; none if it has none.
pub fn read_cameras(_archive: &Archive) -> Vec<FileCamera> {
    Vec::new()
}
