//! `camera_array.toml` of caliscope.
//!
//! ```text
//! [cameras.0]    cam_id or port, size, rotation_count, matrix [3, 3], distortions [5],
//!                rotation [3, 3] or a rotation vector [3], translation [3], ignore, fisheye
//! ```
//!
//! | | |
//! |---|---|
//! | direction | `camera_from_world` |
//! | axes | x right, y down, z forward |
//! | pixels | the centre of the first pixel is `(0, 0)`; here 0.5 is added |
//! | distortion | `k1 k2 p1 p2 k3` |
//! | unit | metres |
//! | turned cameras | the numbers are of the image as stored, and nothing is turned; `rotation_count` is for display |

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use tcgs_core::{natural_key, rotmat_from_vector};

use super::numbers::{OpenCvCamera, side};
use super::{CalibratedCamera, Format, files_named};
use crate::{CaptureError, files};

const FILE: &str = "camera_array.toml";

pub(super) const FORMAT: Format = Format {
    name: "caliscope",
    mark: "camera_array.toml (caliscope)",
    find: |folder| files_named(folder, |name| name == FILE),
    is: |path| files::name(path) == FILE,
    read,
    in_metres: true,
};

#[derive(Deserialize)]
struct CameraArray {
    cameras: BTreeMap<String, Entry>,
}

#[derive(Deserialize)]
struct Entry {
    size: [f64; 2],
    matrix: Option<[[f64; 3]; 3]>,
    distortions: Option<Vec<f64>>,
    rotation: Option<Rotation>,
    translation: Option<[f64; 3]>,
    #[serde(default)]
    ignore: bool,
    #[serde(default)]
    fisheye: bool,
}

/// Files of older versions hold a matrix, newer ones a vector.
#[derive(Clone, Copy, Deserialize)]
#[serde(untagged)]
pub(super) enum Rotation {
    Matrix([[f64; 3]; 3]),
    Vector([f64; 3]),
}

impl Rotation {
    pub fn matrix(self) -> [[f64; 3]; 3] {
        match self {
            Self::Matrix(matrix) => matrix,
            Self::Vector(vector) => rotmat_from_vector(vector),
        }
    }
}

fn read(path: &Path) -> Result<Vec<CalibratedCamera>, CaptureError> {
    let text = files::text(path)?;
    let array: CameraArray = toml::from_str(&text)
        .map_err(|error| CaptureError::invalid(path, format!("is no camera_array: {}", error.message())))?;
    let mut entries: Vec<(String, Entry)> = array.cameras.into_iter().filter(|(_, entry)| !entry.ignore).collect();
    entries.sort_by_cached_key(|(name, _)| natural_key(name));
    let mut cameras = Vec::new();
    for (name, entry) in entries {
        let invalid = |problem: &str| CaptureError::invalid(path, format!("camera {name}: {problem}"));
        if entry.fisheye {
            return Err(invalid("is a fisheye, expected a lens that sees straight lines nearly straight"));
        }
        let (Some(matrix), Some(rotation), Some(translation)) = (entry.matrix, entry.rotation, entry.translation)
        else {
            return Err(invalid("has no matrix, rotation or translation, expected a finished calibration"));
        };
        let size = side(entry.size[0]).zip(side(entry.size[1]));
        let camera = OpenCvCamera {
            names: vec![name.clone(), format!("cam_{name}"), format!("port_{name}")],
            size: Some(size.ok_or_else(|| invalid("its size is not one in pixels, expected [width, height]"))?),
            matrix,
            distortion: entry.distortions.unwrap_or_default(),
            rotation: rotation.matrix(),
            translation,
        };
        cameras.push(camera.checked().map_err(|problem| invalid(&problem))?);
    }
    Ok(cameras)
}
