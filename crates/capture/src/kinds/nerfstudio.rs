//! `transforms.json` of nerfstudio (Tancik et al. 2023), with a `time` for each image where the scene moves. Blender's
//! export for NeRF (Mildenhall et al. 2020) has the same in two files, `transforms_train.json` and
//! `transforms_test.json`; its images have no ending, and its cameras only an angle of view.
//!
//! ```text
//! transforms.json    frames[]: file_path, transform_matrix, time;
//!                    for all or each: w h fl_x fl_y cx cy k1 k2 k3 k4 p1 p2
//! images/…           as file_path says
//! sparse_pc.ply      points, as ply_file_path says; or points3D.ply …
//! ```
//!
//! A matrix is `world_from_camera` with the camera's axes right, up, backward. Images of one time are a timestep; every
//! timestep has the same cameras. Images in `val_filenames` and `test_filenames` are test images. Without these lists
//! every eighth camera of the first timestep is a test camera.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Deserialize;
use tcgs_core::{Camera, natural_key};

use super::test_cameras;
use crate::checked::{FrameRate, InnerPath, read_json};
use crate::contents::{CameraSetOfFiles, Contents, check_images};
use crate::footage::Change;
use crate::kind::{CaptureFacts, CaptureKind};
use crate::lens::{Crop, Lens, MAX_SIDE};
use crate::{CaptureError, decode, points};

const TRANSFORMS: &str = "transforms.json";
/// Blender's files: images for training, and test images.
const OF_BLENDER: [&str; 2] = ["transforms_train.json", "transforms_test.json"];
/// Base of the relative file names, in messages.
const INSIDE: &str = "the capture";

/// Times this close are one.
const TIME_STEP: f64 = 1e-6;

#[derive(Debug, Deserialize)]
pub(crate) struct Transforms {
    pub frames: Vec<Frame>,
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
    ply_file_path: Option<String>,
    val_filenames: Option<BTreeSet<String>>,
    test_filenames: Option<BTreeSet<String>>,
    /// Frames per second; an extension of this project.
    fps: Option<f64>,
}

#[derive(Debug, Deserialize)]
pub(crate) struct Frame {
    pub file_path: String,
    /// `[3 or 4][4]`
    pub transform_matrix: Vec<[f64; 4]>,
    time: Option<f64>,
    #[serde(flatten)]
    pub intrinsics: Intrinsics,
}

/// Intrinsics of one image, or of all.
#[derive(Clone, Debug, Default, Deserialize)]
pub(crate) struct Intrinsics {
    pub camera_model: Option<String>,
    pub camera_angle_x: Option<f64>,
    pub w: Option<f64>,
    pub h: Option<f64>,
    pub fl_x: Option<f64>,
    pub fl_y: Option<f64>,
    pub cx: Option<f64>,
    pub cy: Option<f64>,
    pub k1: Option<f64>,
    pub k2: Option<f64>,
    pub k3: Option<f64>,
    pub k4: Option<f64>,
    pub p1: Option<f64>,
    pub p2: Option<f64>,
}

impl CaptureKind {
    /// `transforms.json` of nerfstudio, with a time for each image if there are several timesteps.
    pub const NERFSTUDIO: Self = Self {
        name: "nerfstudio",
        mark: "transforms.json (nerfstudio) or transforms_train.json (Blender)",
        facts: CaptureFacts { has_floor: false, in_metres: false, labels_motion: false },
        recognises: |path| Ok([TRANSFORMS, OF_BLENDER[0]].iter().any(|file| path.join(file).exists())),
        open,
    };
}

/// Reads the cameras of a folder.
///
/// - returns: the file, and its content. For Blender's files: the training file with the images of both
pub(crate) fn read(path: &Path) -> Result<(PathBuf, Transforms), CaptureError> {
    let file = path.join(TRANSFORMS);
    if file.exists() {
        return Ok((file.clone(), read_json(&file)?));
    }
    let [file, other] = OF_BLENDER.map(|name| path.join(name));
    let mut transforms: Transforms = read_json(&file)?;
    if other.exists() {
        let for_test: Transforms = read_json(&other)?;
        let mut names = BTreeSet::new();
        for mut frame in for_test.frames {
            let angle = &mut frame.intrinsics.camera_angle_x;
            *angle = angle.or(for_test.intrinsics.camera_angle_x);
            names.insert(frame.file_path.clone());
            transforms.frames.push(frame);
        }
        transforms.test_filenames = Some(names);
    }
    Ok((file, transforms))
}

