//! Panoptic Sports as prepared for Dynamic 3D Gaussians (Luiten et al. 2024).
//!
//! ```text
//! train_meta.json  test_meta.json       w, h, and per timestep and camera k, w2c, fn, cam_id
//! ims/<cam>/<frame>.jpg                 images, named by fn
//! seg/<cam>/<frame>.png                 masks, of the training cameras at least, or none
//! init_pt_cld.npz                       points
//! ```

use std::path::Path;

use tcgs_core::Camera;

use super::panoptic_meta::Meta;
use crate::checked::{FrameRate, InnerPath, read_json};
use crate::contents::{CameraSet, CameraSetOfFiles, Contents, check_train_masks, find_masks, missing_image};
use crate::footage::{Change, Footage, Images, Pixels};
use crate::kind::{CaptureFacts, CaptureKind};
use crate::names::Files;
use crate::{CaptureError, points};

const TRAIN_META: &str = "train_meta.json";
const TEST_META: &str = "test_meta.json";
const IMAGES: &str = "ims";
const MASKS: &str = "seg";

impl CaptureKind {
    /// Panoptic Sports as prepared for Dynamic 3D Gaussians: a file an image.
    pub const PANOPTIC: Self = Self {
        name: "panoptic",
        mark: "train_meta.json (Panoptic Sports)",
        facts: CaptureFacts { has_floor: true, in_metres: true, labels_motion: true },
        recognises: |path| Ok(path.join(TRAIN_META).exists()),
        open,
    };
}

fn open(path: &Path) -> Result<Contents, CaptureError> {
    let images = path.join(IMAGES);
    if !images.is_dir() {
        return Err(CaptureError::invalid(images, "no such folder, expected the images that train_meta.json names"));
    }
    let train_meta = path.join(TRAIN_META);
    let meta: Meta = read_json(&train_meta)?;
    let frame_rate = FrameRate::of_file(meta.fps, &train_meta)?;
    let mut train = cameras(path, TRAIN_META, &meta)?;
    let num_frames = meta.k.len();
    // The largest part of the input. From here on repeated names and cameras are stored once.
    drop(meta);
    if num_frames == 0 {
        return Err(CaptureError::invalid(&train_meta, "has no timesteps, expected at least one"));
    }
    if let Some(t) = (0..num_frames).find(|&t| train.at(t).next().is_none()) {
        return Err(CaptureError::invalid(&train_meta, format!("fn[{t}] is empty, expected at least one camera")));
    }

    let test_meta = path.join(TEST_META);
    let meta = if test_meta.exists() { Some(read_json::<Meta>(&test_meta)?) } else { None };
    let mut test = match meta.filter(|meta| !meta.k.is_empty()) {
        Some(meta) if meta.k.len() == num_frames => cameras(path, TEST_META, &meta)?,
        Some(meta) => {
            cameras(path, TEST_META, &meta)?;
            let problem = format!("has {} timesteps, expected {num_frames} as {TRAIN_META} has", meta.k.len());
            return Err(CaptureError::invalid(&test_meta, problem));
        }
        None => CameraSet::constant(Vec::new()),
    };

    for (cameras, meta_name) in [(&train, TRAIN_META), (&test, TEST_META)] {
        if let Some((image, t, c)) = missing_image(cameras, num_frames) {
            let problem = format!("no such file, expected it as fn[{t}][{c}] of {meta_name}");
            return Err(CaptureError::invalid(image, problem));
        }
    }
    find_masks(&mut train, num_frames, |footage, frames| masks_beside(path, footage, frames));
    check_train_masks(&train, num_frames)?;
    find_masks(&mut test, num_frames, |footage, frames| masks_beside(path, footage, frames));

    Ok(Contents {
        num_frames,
        frame_rate,
        usual_frames: 0..num_frames,
        train,
        test,
        cameras_files: [train_meta, test_meta],
        points: points::find(path, None),
    })
}

/// Cameras and file names of one meta file.
fn cameras(path: &Path, meta_name: &str, meta: &Meta) -> Result<CameraSet, CaptureError> {
    let invalid = |problem: String| CaptureError::invalid(path.join(meta_name), problem);
    let num_timesteps = meta.k.len();
    let lengths = [("w2c", meta.w2c.len()), ("fn", meta.file_names.len()), ("cam_id", meta.cam_id.len())];
    if let Some((key, length)) = lengths.into_iter().find(|&(_, length)| length != num_timesteps) {
        return Err(invalid(format!("{key} has {length} timesteps, expected {num_timesteps} as k has")));
    }
    let (images, inside) = (path.join(IMAGES), format!("{IMAGES}/"));
    let mut cameras = CameraSetOfFiles::new(&images);
    for t in 0..num_timesteps {
        let num_cameras = meta.k[t].len();
        let lengths = [("w2c", meta.w2c[t].len()), ("fn", meta.file_names[t].len()), ("cam_id", meta.cam_id[t].len())];
        if let Some((key, length)) = lengths.into_iter().find(|&(_, length)| length != num_cameras) {
            return Err(invalid(format!("{key}[{t}] has {length} cameras, expected {num_cameras} as k[{t}] has")));
        }
        cameras.begin_frame();
        for c in 0..num_cameras {
            let (camera_id, name) = (meta.cam_id[t][c], &meta.file_names[t][c]);
            let camera = Camera::new(meta.w, meta.h, meta.k[t][c], meta.w2c[t][c])
                .map_err(|error| invalid(format!("camera {camera_id} at [{t}][{c}]: {error}")))?;
            let name = InnerPath::new(name, &inside).map_err(|problem| invalid(format!("fn[{t}][{c}] {problem}")))?;
            if !cameras.add(camera_id, camera, Change::Nothing, name) {
                return Err(invalid(format!("cam_id[{t}] has {camera_id} twice, expected every camera once")));
            }
        }
    }
    Ok(cameras.finish())
}

/// The mask files of a camera, if the camera has masks.
fn masks_beside(path: &Path, footage: &Footage, frames: &[usize]) -> Option<Files> {
    let Images::Stored { pixels: Pixels::Files { files, .. }, .. } = &footage.images else { return None };
    let names = files.names.with_extension("png", frames.iter().copied());
    Some(Files { folder: path.join(MASKS), names })
}
