//! The light-field videos of Technicolor (Sabater et al. 2017): 16 cameras in a grid, a file an image.
//!
//! ```text
//! cameras_parameters.txt                    a title, then a line a camera: f cu cv ar sk qw qx qy qz tx ty tz
//! <Scene>_undist_<frame>_<camera>.png       2048x1088 pixels
//! points3D.ply, sparse/0 …                  points
//! ```
//!
//! The quaternion and the vector make `camera_from_world`, as in COLMAP. Publications test on camera 10 and use 50
//! frames of each of five scenes. One published file, `Birthday_undist_00173_09.png`, is damaged: its missing rows are
//! taken from the frame before, as the preparation for Spacetime Gaussians does.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

use tcgs_core::{Camera, length, rotmat_from_quat};

use crate::checked::{FrameRate, InnerPath};
use crate::contents::{CameraSetOfFiles, Contents};
use crate::footage::Change;
use crate::kind::{CaptureFacts, CaptureKind};
use crate::{CaptureError, colmap, decode, files, points};

const CAMERAS: &str = "cameras_parameters.txt";

/// Test camera.
const TEST_CAMERA: usize = 10;
/// Numbers of the files that publications use.
const USUAL_FRAMES: [(&str, Range<usize>); 5] =
    [("Birthday", 151..201), ("Fabien", 51..101), ("Painter", 100..150), ("Theater", 51..101), ("Train", 151..201)];
/// Scene, frame and camera of the damaged file.
const DAMAGED: (&str, usize, usize) = ("Birthday", 173, 9);

/// Number of columns of a line, for undistorted and for original images.
const COLUMNS: usize = 12;
const ORIGINAL_COLUMNS: usize = 14;

impl CaptureKind {
    /// The light-field videos of Technicolor: a file an image.
    pub const TECHNICOLOR: Self = Self {
        name: "technicolor",
        mark: "cameras_parameters.txt (Technicolor)",
        facts: CaptureFacts { has_floor: false, in_metres: false, labels_motion: false },
        recognises: |path| Ok(path.join(CAMERAS).exists()),
        open,
    };
}

fn open(path: &Path) -> Result<Contents, CaptureError> {
    let cameras_file = path.join(CAMERAS);
    let lines = read_lines(&cameras_file)?;
    let (scene, images) = images(path)?;
    let frames: Vec<usize> = images.keys().map(|&(frame, _)| frame).collect::<BTreeSet<_>>().into_iter().collect();
    let image = |frame: usize, camera: usize| -> Result<&PathBuf, CaptureError> {
        images.get(&(frame, camera)).ok_or_else(|| {
            let missing = path.join(format!("{scene}_undist_{frame:05}_{camera:02}.png"));
            let problem =
                format!("no such file, expected an image for each of the {} cameras in {CAMERAS}", lines.len());
            CaptureError::invalid(missing, problem)
        })
    };
    if let Some((frame, camera)) = images.keys().find(|(_, camera)| *camera >= lines.len()) {
        let problem = format!(
            "has {} cameras, expected more: {} is of camera {camera}",
            lines.len(),
            files::name(image(*frame, *camera)?)
        );
        return Err(CaptureError::invalid(&cameras_file, problem));
    }
    let mut cameras = Vec::new();
    for (id, line) in lines.iter().enumerate() {
        let size = decode::size(image(frames[0], id)?)?;
        let camera = camera(line, size).map_err(|problem| {
            CaptureError::invalid(&cameras_file, format!("line {}, camera {id}: {problem}", id + 2))
        })?;
        cameras.push(camera);
    }

    let (mut train, mut test) = (CameraSetOfFiles::new(path), CameraSetOfFiles::new(path));
    for &frame in &frames {
        train.begin_frame();
        test.begin_frame();
        for (id, camera) in cameras.iter().enumerate() {
            let set = if id == TEST_CAMERA { &mut test } else { &mut train };
            set.add(id, camera.clone(), Change::Nothing, InnerPath::of_listed(image(frame, id)?));
            if (scene.as_str(), frame, id) == DAMAGED && images.contains_key(&(frame.wrapping_sub(1), id)) {
                set.last_is_cut();
            }
        }
    }
    Ok(Contents {
        num_frames: frames.len(),
        frame_rate: FrameRate::USUAL,
        usual_frames: usual_frames(&scene, &frames),
        train: train.finish(),
        test: test.finish(),
        cameras_files: [cameras_file.clone(), cameras_file],
        points: points::find(path, colmap::points_file(path)),
    })
}

