//! `transforms.json` of nerfstudio beside videos: the pose of one image a camera, or of several.
//!
//! | | |
//! |---|---|
//! | direction | `world_from_camera` |
//! | axes | x right, y up, z backward; here y and z are turned round |
//! | pixels | the centre of the first pixel is `(0.5, 0.5)`, as here |
//! | distortion | `k1 k2 k3 k4`, `p1 p2`, by name |
//! | unit | unknown |
//!
//! A video is meant by the name of an image without its ending, and by the folder that the image lies in.

use std::path::Path;

use super::colmap::names_of;
use super::numbers::{rigid, side};
use super::{CalibratedCamera, Format, files_named};
use crate::CaptureError;
use crate::checked::read_json;
use crate::kinds::{NerfstudioFrame, NerfstudioIntrinsics, NerfstudioTransforms, camera_from_nerfstudio};

const FILE: &str = "transforms.json";

pub(super) const FORMAT: Format = Format {
    name: "nerfstudio",
    mark: "transforms.json (nerfstudio)",
    find: |folder| files_named(folder, |name| name == FILE),
    is: |path| crate::files::has_extension(path, &["json"]),
    read,
    in_metres: false,
};

fn read(path: &Path) -> Result<Vec<CalibratedCamera>, CaptureError> {
    let transforms: NerfstudioTransforms = read_json(path)?;
    let camera = |frame: &NerfstudioFrame| {
        camera(frame, &transforms.intrinsics)
            .map_err(|problem| CaptureError::invalid(path, format!("{}: {problem}", frame.file_path)))
    };
    transforms.frames.iter().map(camera).collect()
}

fn camera(frame: &NerfstudioFrame, all: &NerfstudioIntrinsics) -> Result<CalibratedCamera, String> {
    let own = &frame.intrinsics;
    let model = own.camera_model.as_ref().or(all.camera_model.as_ref());
    if let Some(model) = model.filter(|model| !["OPENCV", "PINHOLE", "SIMPLE_PINHOLE"].contains(&model.as_str())) {
        return Err(format!("has the camera model {model}, expected OPENCV or PINHOLE"));
    }
    let get = |of: fn(&NerfstudioIntrinsics) -> Option<f64>| of(own).or(of(all));
    let size = get(|i| i.w).and_then(side).zip(get(|i| i.h).and_then(side));
    let (width, height) = size.ok_or("has no w and h, expected the size of its image in pixels")?;
    let angle = get(|i| i.camera_angle_x);
    let fx = get(|i| i.fl_x).or(angle.map(|angle| 0.5 * width as f64 / (0.5 * angle).tan()));
    let fx = fx.filter(|fx| *fx > 0.0 && fx.is_finite());
    let fx = fx.ok_or("has neither fl_x nor camera_angle_x, expected a focal length in pixels")?;
    let or_zero = |of: fn(&NerfstudioIntrinsics) -> Option<f64>| get(of).unwrap_or(0.0);
    let [right, down, forward, _] = camera_from_nerfstudio(&frame.transform_matrix)?;
    let rotation = [right, down, forward].map(|[a, b, c, _]| [a, b, c]);
    Ok(CalibratedCamera {
        names: names_of(&frame.file_path),
        size: Some((width, height)),
        focal: [fx, get(|i| i.fl_y).unwrap_or(fx)],
        principal: [get(|i| i.cx).unwrap_or(width as f64 / 2.0), get(|i| i.cy).unwrap_or(height as f64 / 2.0)],
        distortion: [
            or_zero(|i| i.k1),
            or_zero(|i| i.k2),
            or_zero(|i| i.p1),
            or_zero(|i| i.p2),
            or_zero(|i| i.k3),
            or_zero(|i| i.k4),
            0.0,
            0.0,
        ],
        camera_from_world: rigid(rotation, [right[3], down[3], forward[3]])?,
    })
}
