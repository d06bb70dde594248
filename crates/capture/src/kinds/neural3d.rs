//! Neural 3D Video (Li et al. 2022): a video a camera, poses as LLFF (Mildenhall et al. 2019) writes them.
//!
//! ```text
//! cam00.mp4  cam01.mp4  …       or folders cam00/ or cam00/images/ of a file a frame
//! poses_bounds.npy              [C, 17], rows in the order of the cameras' names
//! points3D.ply, sparse/0 …      points
//! ```
//!
//! A row holds a matrix `[3, 5]` and the nearest and farthest depth. The matrix's columns are the camera's down, right
//! and backward directions in the world, its centre, and height, width and focal length in pixels.
//!
//! Publications agree on three settings: `cam00` is the test camera, the first 300 frames are used, and the published
//! videos of 2704x2028 pixels are halved by Lanczos resampling.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::Camera;
use tcgs_interchange::read_npy;

use crate::checked::FrameRate;
use crate::contents::{CameraSet, Contents};
use crate::footage::{ByFrame, Change, Footage, Images, Masks, Pixels};
use crate::kind::{CaptureFacts, CaptureKind};
use crate::names::{Files, Names};
use crate::{CaptureError, colmap, decode, files, points, video::Video};

const POSES: &str = "poses_bounds.npy";

/// Values of a row.
const COLUMNS: usize = 17;
/// Position of the test camera, in the order of names.
const TEST_CAMERA: usize = 0;
/// Frames that publications use.
const USUAL_FRAMES: usize = 300;
/// Size of the published videos.
const PUBLISHED_SIZE: (usize, usize) = (2704, 2028);
/// Largest difference in aspect ratio between a video's frames and its poses.
const SHAPE_TOLERANCE: f64 = 0.01;

impl CaptureKind {
    /// Neural 3D Video: a video a camera, poses as LLFF writes them.
    pub const NEURAL3D: Self = Self {
        name: "neural3d",
        mark: "poses_bounds.npy with cam*.mp4 (Neural 3D Video)",
        facts: CaptureFacts { has_floor: false, in_metres: false, labels_motion: false },
        recognises,
        open,
    };
}

/// The video of one camera, or the folder of its frames.
struct Recording {
    path: PathBuf,
    size: (usize, usize),
    num_frames: usize,
    pixels: Pixels,
}

/// Other programs leave poses beside a COLMAP model. Without videos such a folder is a model.
fn recognises(path: &Path) -> Result<bool, CaptureError> {
    Ok(path.join(POSES).exists() && (!recordings(path)?.is_empty() || colmap::model_folder(path).is_none()))
}

fn open(path: &Path) -> Result<Contents, CaptureError> {
    let poses_file = path.join(POSES);
    files::check_regular(&poses_file)?;
    let poses = read_npy(&poses_file)?;
    let invalid = |problem: String| CaptureError::invalid(&poses_file, problem);
    let &[num_poses, COLUMNS] = poses.shape.as_slice() else {
        let problem = format!("has the shape {:?}, expected [cameras, {COLUMNS}]", poses.shape);
        return Err(invalid(problem));
    };
    let paths = recordings(path)?;
    if paths.len() != num_poses {
        return Err(invalid(wrong_count(num_poses, &paths)));
    }
    if num_poses < 2 {
        return Err(invalid("has 1 camera, expected at least 2: the first is for judging".into()));
    }
    let recordings: Vec<_> = paths.into_par_iter().map(Recording::open).collect();
    let recordings = recordings.into_iter().collect::<Result<Vec<_>, _>>()?;
    let num_frames = recordings.iter().map(|recording| recording.num_frames).min().unwrap_or(0);
    let frame_rate = recordings[0].frame_rate();

    let (mut train, mut test) = (Vec::new(), Vec::new());
    for (i, (row, recording)) in poses.values.as_chunks::<COLUMNS>().0.iter().zip(recordings).enumerate() {
        let problem = |problem: String| invalid(format!("row {i}, of {}: {problem}", files::name(&recording.path)));
        let camera = camera(row, recording.size).map_err(problem)?;
        if i == TEST_CAMERA { &mut test } else { &mut train }.push(recording.footage(i, camera));
    }
    Ok(Contents {
        num_frames,
        frame_rate,
        usual_frames: 0..num_frames.min(USUAL_FRAMES),
        train: CameraSet::constant(train),
        test: CameraSet::constant(test),
        cameras_files: [poses_file.clone(), poses_file],
        points: points::find(path, colmap::points_file(path)),
    })
}

/// `cam*.mp4`; where there are none, folders `cam*`; in natural order.
fn recordings(path: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let mut paths = files::list(path)?;
    paths.retain(|path| files::name(path).starts_with("cam"));
    let (videos, others): (Vec<_>, Vec<_>) =
        paths.into_iter().partition(|path| files::has_extension(path, &["mp4"]) && path.is_file());
    let folders = others.into_iter().filter(|path| path.is_dir()).collect();
    Ok(if videos.is_empty() { folders } else { videos })
}

