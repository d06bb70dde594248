//! Panoptic Sports as prepared for Dynamic 3D Gaussians (Luiten et al. 2024).
//!
//! ```text
//! train_meta.json  test_meta.json       w, h, and per timestep and camera k, w2c, fn, cam_id
//! ims/<cam>/<frame>.jpg                 images, named by fn
//! seg/<cam>/<frame>.png                 masks, of the training cameras at least, or none
//! init_pt_cld.npz                       points
//! ```

use std::path::{Component, Path, PathBuf};

use rayon::prelude::*;
use tcgs_core::Camera;

use crate::{Capture, CaptureError, CaptureKind, meta::Meta, points, shot::Shot};

pub(crate) const TRAIN_META: &str = "train_meta.json";
const TEST_META: &str = "test_meta.json";
const IMAGES: &str = "ims";
const MASKS: &str = "seg";

/// Frames a second of CMU Panoptic's cameras.
const DEFAULT_FRAME_RATE: f64 = 30.0;

pub(crate) fn open(path: &Path) -> Result<Capture, CaptureError> {
    let images = path.join(IMAGES);
    if !images.is_dir() {
        return Err(CaptureError::invalid(images, "no such folder, expected the images that train_meta.json names"));
    }
    let train_meta = path.join(TRAIN_META);
    let meta = Meta::read(&train_meta)?;
    let frame_rate = meta.fps.unwrap_or(DEFAULT_FRAME_RATE);
    if !(frame_rate.is_finite() && frame_rate > 0.0) {
        return Err(CaptureError::invalid(&train_meta, format!("fps is {frame_rate}, expected more than 0")));
    }
    let mut train = shots(path, TRAIN_META, &meta)?;
    if train.is_empty() {
        return Err(CaptureError::invalid(&train_meta, "has no timesteps, expected at least one"));
    }
    if let Some(t) = train.iter().position(Vec::is_empty) {
        return Err(CaptureError::invalid(&train_meta, format!("fn[{t}] is empty, expected at least one camera")));
    }

    let test_meta = path.join(TEST_META);
    let mut test = if test_meta.exists() { shots(path, TEST_META, &Meta::read(&test_meta)?)? } else { Vec::new() };
    if test.is_empty() {
        test.resize_with(train.len(), Vec::new);
    }
    if test.len() != train.len() {
        let problem = format!("has {} timesteps, expected {} as {TRAIN_META} has", test.len(), train.len());
        return Err(CaptureError::invalid(&test_meta, problem));
    }

    check_images(&train, TRAIN_META)?;
    check_images(&test, TEST_META)?;
    let has_segmentation = find_train_masks(&mut train)?;
    drop_missing_masks(&mut test);

    Ok(Capture {
        path: path.into(),
        kind: CaptureKind::Panoptic,
        frame_rate,
        usual_frames: 0..train.len(),
        train,
        test,
        has_segmentation,
        cameras_files: [train_meta, test_meta],
        points: points::find(path, None),
    })
}

/// Cameras and file names of one meta file, `[T][C]`, each with the place where its mask would be.
fn shots(path: &Path, meta_name: &str, meta: &Meta) -> Result<Vec<Vec<Shot>>, CaptureError> {
    let invalid = |problem: String| CaptureError::invalid(path.join(meta_name), problem);
    let num_timesteps = meta.k.len();
    let lengths = [("w2c", meta.w2c.len()), ("fn", meta.file_names.len()), ("cam_id", meta.cam_id.len())];
    if let Some((key, length)) = lengths.into_iter().find(|&(_, length)| length != num_timesteps) {
        return Err(invalid(format!("{key} has {length} timesteps, expected {num_timesteps} as k has")));
    }
    let mut shots = Vec::with_capacity(num_timesteps);
    for t in 0..num_timesteps {
        let num_cameras = meta.k[t].len();
        let lengths = [("w2c", meta.w2c[t].len()), ("fn", meta.file_names[t].len()), ("cam_id", meta.cam_id[t].len())];
        if let Some((key, length)) = lengths.into_iter().find(|&(_, length)| length != num_cameras) {
            return Err(invalid(format!("{key}[{t}] has {length} cameras, expected {num_cameras} as k[{t}] has")));
        }
        let mut at_t: Vec<Shot> = Vec::with_capacity(num_cameras);
        for c in 0..num_cameras {
            let (camera_id, file_name) = (meta.cam_id[t][c], Path::new(&meta.file_names[t][c]));
            let camera = Camera::new(meta.w, meta.h, meta.k[t][c], meta.w2c[t][c])
                .map_err(|error| invalid(format!("camera {camera_id} at [{t}][{c}]: {error}")))?;
            if at_t.iter().any(|shot| shot.camera_id == camera_id) {
                return Err(invalid(format!("cam_id[{t}] has {camera_id} twice, expected every camera once")));
            }
            if file_name.components().next().is_none()
                || !file_name.components().all(|part| matches!(part, Component::Normal(_)))
            {
                let problem = format!("fn[{t}][{c}] is {file_name:?}, expected the path of a file inside {IMAGES}/");
                return Err(invalid(problem));
            }
            let mask = path.join(MASKS).join(file_name).with_extension("png");
            let shot = Shot::of_file(camera_id, camera, path.join(IMAGES).join(file_name));
            at_t.push(Shot { mask: Some(mask), ..shot });
        }
        shots.push(at_t);
    }
    Ok(shots)
}

fn check_images(shots: &[Vec<Shot>], meta_name: &str) -> Result<(), CaptureError> {
    let all: Vec<(usize, usize, &Shot)> = shots
        .iter()
        .enumerate()
        .flat_map(|(t, at_t)| at_t.iter().enumerate().map(move |(c, shot)| (t, c, shot)))
        .collect();
    match all.par_iter().find_first(|(_, _, shot)| !shot.path().is_file()) {
        Some((t, c, shot)) => {
            Err(CaptureError::invalid(shot.path(), format!("no such file, expected it as fn[{t}][{c}] of {meta_name}")))
        }
        None => Ok(()),
    }
}

/// Forgets masks that do not exist.
///
/// - returns: the first of them, and how many remain
fn drop_missing_masks(shots: &mut [Vec<Shot>]) -> (Option<PathBuf>, usize) {
    let mut all: Vec<&mut Shot> = shots.iter_mut().flatten().collect();
    let exist: Vec<bool> = all.par_iter().map(|shot| shot.mask.as_ref().is_some_and(|mask| mask.is_file())).collect();
    let mut first_missing = None;
    for (shot, _) in all.iter_mut().zip(&exist).filter(|(_, exists)| !**exists) {
        let missing = shot.mask.take();
        first_missing = first_missing.or(missing);
    }
    (first_missing, exist.iter().filter(|exists| **exists).count())
}

/// Whether all training images have a mask; that some have is an error, for then one is lost.
fn find_train_masks(train: &mut [Vec<Shot>]) -> Result<bool, CaptureError> {
    let num_images = train.iter().map(Vec::len).sum::<usize>();
    match drop_missing_masks(train) {
        (None, _) => Ok(true),
        (Some(_), 0) => Ok(false),
        (Some(missing), found) => {
            let problem =
                format!("no such file, expected masks of all {num_images} training images or of none, found {found}");
            Err(CaptureError::invalid(missing, problem))
        }
    }
}