fn open(path: &Path) -> Result<Contents, CaptureError> {
    let (file, transforms) = read(path)?;
    let invalid = |problem: String| CaptureError::invalid(&file, problem);
    let frame_rate = FrameRate::of_file(transforms.fps, &file)?;
    let own_points = transforms.ply_file_path.as_deref().map(|path| InnerPath::new(path, INSIDE));
    let own_points = own_points.transpose().map_err(|problem| invalid(format!("ply_file_path {problem}")))?;
    let timesteps = timesteps(&transforms.frames).map_err(invalid)?;
    let for_test = test_cameras(&transforms, &timesteps).map_err(invalid)?;

    let num_frames = timesteps.len();
    let mut lenses =
        Lenses { capture: path, all: &transforms.intrinsics, known: BTreeMap::new(), sizes: BTreeMap::new() };
    let (mut train, mut test) = (CameraSetOfFiles::new(path), CameraSetOfFiles::new(path));
    for frames in &timesteps {
        train.begin_frame();
        test.begin_frame();
        for (camera_id, frame) in frames.iter().enumerate() {
            let (camera, change, name) = lenses.image(camera_id, frame, &file)?;
            let set = if for_test.contains(&camera_id) { &mut test } else { &mut train };
            set.add(camera_id, camera, change, name);
        }
    }
    let (train, test) = (train.finish(), test.finish());
    check_images(&train, num_frames, &file)?;
    check_images(&test, num_frames, &file)?;
    Ok(Contents {
        num_frames,
        frame_rate,
        usual_frames: 0..num_frames,
        train,
        test,
        cameras_files: [file.clone(), file],
        points: points::find(path, own_points.map(|ply| ply.below(path)).filter(|ply| ply.is_file())),
    })
}

/// Images by time, each timestep's cameras in the same order.
fn timesteps(frames: &[Frame]) -> Result<Vec<Vec<&Frame>>, String> {
    let with_time = frames.iter().filter(|frame| frame.time.is_some()).count();
    if with_time != 0 && with_time != frames.len() {
        return Err(format!("{with_time} of {} frames have a time, expected all or none", frames.len()));
    }
    for frame in frames {
        let time = frame.time.unwrap_or(0.0);
        if !time.is_finite() {
            return Err(format!("{}: time is {time}, expected a finite number", frame.file_path));
        }
    }
    let time = |frame: &Frame| frame.time.unwrap_or(0.0);
    let mut by_time: Vec<&Frame> = frames.iter().collect();
    by_time.sort_by(|a, b| time(a).total_cmp(&time(b)));
    let mut timesteps: Vec<Vec<&Frame>> =
        by_time.chunk_by(|a, b| time(b) - time(a) <= TIME_STEP).map(<[_]>::to_vec).collect();
    for frames in &mut timesteps {
        frames.sort_by_cached_key(|frame| natural_key(&frame.file_path));
    }
    let Some(first) = timesteps.first().cloned() else {
        return Err("has no frames, expected at least one".into());
    };
    for frames in &mut timesteps {
        if frames.len() != first.len() {
            let (found, time) = (frames.len(), frames[0].time.unwrap_or(0.0));
            return Err(format!("time {time} has {found} frames, expected {} as the first has", first.len()));
        }
        // Names may be in another order; static cameras are recognised by their poses.
        let at = |place: &Frame| frames.iter().copied().find(|frame| frame.transform_matrix == place.transform_matrix);
        let matched: Option<Vec<&Frame>> = first.iter().map(|place| at(place)).collect();
        let all_differ = |frames: &[&Frame]| {
            frames.iter().map(|frame| &frame.file_path).collect::<BTreeSet<_>>().len() == frames.len()
        };
        if let Some(matched) = matched.filter(|matched| all_differ(matched)) {
            *frames = matched;
        }
    }
    Ok(timesteps)
}

/// Indices of the test cameras.
fn test_cameras(transforms: &Transforms, timesteps: &[Vec<&Frame>]) -> Result<BTreeSet<usize>, String> {
    let num_cameras = timesteps[0].len();
    let (val, test) = (&transforms.val_filenames, &transforms.test_filenames);
    if val.is_none() && test.is_none() {
        let stride = if num_cameras < test_cameras::TEST_STRIDE { usize::MAX } else { test_cameras::TEST_STRIDE };
        return Ok((0..num_cameras).filter(|i| stride != usize::MAX && i % stride == 0).collect());
    }
    let named = |frame: &Frame| [val, test].into_iter().flatten().any(|names| names.contains(&frame.file_path));
    let of = |frames: &[&Frame]| (0..num_cameras).filter(|&i| named(frames[i])).collect::<BTreeSet<_>>();
    let cameras = of(&timesteps[0]);
    if let Some(frames) = timesteps.iter().find(|frames| of(frames) != cameras) {
        let time = frames[0].time.unwrap_or(0.0);
        return Err(format!("val_filenames and test_filenames name other cameras at time {time} than at the first"));
    }
    if cameras.len() == num_cameras {
        return Err("val_filenames and test_filenames name all images, expected some for training".into());
    }
    Ok(cameras)
}

/// The lenses found so far, since cropping one takes a while.
struct Lenses<'a> {
    capture: &'a Path,
    all: &'a Intrinsics,
    known: BTreeMap<Vec<u64>, Arc<Lens>>,
    /// Image sizes by camera, if only the images have them: one for each camera, since opening every image takes a
    /// while.
    sizes: BTreeMap<usize, (usize, usize)>,
}