fn wrong_count(num_poses: usize, paths: &[PathBuf]) -> String {
    let found = paths.len();
    let expected = "expected one pose for each camera, in the order of their names";
    let names: Vec<String> = paths.iter().map(|path| files::stem(path)).collect();
    let missing: Vec<String> =
        (0..num_poses).map(|i| format!("cam{i:02}")).filter(|name| !names.contains(name)).collect();
    match missing.as_slice() {
        _ if found == 0 => format!("has {num_poses} poses, but there is no cam*.mp4, {expected}"),
        missing if missing.len() + found == num_poses => {
            format!("has {num_poses} poses for {found} videos, {expected}; missing: {}", missing.join(", "))
        }
        _ => format!("has {num_poses} poses for {found} videos cam*.mp4, {expected}"),
    }
}

/// A camera from a row of poses.
///
/// - `size`: of its images; where they are smaller than the poses' size, the focal length is scaled
fn camera(row: &[f32; COLUMNS], (width, height): (usize, usize)) -> Result<Camera, String> {
    let at = |i: usize, j: usize| f64::from(row[5 * i + j]);
    let [pose_height, pose_width, pose_focal] = [at(0, 4), at(1, 4), at(2, 4)];
    let (by_width, by_height) = (width as f64 / pose_width, height as f64 / pose_height);
    if (by_width / by_height - 1.0).abs() > SHAPE_TOLERANCE || by_width.is_nan() || by_width <= 0.0 {
        return Err(format!("is for {pose_width}x{pose_height} pixels, expected the shape of {width}x{height}"));
    }
    let focal = pose_focal * by_width;
    // Columns down, right, backward; ours are right, down, forward.
    let axes: [[f64; 3]; 3] =
        [std::array::from_fn(|i| at(i, 1)), std::array::from_fn(|i| at(i, 0)), std::array::from_fn(|i| -at(i, 2))];
    let center = std::array::from_fn(|i| at(i, 3));
    let line = |axis: [f64; 3]| [axis[0], axis[1], axis[2], -tcgs_core::dot(axis, center)];
    let [right, down, forward] = axes.map(line);
    let intrinsics = [[focal, 0.0, width as f64 / 2.0], [0.0, focal, height as f64 / 2.0], [0.0, 0.0, 1.0]];
    Camera::new(width, height, intrinsics, [right, down, forward, [0.0, 0.0, 0.0, 1.0]])
        .map_err(|error| error.to_string())
}

impl Recording {
    fn open(path: PathBuf) -> Result<Self, CaptureError> {
        if path.is_file() {
            let video = Video::open(&path)?;
            let (size, num_frames) = (video.size(), video.num_frames());
            return Ok(Self { path, size, num_frames, pixels: Pixels::Video(Arc::new(video)) });
        }
        let images = path.join("images");
        let folder = if images.is_dir() { images } else { path.clone() };
        let images = files::images(&folder)?;
        let first = images
            .first()
            .ok_or_else(|| CaptureError::invalid(&path, "has no images, expected a file a frame, .png or .jpg"))?;
        let (size, num_frames) = (decode::size(first)?, images.len());
        let names: Vec<(usize, String)> = images.iter().map(|image| files::name(image)).enumerate().collect();
        let files = Files { folder, names: Names::of(&names) };
        Ok(Self { path, size, num_frames, pixels: Pixels::Files { files, cut_frame: None } })
    }

    /// Frame rate of the video; the usual one for images alone, or for a video without a duration.
    fn frame_rate(&self) -> FrameRate {
        match &self.pixels {
            Pixels::Video(video) => FrameRate::new(video.frame_rate()).unwrap_or(FrameRate::USUAL),
            Pixels::Files { .. } | Pixels::Take(_) => FrameRate::USUAL,
        }
    }

    fn footage(self, camera_id: usize, camera: Camera) -> Footage {
        let (camera, change) = match self.size {
            PUBLISHED_SIZE => (camera.downscaled(2), Change::Halve),
            _ => (camera, Change::Nothing),
        };
        let images = Images::Stored { pixels: self.pixels, changes: ByFrame::constant(change) };
        let name = files::stem(&self.path);
        Footage { camera_id, name, cameras: ByFrame::constant(camera), images, masks: Masks::None }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_becomes_a_camera() {
        // Looks along world x, its right is world -y, its down is world -z.
        let columns = [[0.0, 0.0, -1.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [4.0, 5.0, 6.0], [2028.0, 2704.0, 1500.0]];
        let mut row = [0.0; COLUMNS];
        for i in 0..3 {
            for (j, column) in columns.iter().enumerate() {
                row[5 * i + j] = column[i];
            }
        }
        let camera = camera(&row, (1352, 1014)).unwrap();
        assert_eq!((camera.focal, camera.principal), ([750.0; 2], [676.0, 507.0]));
        assert_eq!((camera.center(), camera.forward()), ([4.0, 5.0, 6.0], [1.0, 0.0, 0.0]));
        assert_eq!(camera.camera_from_world[0][..3], [0.0, -1.0, 0.0]);
        let problem = super::camera(&row, (1352, 1352)).unwrap_err();
        assert_eq!(problem, "is for 2704x2028 pixels, expected the shape of 1352x1352");
        row[0] = 1.0;
        assert!(super::camera(&row, (1352, 1014)).unwrap_err().contains("is not a rotation"));
    }
}
