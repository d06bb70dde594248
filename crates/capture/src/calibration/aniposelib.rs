//! `Calib*.toml`, `calibration.toml` of aniposelib, Anipose, Pose2Sim and FreeMoCap.
//!
//! ```text
//! [cam_0]       name, size [2], matrix [3, 3], distortions [4 or 5], rotation [3], translation [3], fisheye
//! [metadata]    of no importance here
//! ```
//!
//! | | |
//! |---|---|
//! | direction | `camera_from_world`; `rotation` is a rotation vector (Rodrigues) |
//! | axes | x right, y down, z forward |
//! | pixels | the centre of the first pixel is `(0, 0)`; here 0.5 is added |
//! | distortion | `k1 k2 p1 p2 k3` |
//! | unit | metres in files of Pose2Sim, that of the board in others; not written in the file |

use std::path::Path;

use serde::Deserialize;
use tcgs_core::natural_key;

use super::caliscope::Rotation;
use super::numbers::{OpenCvCamera, side};
use super::{CalibratedCamera, Format, files_named};
use crate::{CaptureError, files};

pub(super) const FORMAT: Format = Format {
    name: "aniposelib",
    mark: "Calib*.toml (Pose2Sim, aniposelib)",
    find: |folder| {
        let mut paths = files_named(folder, |name| name.ends_with(".toml"))?;
        paths.retain(|path| is(path));
        Ok(paths)
    },
    is,
    read,
    in_metres: false,
};

#[derive(Deserialize)]
struct Entry {
    name: Option<String>,
    size: [f64; 2],
    matrix: [[f64; 3]; 3],
    #[serde(default)]
    distortions: Vec<f64>,
    rotation: Rotation,
    translation: [f64; 3],
    #[serde(default)]
    fisheye: bool,
}

/// Whether a table is one of a camera.
fn is_camera(value: &toml::Value) -> bool {
    ["matrix", "rotation", "translation"].iter().all(|key| value.get(key).is_some())
}

fn is(path: &Path) -> bool {
    let table = || files::text(path).ok()?.parse::<toml::Table>().ok();
    files::has_extension(path, &["toml"]) && table().is_some_and(|table| table.values().any(is_camera))
}

fn read(path: &Path) -> Result<Vec<CalibratedCamera>, CaptureError> {
    let table: toml::Table = files::text(path)?
        .parse()
        .map_err(|error: toml::de::Error| CaptureError::invalid(path, format!("is no TOML: {}", error.message())))?;
    let mut entries: Vec<_> = table.into_iter().filter(|(_, value)| is_camera(value)).collect();
    entries.sort_by_cached_key(|(key, _)| natural_key(key));
    let mut cameras = Vec::new();
    for (key, value) in entries {
        let invalid = |problem: &str| CaptureError::invalid(path, format!("[{key}]: {problem}"));
        let entry: Entry = value.try_into().map_err(|error| invalid(error.message()))?;
        if entry.fisheye {
            return Err(invalid("is a fisheye, expected a lens that sees straight lines nearly straight"));
        }
        let size = side(entry.size[0]).zip(side(entry.size[1]));
        let camera = OpenCvCamera {
            names: entry.name.into_iter().chain([key.clone()]).collect(),
            size: Some(size.ok_or_else(|| invalid("its size is not one in pixels, expected [width, height]"))?),
            matrix: entry.matrix,
            distortion: entry.distortions,
            rotation: entry.rotation.matrix(),
            translation: entry.translation,
        };
        cameras.push(camera.checked().map_err(|problem| invalid(&problem))?);
    }
    Ok(cameras)
}
