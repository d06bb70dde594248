//! `*.qca.txt`, the XML that Qualisys Track Manager exports.
//!
//! ```text
//! <camera serial="…">
//!   <fov_video left top right bottom/>                         first and last pixel, both inclusive
//!   <transform x y z r11 … r33/>                               where the camera stands
//!   <intrinsic focalLengthU … centerPointU … radialDistortion1 … tangentalDistortion1 …/>
//! ```
//!
//! | | |
//! |---|---|
//! | direction | `world_from_camera`: `x y z` is the camera's centre; the rotation's columns are the file's rows |
//! | axes | x right, y up, z backward; here y and z are turned round |
//! | pixels | 1/64 pixel from the centre of the sensor's first pixel; here less the corner of `fov_video`, plus 0.5 |
//! | distortion | `k1 k2 k3`, `p1 p2`, as OpenCV's, without a factor of 64 |
//! | unit | millimetres; here metres |
//!
//! The demo of Pose2Sim shows that the distortion has no factor. It holds a calibration of the same cameras by OpenCV,
//! with `k1 = -0.047` and `k2 = 0.149`; the Qualisys file has `-0.048` and `0.137`.

use std::path::Path;

use roxmltree::{Document, Node};

use super::numbers::{OpenCvCamera, inverse, rigid, side};
use super::{CalibratedCamera, Format, files_named};
use crate::{CaptureError, files};

/// Parts of a pixel.
const SUBPIXELS: f64 = 64.0;
const METRES_PER_MILLIMETRE: f64 = 1e-3;

pub(super) const FORMAT: Format = Format {
    name: "qualisys",
    mark: "*.qca.txt (Qualisys)",
    find: |folder| files_named(folder, |name| name.ends_with(".qca.txt")),
    is: |path| files::name(path).ends_with(".qca.txt"),
    read,
    in_metres: true,
};

fn read(path: &Path) -> Result<Vec<CalibratedCamera>, CaptureError> {
    let text = files::text(path)?;
    let document =
        Document::parse(&text).map_err(|error| CaptureError::invalid(path, format!("is no XML: {error}")))?;
    let cameras = document.descendants().filter(|node| node.has_tag_name("camera"));
    // Cameras for markers alone have no intrinsics of a video.
    let cameras = cameras.filter(|camera| child(*camera, "intrinsic").is_ok());
    let read = |camera: Node<'_, '_>| {
        let name = camera.attribute("serial").unwrap_or("without serial").to_owned();
        let problem = |problem: String| CaptureError::invalid(path, format!("camera {name}: {problem}"));
        camera_of(camera, name.clone()).map_err(problem)
    };
    cameras.map(read).collect()
}

fn camera_of(camera: Node<'_, '_>, name: String) -> Result<CalibratedCamera, String> {
    let (video, pose, lens) = (child(camera, "fov_video")?, child(camera, "transform")?, child(camera, "intrinsic")?);
    let [left, top, right, bottom] = numbers(video, ["left", "top", "right", "bottom"])?;
    let size = side(right - left + 1.0).zip(side(bottom - top + 1.0));
    let size = size.ok_or(format!("its fov_video is {left} {top} {right} {bottom}, expected whole pixels"))?;
    let focal = numbers(lens, ["focalLengthU", "focalLengthV"])?.map(|f| f / SUBPIXELS);
    let center = numbers(lens, ["centerPointU", "centerPointV"])?.map(|c| c / SUBPIXELS);
    let radial = numbers(lens, ["radialDistortion1", "radialDistortion2", "radialDistortion3"])?;
    let tangential = numbers(lens, ["tangentalDistortion1", "tangentalDistortion2"])?;

    let position = numbers(pose, ["x", "y", "z"])?.map(|x| x * METRES_PER_MILLIMETRE);
    let right_axis = numbers(pose, ["r11", "r12", "r13"])?;
    let up = numbers(pose, ["r21", "r22", "r23"])?;
    let backward = numbers(pose, ["r31", "r32", "r33"])?;
    let (down, forward) = (up.map(|x| -x), backward.map(|x| -x));
    let world_from_camera = rigid(std::array::from_fn(|i| [right_axis[i], down[i], forward[i]]), position)?;
    let pose = inverse(world_from_camera);
    let camera = OpenCvCamera {
        names: vec![name],
        size: Some(size),
        matrix: [[focal[0], 0.0, center[0] - left], [0.0, focal[1], center[1] - top], [0.0, 0.0, 1.0]],
        distortion: vec![radial[0], radial[1], tangential[0], tangential[1], radial[2]],
        rotation: pose.map(|[a, b, c, _]| [a, b, c]),
        translation: pose.map(|row| row[3]),
    };
    camera.checked()
}

fn child<'a, 'b>(camera: Node<'a, 'b>, name: &str) -> Result<Node<'a, 'b>, String> {
    camera.children().find(|node| node.has_tag_name(name)).ok_or_else(|| format!("has no <{name}>, expected one"))
}

fn numbers<const N: usize>(node: Node<'_, '_>, names: [&str; N]) -> Result<[f64; N], String> {
    let mut values = [0.0; N];
    for (value, name) in values.iter_mut().zip(names) {
        let text = node.attribute(name).ok_or_else(|| format!("<{}> has no {name}", node.tag_name().name()))?;
        *value = text.trim().parse().map_err(|_| format!("{name} is {text:?}, expected a number"))?;
    }
    Ok(values)
}
