//! A camera path saved by the player, read from its JSON file (docs/PLAYER.md).

use std::path::Path;

use serde::Deserialize;
use tcgs_core::{Camera, CameraPath, MAX_PIXELS, read_file};

use crate::PipelineError;

/// Most pixels per side, as for every image drawn along a path.
const MAX_SIDE: usize = 16384;
/// Most bytes of a file: twenty thousand keyframes.
const MAX_BYTES: u64 = 1 << 24;
const FORMAT: &str = "tcgs-camera-path";

/// The file.
#[derive(Deserialize)]
struct Document {
    format: String,
    version: u32,
    cameras: Vec<Keyframe>,
}

/// A camera at a timestep, in the player's format.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
struct Keyframe {
    timestep: f64,
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// `[4][4]` row-major.
    camera_from_world: [f64; 16],
}

/// Reads a camera path saved by the player: at least one keyframe, by increasing timestep.
///
/// # Errors
/// [`PipelineError::Unreadable`] if there is no such file; [`PipelineError::Input`] if it holds anything else.
pub fn read_camera_path(path: &Path) -> Result<CameraPath, PipelineError> {
    let expected = "a camera path that the player saved";
    let bytes = read_file(path, MAX_BYTES).map_err(|error| PipelineError::unreadable(path, error, expected))?;
    parse(&bytes).map_err(|problem| PipelineError::input(path.display(), problem, expected))
}

fn parse(bytes: &[u8]) -> Result<CameraPath, String> {
    let document: Document = serde_json::from_slice(bytes).map_err(|error| error.to_string())?;
    if (document.format.as_str(), document.version) != (FORMAT, 1) {
        return Err(format!("format {:?} version {}", document.format, document.version));
    }
    let mut path = CameraPath::default();
    for (index, keyframe) in document.cameras.into_iter().enumerate() {
        if path.keyframes().last().is_some_and(|before| before.timestep >= keyframe.timestep) {
            return Err(format!("camera {index} has timestep {}, not later than the one before", keyframe.timestep));
        }
        let (width, height) = (keyframe.width, keyframe.height);
        let is_drawn = [width, height].iter().all(|side| (1..=MAX_SIDE).contains(side)) && width * height <= MAX_PIXELS;
        if !is_drawn {
            return Err(format!(
                "camera {index} has {width}x{height} pixels, not 1 to {MAX_SIDE} each and {MAX_PIXELS} at most"
            ));
        }
        let intrinsics = [[keyframe.fx, 0.0, keyframe.cx], [0.0, keyframe.fy, keyframe.cy], [0.0, 0.0, 1.0]];
        let m = keyframe.camera_from_world;
        let camera_from_world = std::array::from_fn(|row| std::array::from_fn(|column| m[4 * row + column]));
        let camera = Camera::new(keyframe.width, keyframe.height, intrinsics, camera_from_world)
            .map_err(|error| format!("camera {index}: {error}"))?;
        path.insert(keyframe.timestep, camera).map_err(|error| format!("camera {index}: {error}"))?;
    }
    if path.keyframes().is_empty() { Err("no cameras".into()) } else { Ok(path) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_path_is_refused() {
        let camera = |timestep: f64, first: f64| {
            format!(
                r#"{{"timestep":{timestep},"width":4,"height":3,"fx":5,"fy":5,"cx":2,"cy":1.5,"cameraFromWorld":[{first},0,0,0,0,1,0,0,0,0,1,2,0,0,0,1]}}"#
            )
        };
        let document = |cameras: &str| format!(r#"{{"format":"{FORMAT}","version":1,"cameras":[{cameras}]}}"#);
        let good = parse(document(&camera(0.5, 1.0)).as_bytes()).unwrap();
        let [keyframe] = good.keyframes() else { panic!("one keyframe") };
        assert_eq!((keyframe.timestep, keyframe.camera.center()), (0.5, [0.0, 0.0, -2.0]));
        let cases = [
            ("{}".into(), "missing field `format`"),
            ("nonsense".into(), "expected"),
            (document(""), "no cameras"),
            (document(&camera(0.0, 1.0)).replace("\"version\":1", "\"version\":2"), "version 2"),
            (document(&camera(0.0, 2.0)), "camera 0: the upper left 3x3 of w2c is not a rotation"),
            (document(&camera(0.0, 1.0)).replace("\"fx\":5,", ""), "missing field `fx`"),
            (document(&format!("{0},{0}", camera(3.0, 1.0))), "camera 1 has timestep 3, not later"),
        ];
        for (text, expected) in cases {
            let error = parse(text.as_bytes()).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