impl Lenses<'_> {
    /// Camera and change of an image, and its file relative to the capture.
    fn image(
        &mut self,
        camera_id: usize,
        frame: &Frame,
        file: &Path,
    ) -> Result<(Camera, Change, InnerPath), CaptureError> {
        let image = InnerPath::new(&frame.file_path, INSIDE)
            .map_err(|problem| CaptureError::invalid(file, format!("file_path {problem}")))?
            .or_extension("png");
        let invalid = |problem: String| CaptureError::invalid(file, format!("{}: {problem}", frame.file_path));
        let lens = self.lens(&frame.intrinsics, camera_id, &image, invalid)?;
        let camera_from_world = camera_from_world(&frame.transform_matrix).map_err(invalid)?;
        let camera = Camera::new(lens.crop.width, lens.crop.height, lens.straight_intrinsics(), camera_from_world)
            .map_err(|error| invalid(error.to_string()))?;
        Ok((camera, Change::for_lens(&lens), image))
    }

    fn lens(
        &mut self,
        own: &Intrinsics,
        camera_id: usize,
        image: &InnerPath,
        invalid: impl Fn(String) -> CaptureError,
    ) -> Result<Arc<Lens>, CaptureError> {
        let model = own.camera_model.as_ref().or(self.all.camera_model.as_ref());
        if let Some(model) = model.filter(|model| !["OPENCV", "PINHOLE", "SIMPLE_PINHOLE"].contains(&model.as_str())) {
            return Err(invalid(format!("has the camera model {model}, expected OPENCV or PINHOLE")));
        }
        let all = self.all;
        let get = |of: fn(&Intrinsics) -> Option<f64>| of(own).or(of(all));
        let (width, height) = match (get(|i| i.w), get(|i| i.h)) {
            (Some(width), Some(height)) => (width, height),
            _ => {
                let (width, height) = match self.sizes.get(&camera_id) {
                    Some(&size) => size,
                    None => decode::size(&image.below(self.capture))?,
                };
                self.sizes.insert(camera_id, (width, height));
                (width as f64, height as f64)
            }
        };
        if [width, height].iter().any(|side| !(1.0..=MAX_SIDE as f64).contains(side)) {
            return Err(invalid(format!("is for {width}x{height} pixels, expected 1 to {MAX_SIDE} a side")));
        }
        let (width, height) = (width as usize, height as usize);
        let angle = get(|i| i.camera_angle_x);
        let fl_x = get(|i| i.fl_x).or(angle.map(|angle| 0.5 * width as f64 / (0.5 * angle).tan()));
        let Some(fl_x) = fl_x else {
            return Err(invalid("has neither fl_x nor camera_angle_x, expected a focal length in pixels".into()));
        };
        let or_zero = |of: fn(&Intrinsics) -> Option<f64>| get(of).unwrap_or(0.0);
        let mut lens = Lens {
            width,
            height,
            focal: [fl_x, get(|i| i.fl_y).unwrap_or(fl_x)],
            principal: [get(|i| i.cx).unwrap_or(width as f64 / 2.0), get(|i| i.cy).unwrap_or(height as f64 / 2.0)],
            radial: [or_zero(|i| i.k1), or_zero(|i| i.k2), or_zero(|i| i.k3), or_zero(|i| i.k4), 0.0, 0.0],
            tangential: [or_zero(|i| i.p1), or_zero(|i| i.p2)],
            crop: Crop::default(),
        };
        let numbers = [lens.focal, lens.principal, lens.tangential].into_iter().flatten().chain(lens.radial);
        let mut key: Vec<u64> = numbers.clone().map(f64::to_bits).collect();
        key.extend([width as u64, height as u64]);
        if let Some(number) = numbers.into_iter().find(|x| !x.is_finite()) {
            return Err(invalid(format!("holds {number} among its intrinsics, expected finite numbers")));
        }
        let [fx, fy] = lens.focal;
        if fx <= 0.0 || fy <= 0.0 {
            return Err(invalid(format!("has the focal lengths {fx} and {fy}, expected more than 0")));
        }
        if let Some(known) = self.known.get(&key) {
            return Ok(Arc::clone(known));
        }
        lens.find_crop().map_err(invalid)?;
        let lens = Arc::new(lens);
        self.known.insert(key, Arc::clone(&lens));
        Ok(lens)
    }
}

/// - `matrix`: `world_from_camera`, camera axes right, up, backward
pub(crate) fn camera_from_world(matrix: &[[f64; 4]]) -> Result<[[f64; 4]; 4], String> {
    let rows = matrix.first_chunk::<3>().filter(|_| matrix.len() <= 4);
    let rows = rows.ok_or_else(|| format!("transform_matrix has {} rows, expected 3 or 4", matrix.len()))?;
    let axis = |column: usize, sign: f64| rows.map(|row| sign * row[column]);
    let center = rows.map(|row| row[3]);
    let line = |axis: [f64; 3]| [axis[0], axis[1], axis[2], -tcgs_core::dot(axis, center)];
    Ok([line(axis(0, 1.0)), line(axis(1, -1.0)), line(axis(2, -1.0)), [0.0, 0.0, 0.0, 1.0]])
}
