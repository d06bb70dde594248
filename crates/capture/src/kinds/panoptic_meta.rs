//! `train_meta.json` and `test_meta.json`: cameras and file names, as text.

use serde::Deserialize;

/// The content of a meta file. All lists are `[T][C]`, and `C` may change with time. The reader checks that the lists
/// agree.
#[derive(Debug, Deserialize)]
pub(crate) struct Meta {
    /// Width of every image, pixels.
    pub w: usize,
    /// Height of every image, pixels.
    pub h: usize,
    /// Intrinsics, `[3][3]` row-major, pixels.
    pub k: Vec<Vec<[[f64; 3]; 3]>>,
    /// `camera_from_world`, `[4][4]` row-major.
    pub w2c: Vec<Vec<[[f64; 4]; 4]>>,
    /// Images, relative to `ims/`.
    #[serde(rename = "fn")]
    pub file_names: Vec<Vec<String>>,
    /// Names of the cameras.
    pub cam_id: Vec<Vec<usize>>,
    /// Frames per second; an extension of this project.
    pub fps: Option<f64>,
}
