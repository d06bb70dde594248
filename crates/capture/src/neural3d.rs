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
//! What publications agree on: `cam00` is for judging, the first 300 frames are used, and the published videos of
//! 2704x2028 pixels are halved by Lanczos resampling.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::Camera;
use tcgs_interchange::read_npy;

use crate::shot::{Change, Shot, Source};
use crate::{Capture, CaptureError, CaptureKind, colmap, decode, files, points, video::Video};

pub(crate) const POSES: &str = "poses_bounds.npy";

/// Values of a row.
const COLUMNS: usize = 17;
/// Position of the camera for judging, in the order of names.
const TEST_CAMERA: usize = 0;
/// Frames that publications use.
const USUAL_FRAMES: usize = 300;
/// Size of the published videos.
const PUBLISHED_SIZE: (usize, usize) = (2704, 2028);
/// Frames a second where only images are left.
const FRAME_RATE: f64 = 30.0;
/// How far the shape of a video's frames may be from that of its poses.
const SHAPE_TOLERANCE: f64 = 0.01;

/// All images of one camera.
struct Footage {
    path: PathBuf,
    size: (usize, usize),
    frames: Frames,
}

enum Frames {
    Video(Arc<Video>),
    Files(Vec<PathBuf>),
}

/// Whether there are videos, or folders of their frames.
pub(crate) fn has_cameras(path: &Path) -> Result<bool, CaptureError> {
    Ok(!footage_paths(path)?.is_empty())
}

pub(crate) fn open(path: &Path) -> Result<Capture, CaptureError> {
    let poses_file = path.join(POSES);
    let poses = read_npy(&poses_file)?;
    let invalid = |problem: String| CaptureError::invalid(&poses_file, problem);
    let &[num_poses, COLUMNS] = poses.shape.as_slice() else {
        let problem = format!("has the shape {:?}, expected [cameras, {COLUMNS}]", poses.shape);
        return Err(invalid(problem));
    };
    let paths = footage_paths(path)?;
    if paths.len() != num_poses {
        return Err(invalid(wrong_count(num_poses, &paths)));
    }
    if num_poses < 2 {
        return Err(invalid("has 1 camera, expected at least 2: the first is for judging".into()));
    }
    let footage: Vec<_> = paths.into_par_iter().map(Footage::open).collect();
    let footage = footage.into_iter().collect::<Result<Vec<_>, _>>()?;
    let num_frames = footage.iter().map(Footage::num_frames).min().unwrap_or(0);

    let mut cameras = Vec::new();
    for (i, (row, footage)) in poses.values.as_chunks::<COLUMNS>().0.iter().zip(&footage).enumerate() {
        let problem = |problem: String| invalid(format!("row {i}, of {}: {problem}", files::name(&footage.path)));
        cameras.push(camera(row, footage.size).map_err(problem)?);
    }
    let shots = |frame: usize, for_test: bool| -> Vec<Shot> {
        let chosen = (0..footage.len()).filter(|&i| (i == TEST_CAMERA) == for_test);
        chosen.map(|i| footage[i].shot(i, frame, &cameras[i])).collect()
    };
    Ok(Capture {
        path: path.into(),
        kind: CaptureKind::Neural3d,
        frame_rate: footage[0].frame_rate(),
        usual_frames: 0..num_frames.min(USUAL_FRAMES),
        train: (0..num_frames).map(|frame| shots(frame, false)).collect(),
        test: (0..num_frames).map(|frame| shots(frame, true)).collect(),
        has_segmentation: false,
        cameras_files: [poses_file.clone(), poses_file],
        points: points::find(path, colmap::points_file(path)),
    })
}

/// `cam*.mp4`; where there are none, folders `cam*`; in natural order.
fn footage_paths(path: &Path) -> Result<Vec<PathBuf>, CaptureError> {
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
/// - `size`: of its images; where they are smaller than the poses say, the focal length is too
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

impl Footage {
    fn open(path: PathBuf) -> Result<Self, CaptureError> {
        let (size, frames) = if path.is_file() {
            let video = Video::open(&path)?;
            (video.size(), Frames::Video(Arc::new(video)))
        } else {
            let images = path.join("images");
            let files = files::images(if images.is_dir() { &images } else { &path })?;
            let first = files
                .first()
                .ok_or_else(|| CaptureError::invalid(&path, "has no images, expected a file a frame, .png or .jpg"))?;
            (decode::size(first)?, Frames::Files(files))
        };
        Ok(Self { path, size, frames })
    }

    fn num_frames(&self) -> usize {
        match &self.frames {
            Frames::Video(video) => video.num_frames(),
            Frames::Files(files) => files.len(),
        }
    }

    fn frame_rate(&self) -> f64 {
        match &self.frames {
            Frames::Video(video) if video.frame_rate() > 0.0 => video.frame_rate(),
            _ => FRAME_RATE,
        }
    }

    fn shot(&self, camera_id: usize, frame: usize, camera: &Camera) -> Shot {
        let source = match &self.frames {
            Frames::Video(video) => Source::Video { video: Arc::clone(video), frame },
            Frames::Files(files) => Source::File(files[frame].clone()),
        };
        let (camera, change) = match self.size {
            PUBLISHED_SIZE => (camera.downscaled(2), Change::Halve),
            _ => (camera.clone(), Change::Nothing),
        };
        Shot { camera_id, camera, source, change, mask: None }
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
