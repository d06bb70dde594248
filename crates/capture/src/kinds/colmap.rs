//! A COLMAP model and its images: a static scene, one timestep.
//!
//! ```text
//! sparse/0/cameras.bin  images.bin  points3D.bin      or .txt; also in sparse/
//! images/<name>                                       as the model names them
//! ```
//!
//! What lives here: the way from a model to a capture; `colmap` reads the model's files. Images with lens distortion
//! are straightened. Every eighth image by name, beginning with the first, is a test image.

use std::path::Path;

use tcgs_core::{Camera, rotmat_from_quat};

use super::test_cameras::every_eighth;
use crate::checked::{FrameRate, InnerPath};
use crate::colmap::{ColmapModel, model_folder, points_file};
use crate::contents::{CameraSetOfFiles, Contents, check_images};
use crate::footage::Change;
use crate::kind::{CaptureFacts, CaptureKind};
use crate::{CaptureError, points};

/// Where the images may be.
const IMAGE_FOLDERS: [&str; 2] = ["images", "input"];

impl CaptureKind {
    /// A COLMAP model and its images: one timestep.
    pub const COLMAP: Self = Self {
        name: "colmap",
        mark: "sparse/0/cameras.bin or .txt (COLMAP)",
        facts: CaptureFacts { has_floor: false, in_metres: false, labels_motion: false },
        recognises: |path| Ok(model_folder(path).is_some()),
        open,
    };
}

fn open(path: &Path) -> Result<Contents, CaptureError> {
    let folder = model_folder(path)
        .ok_or_else(|| CaptureError::invalid(path, "has no COLMAP model, expected sparse/0/cameras.bin"))?;
    let images_folder = IMAGE_FOLDERS.iter().map(|name| path.join(name)).find(|folder| folder.is_dir());
    let images_folder = images_folder.ok_or_else(|| {
        CaptureError::invalid(path, "has a COLMAP model, but no folder images/, expected the images that it names")
    })?;
    let ColmapModel { cameras_file, images_file, cameras, mut images } = ColmapModel::read(&folder)?;
    images.sort_by(|a, b| a.name.cmp(&b.name));

    let mut cameras_of_images = CameraSetOfFiles::new(&images_folder);
    cameras_of_images.begin_frame();
    for (id, image) in images.iter().enumerate() {
        let invalid = |problem: String| CaptureError::invalid(&images_file, format!("image {}: {problem}", image.name));
        let lens = cameras.get(&image.camera_id).ok_or_else(|| {
            invalid(format!("has the camera {}, expected one of {}", image.camera_id, cameras_file.display()))
        })?;
        let name = InnerPath::new(&image.name, "the folder of images")
            .map_err(|problem| CaptureError::invalid(&images_file, format!("the name of an image {problem}")))?;
        let [x, y, z] = rotmat_from_quat(image.quat);
        let [tx, ty, tz] = image.translation;
        let row = |r: [f64; 3], t: f64| [r[0], r[1], r[2], t];
        let camera_from_world = [row(x, tx), row(y, ty), row(z, tz), [0.0, 0.0, 0.0, 1.0]];
        let (size, intrinsics) = ((lens.crop.width, lens.crop.height), lens.straight_intrinsics());
        let camera =
            Camera::new(size.0, size.1, intrinsics, camera_from_world).map_err(|error| invalid(error.to_string()))?;
        cameras_of_images.add(id, camera, Change::for_lens(lens), name);
    }
    if images.is_empty() {
        return Err(CaptureError::invalid(&images_file, "has no images, expected at least one"));
    }
    let all = cameras_of_images.finish();
    check_images(&all, 1, &images_file)?;
    let [train, test] = every_eighth(all);
    Ok(Contents {
        num_frames: 1,
        frame_rate: FrameRate::USUAL,
        usual_frames: 0..1,
        train,
        test,
        cameras_files: [images_file.clone(), images_file],
        points: points::find(path, points_file(path)),
    })
}
