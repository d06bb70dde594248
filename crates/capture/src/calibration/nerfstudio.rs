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
//! Blender's export for NeRF has the same cameras in `transforms_train.json` and `transforms_test.json`, without the
//! size of images. The focal length then follows from `camera_angle_x` and the width of the video.
//!
//! The name of an image without its ending, or the folder of the image, names the video.

use std::path::Path;

use super::colmap::names_of;
use super::numbers::{rigid, side};
use super::{CalibratedCamera, Format, files_named};
use crate::CaptureError;
use crate::checked::read_json;
use crate::files;
use crate::kinds::{
    NerfstudioFrame, NerfstudioIntrinsics, NerfstudioTransforms, camera_from_nerfstudio, read_transforms,
};

const FILES: [&str; 2] = ["transforms.json", "transforms_train.json"];

pub(super) const FORMAT: Format = Format {
    name: "nerfstudio",
    mark: "transforms.json (nerfstudio) or transforms_train.json (Blender)",
    find: |folder| Ok(files_named(folder, |name| FILES.contains(&name))?.into_iter().take(1).collect()),
    is: |path| files::has_extension(path, &["json"]),
    read,
    in_metres: false,
};

fn read(path: &Path) -> Result<Vec<CalibratedCamera>, CaptureError> {
    let transforms: NerfstudioTransforms = match path.parent().filter(|_| files::name(path) == FILES[1]) {
        Some(folder) if !folder.join(FILES[0]).exists() => read_transforms(folder)?.1,
        _ => read_json(path)?,
    };
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
    let angle_x = get(|i| i.camera_angle_x).filter(|angle| *angle > 0.0 && *angle < std::f64::consts::PI);
    let is_known = |x: &f64| *x > 0.0 && x.is_finite();
    let (focal, principal) = match (size, get(|i| i.fl_x).filter(is_known), angle_x) {
        (Some((width, height)), fl_x, angle) if fl_x.is_some() || angle.is_some() => {
            let fx = fl_x.or(angle.map(|angle| 0.5 * width as f64 / (0.5 * angle).tan())).unwrap_or_default();
            let middle = [width, height].map(|side| side as f64 / 2.0);
            let principal = [get(|i| i.cx).unwrap_or(middle[0]), get(|i| i.cy).unwrap_or(middle[1])];
            ([fx, get(|i| i.fl_y).unwrap_or(fx)], principal)
        }
        (Some(_), ..) => return Err("has neither fl_x nor camera_angle_x, expected a focal length in pixels".into()),
        // The caller fills these in when it knows the size of the images.
        (None, _, Some(_)) => ([0.0; 2], [0.0; 2]),
        (None, ..) => return Err("has no w and h, expected the size of its image in pixels, or camera_angle_x".into()),
    };
    let or_zero = |of: fn(&NerfstudioIntrinsics) -> Option<f64>| get(of).unwrap_or(0.0);
    let [right, down, forward, _] = camera_from_nerfstudio(&frame.transform_matrix)?;
    let rotation = [right, down, forward].map(|[a, b, c, _]| [a, b, c]);
    Ok(CalibratedCamera {
        names: names_of(&frame.file_path),
        size,
        angle_x: angle_x.filter(|_| size.is_none()),
        focal,
        principal,
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
