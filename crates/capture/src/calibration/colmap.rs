//! A COLMAP model, binary or text: one image a camera, or several images of static cameras.
//!
//! ```text
//! cameras.bin  images.bin      or .txt, in sparse/0, in sparse, or in the folder that is named
//! ```
//!
//! | | |
//! |---|---|
//! | direction | `camera_from_world` |
//! | axes | x right, y down, z forward |
//! | pixels | the centre of the first pixel is `(0.5, 0.5)`, as here |
//! | distortion | `k1 k2 p1 p2` of OPENCV, `k3` to `k6` of FULL_OPENCV |
//! | unit | unknown |
//!
//! The name of an image, with or without its ending, or the folder of the image, names the video.

use std::path::{Path, PathBuf};

use tcgs_core::rotmat_from_quat;

use super::numbers::rigid;
use super::{CalibratedCamera, Format};
use crate::colmap::{ColmapModel, PosedImage, model_folder};
use crate::{CaptureError, files};

pub(super) const FORMAT: Format = Format {
    name: "colmap",
    mark: "sparse/0/cameras.bin or .txt (COLMAP)",
    find: |folder| Ok(model_folder(folder).into_iter().collect()),
    is: |path| folder_of(path).is_some(),
    read,
    in_metres: false,
};

/// The model's folder, if `path` is this folder, its parent, or one of its files.
fn folder_of(path: &Path) -> Option<PathBuf> {
    let is_model = |folder: &Path| ["cameras.bin", "cameras.txt"].iter().any(|name| folder.join(name).is_file());
    if path.is_dir() {
        return if is_model(path) { Some(path.into()) } else { model_folder(path) };
    }
    let is_part = ["cameras.bin", "cameras.txt", "images.bin", "images.txt"].contains(&files::name(path).as_str());
    path.parent().filter(|folder| is_part && is_model(folder)).map(Path::to_path_buf)
}

fn read(path: &Path) -> Result<Vec<CalibratedCamera>, CaptureError> {
    let folder = folder_of(path).ok_or_else(|| CaptureError::invalid(path, "has no cameras.bin, expected a model"))?;
    let ColmapModel { cameras_file, images_file, cameras, mut images } = ColmapModel::read(&folder)?;
    images.sort_by(|a, b| a.name.cmp(&b.name));
    let camera = |image: &PosedImage| {
        let invalid = |problem: String| CaptureError::invalid(&images_file, format!("image {}: {problem}", image.name));
        let lens = cameras.get(&image.camera_id).ok_or_else(|| {
            invalid(format!("has the camera {}, expected one of {}", image.camera_id, cameras_file.display()))
        })?;
        let [k1, k2, k3, k4, k5, k6] = lens.radial;
        let [p1, p2] = lens.tangential;
        Ok(CalibratedCamera {
            names: names_of(&image.name),
            size: Some(lens.size()),
            angle_x: None,
            focal: lens.focal,
            principal: lens.principal,
            distortion: [k1, k2, p1, p2, k3, k4, k5, k6],
            camera_from_world: rigid(rotmat_from_quat(image.quat), image.translation).map_err(invalid)?,
        })
    };
    images.iter().map(camera).collect()
}

/// The names of videos to which an image may belong.
pub(super) fn names_of(image: &str) -> Vec<String> {
    let path = Path::new(image);
    let folder = path.parent().map(files::name).filter(|name| !name.is_empty());
    let usual = |name: &String| !["images", "input", "ims", "images_2", "images_4"].contains(&name.as_str());
    [Some(files::stem(path)), folder.filter(usual)].into_iter().flatten().collect()
}
