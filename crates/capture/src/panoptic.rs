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
use tcgs_core::{Camera, PointCloud};

use crate::{
    CaptureError,
    capture::{Capture, CaptureKind, Shot},
    meta::Meta,
    sight,
};

const TRAIN_META: &str = "train_meta.json";
const TEST_META: &str = "test_meta.json";
pub(crate) const POINTS: &str = "init_pt_cld.npz";
const IMAGES: &str = "ims";
const MASKS: &str = "seg";

/// Frames a second of CMU Panoptic's cameras.
const DEFAULT_FRAME_RATE: f64 = 30.0;

pub(crate) fn open(path: &Path) -> Result<Capture, CaptureError> {
    check_folder(path, &[TRAIN_META, POINTS, IMAGES])?;
    let capture = open_without_points(path)?;
    let cloud = capture.point_cloud()?;
    check_sight(&path.join(TRAIN_META), &capture.train[0], &cloud)?;
    check_sight(&path.join(TEST_META), &capture.test[0], &cloud)?;
    Ok(capture)
}

fn check_folder(path: &Path, names: &[&str]) -> Result<(), CaptureError> {
    let not_capture = |problem: String| CaptureError::NotCapture { path: path.into(), problem };
    if !path.is_dir() {
        return Err(not_capture(if path.exists() { "is a file".into() } else { "no such folder".into() }));
    }
    match names.iter().find(|name| !path.join(name).exists()) {
        Some(name) => Err(not_capture(format!("has no {name}"))),
        None => Ok(()),
    }
}

pub(crate) fn open_without_points(path: &Path) -> Result<Capture, CaptureError> {
    check_folder(path, &[TRAIN_META, IMAGES])?;
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

    Ok(Capture { path: path.into(), kind: CaptureKind::Panoptic, frame_rate, train, test, has_segmentation })
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
            at_t.push(Shot { camera_id, camera, image: path.join(IMAGES).join(file_name), mask: Some(mask) });
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
    match all.par_iter().find_first(|(_, _, shot)| !shot.image.is_file()) {
        Some((t, c, shot)) => {
            Err(CaptureError::invalid(&shot.image, format!("no such file, expected it as fn[{t}][{c}] of {meta_name}")))
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

fn check_sight(meta_path: &Path, shots: &[Shot], cloud: &PointCloud) -> Result<(), CaptureError> {
    let cameras: Vec<&Camera> = shots.iter().map(|shot| &shot.camera).collect();
    sight::check(&cameras, cloud).map_err(|problem| CaptureError::invalid(meta_path, problem))
}
