//! A COLMAP model and its images: a static scene, one timestep.
//!
//! ```text
//! sparse/0/cameras.bin  images.bin  points3D.bin      or .txt; also in sparse/
//! images/<name>                                       as the model names them
//! ```
//!
//! What lives here: from a model to a capture. `model` reads cameras and images, `points` points, `bytes` what both
//! need. What lenses bend is straightened. Every eighth image by name, beginning with the first, is for judging.

mod bytes;
mod model;
mod points;

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use tcgs_core::{Camera, rotmat_from_quat};

use crate::shot::{self, Shot};
use crate::{Capture, CaptureError, CaptureKind, split};
use model::Model;
pub(crate) use points::{points_file, points_in, read_points};

/// Where a model may be, in a capture's folder.
const MODEL_FOLDERS: [&str; 4] = ["sparse/0", "sparse", "colmap/sparse/0", "colmap_0/sparse/0"];
/// Where the images may be.
const IMAGE_FOLDERS: [&str; 2] = ["images", "input"];

/// The folder of the model, if there is one.
pub(crate) fn model_folder(capture: &Path) -> Option<PathBuf> {
    let has_cameras = |folder: &PathBuf| ["cameras.bin", "cameras.txt"].iter().any(|name| folder.join(name).is_file());
    MODEL_FOLDERS.iter().map(|folder| capture.join(folder)).find(has_cameras)
}

pub(crate) fn open(path: &Path) -> Result<Capture, CaptureError> {
    let folder = model_folder(path)
        .ok_or_else(|| CaptureError::invalid(path, "has no COLMAP model, expected sparse/0/cameras.bin"))?;
    let images_folder = IMAGE_FOLDERS.iter().map(|name| path.join(name)).find(|folder| folder.is_dir());
    let images_folder = images_folder.ok_or_else(|| {
        CaptureError::invalid(path, "has a COLMAP model, but no folder images/, expected the images that it names")
    })?;
    let Model { cameras_file, images_file, cameras, mut images } = Model::read(&folder)?;
    images.sort_by(|a, b| a.name.cmp(&b.name));

    let mut shots = Vec::new();
    for image in &images {
        let invalid = |problem: String| CaptureError::invalid(&images_file, format!("image {}: {problem}", image.name));
        let lens = cameras.get(&image.camera_id).ok_or_else(|| {
            invalid(format!("has the camera {}, expected one of {}", image.camera_id, cameras_file.display()))
        })?;
        if !Path::new(&image.name).components().all(|part| matches!(part, Component::Normal(_))) {
            return Err(invalid("is outside of the images' folder".into()));
        }
        let [x, y, z] = rotmat_from_quat(image.quat);
        let [tx, ty, tz] = image.translation;
        let row = |r: [f64; 3], t: f64| [r[0], r[1], r[2], t];
        let camera_from_world = [row(x, tx), row(y, ty), row(z, tz), [0.0, 0.0, 0.0, 1.0]];
        let (size, intrinsics) = ((lens.crop.width, lens.crop.height), lens.straight_intrinsics());
        let camera =
            Camera::new(size.0, size.1, intrinsics, camera_from_world).map_err(|error| invalid(error.to_string()))?;
        let shot = Shot::of_file(shots.len(), camera, images_folder.join(&image.name));
        shots.push(shot.through(Arc::clone(lens)));
    }
    if shots.is_empty() {
        return Err(CaptureError::invalid(&images_file, "has no images, expected at least one"));
    }
    shot::check_files(&shots, &images_file)?;
    let (train, test) = split::every_eighth(shots);
    Ok(Capture {
        path: path.into(),
        kind: CaptureKind::Colmap,
        frame_rate: split::STATIC_FRAME_RATE,
        usual_frames: 0..1,
        train: vec![train],
        test: vec![test],
        has_segmentation: false,
        cameras_files: [images_file.clone(), images_file],
        points: crate::points::find(path, points_file(path)),
    })
}