/// The numbers of every line after the title.
fn read_lines(path: &Path) -> Result<Vec<[f64; COLUMNS]>, CaptureError> {
    let invalid = |problem: String| CaptureError::invalid(path, problem);
    let text = files::text(path)?;
    let mut lines = Vec::new();
    for (i, line) in text.lines().enumerate().skip(1).filter(|(_, line)| !line.trim().is_empty()) {
        let expected = "expected 12 numbers: f cu cv ar sk qw qx qy qz tx ty tz";
        let mut numbers = Vec::new();
        for word in line.split_whitespace() {
            let number = word.parse::<f64>().ok().filter(|number| number.is_finite());
            numbers.push(number.ok_or_else(|| invalid(format!("line {}: found {word}, {expected}", i + 1)))?);
        }
        let numbers = <[f64; COLUMNS]>::try_from(numbers).map_err(|numbers| match numbers.len() {
            ORIGINAL_COLUMNS => invalid(format!(
                "line {}: has {ORIGINAL_COLUMNS} numbers, those of the original images, expected the {COLUMNS} of the \
                 undistorted ones",
                i + 1
            )),
            count => invalid(format!("line {}: has {count} numbers, {expected}", i + 1)),
        })?;
        lines.push(numbers);
    }
    if lines.len() < 2 {
        return Err(invalid(format!("has {} cameras, expected at least 2 below its title", lines.len())));
    }
    Ok(lines)
}

fn camera(line: &[f64; COLUMNS], (width, height): (usize, usize)) -> Result<Camera, String> {
    let &[focal, cx, cy, aspect, skew, qw, qx, qy, qz, tx, ty, tz] = line;
    let norm = length([qw, qx, qy, qz]);
    if (norm - 1.0).abs() > 1e-2 {
        return Err(format!("the quaternion has the length {norm}, expected 1"));
    }
    let [x, y, z] = rotmat_from_quat([qw, qx, qy, qz]);
    let row = |r: [f64; 3], t: f64| [r[0], r[1], r[2], t];
    let intrinsics = [[focal, skew, cx], [0.0, focal * aspect, cy], [0.0, 0.0, 1.0]];
    Camera::new(width, height, intrinsics, [row(x, tx), row(y, ty), row(z, tz), [0.0, 0.0, 0.0, 1.0]])
        .map_err(|error| error.to_string())
}

/// Images by frame and camera.
type Images = BTreeMap<(usize, usize), PathBuf>;

/// Name of the scene, and its images.
fn images(path: &Path) -> Result<(String, Images), CaptureError> {
    let mut images = BTreeMap::new();
    let mut scene = None;
    for file in files::images(path)? {
        let stem = files::stem(&file);
        let parts: Vec<&str> = stem.rsplitn(3, '_').collect();
        let &[camera, frame, before] = parts.as_slice() else { continue };
        let (Ok(camera), Ok(frame), Some(name)) = (camera.parse(), frame.parse(), before.strip_suffix("_undist"))
        else {
            continue;
        };
        let scene = scene.get_or_insert_with(|| name.to_owned());
        if scene != name {
            let problem = format!("is of the scene {name}, expected {scene} as the files before it");
            return Err(CaptureError::invalid(file, problem));
        }
        images.insert((frame, camera), file);
    }
    match scene {
        Some(scene) => Ok((scene, images)),
        None => {
            let problem = format!("has {CAMERAS}, but no images, expected <Scene>_undist_<frame>_<camera>.png");
            Err(CaptureError::invalid(path, problem))
        }
    }
}

/// Positions of the frames that publications use; all frames of an unknown scene, or if none of them exists.
fn usual_frames(scene: &str, frames: &[usize]) -> Range<usize> {
    let position = |number: usize| frames.partition_point(|&frame| frame < number);
    let usual = USUAL_FRAMES.iter().find(|(name, _)| *name == scene);
    let usual = usual.map(|(_, numbers)| position(numbers.start)..position(numbers.end));
    usual.filter(|usual| !usual.is_empty()).unwrap_or(0..frames.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn publications_use_fifty_frames() {
        let all: Vec<usize> = (1..=300).collect();
        assert_eq!(usual_frames("Birthday", &all), 150..200);
        assert_eq!(usual_frames("Painter", &(0..200).collect::<Vec<_>>()), 100..150);
        assert_eq!(usual_frames("Train", &(151..=200).collect::<Vec<_>>()), 0..50);
        assert_eq!(usual_frames("Rugby", &all), 0..300);
        assert_eq!(usual_frames("Train", &[1, 2, 3]), 0..3);
    }
}
