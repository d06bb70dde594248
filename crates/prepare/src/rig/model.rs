//! COLMAP's text model, both ways: the program's result, and a readable model beside a capture.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use tcgs_capture::{ColmapModel, files};
use tcgs_core::rotmat_from_quat;

use super::bundle::Track;
use super::camera::RigCamera;
use super::program::camera_of;
use crate::PrepareError;

/// Cameras and points that belong together.
pub(super) struct Found {
    /// `None` for a camera that was not placed.
    pub cameras: Vec<Option<RigCamera>>,
    /// Observations name cameras by their index in `cameras`.
    pub tracks: Vec<Track>,
}

impl Found {
    pub fn num_placed(&self) -> usize {
        self.cameras.iter().flatten().count()
    }

    /// Reads a model of one or several images a camera. The image that sees most points gives the camera's pose; all of
    /// them have a part in the tracks.
    pub fn read(folder: &Path, num_cameras: usize) -> Result<Self, PrepareError> {
        let ColmapModel { cameras: lenses, images, .. } = ColmapModel::read(folder)?;
        // The binary files beside the text hold the same cameras, but points are read from the text.
        let images_file = folder.join("images.txt");
        let invalid = |problem: &str| PrepareError::invalid(&images_file, problem.to_owned());
        let seen = observations(&images_file)?;
        let mut cameras: Vec<Option<(usize, RigCamera)>> = vec![None; num_cameras];
        let mut tracks: BTreeMap<u64, Track> = BTreeMap::new();
        for image in &images {
            let camera = camera_of(&image.name).filter(|&camera| camera < num_cameras);
            let (Some(camera), Some(lens)) = (camera, lenses.get(&image.camera_id)) else {
                return Err(invalid("has an image of no camera of this capture"));
            };
            let seen = seen.get(&image.name).map(Vec::as_slice).unwrap_or_default();
            for &(id, pixel) in seen {
                let track = tracks.entry(id).or_insert_with(|| Track { point: [0.0; 3], seen: Vec::new() });
                track.seen.push((camera, pixel));
            }
            if cameras[camera].as_ref().is_none_or(|(most, _)| *most < seen.len()) {
                let rotation = rotmat_from_quat(image.quat);
                let rows = [0, 1, 2].map(|i| {
                    let [a, b, c] = rotation[i];
                    [a, b, c, image.translation[i]]
                });
                cameras[camera] = Some((seen.len(), RigCamera { lens: (**lens).clone(), camera_from_world: rows }));
            }
        }
        let points = points(&folder.join("points3D.txt"))?;
        for (id, track) in &mut tracks {
            track.point = *points.get(id).ok_or_else(|| invalid("names a point that points3D.txt has not"))?;
        }
        let cameras = cameras.into_iter().map(|camera| camera.map(|(_, camera)| camera)).collect();
        Ok(Self { cameras, tracks: tracks.into_values().collect() })
    }
}

/// Points by their numbers, and their pixels in an image.
type Shown = Vec<(u64, [f64; 2])>;

/// The points that each image shows.
fn observations(path: &Path) -> Result<BTreeMap<String, Shown>, PrepareError> {
    let text = files::long_text(path)?;
    let mut lines = text.lines().filter(|line| !line.starts_with('#'));
    let mut seen = BTreeMap::new();
    while let (Some(image), Some(points)) = (lines.next(), lines.next()) {
        let name = image.split_whitespace().nth(9).unwrap_or_default().to_owned();
        let words: Vec<&str> = points.split_whitespace().collect();
        let point =
            |words: &[&str; 3]| Some((words[2].parse().ok()?, [words[0].parse().ok()?, words[1].parse().ok()?]));
        // Features without a point have the number -1.
        seen.insert(name, words.as_chunks::<3>().0.iter().filter_map(point).collect());
    }
    Ok(seen)
}

fn points(path: &Path) -> Result<BTreeMap<u64, [f64; 3]>, PrepareError> {
    let text = files::long_text(path)?;
    let point = |line: &str| {
        let mut words = line.split_whitespace();
        let id = words.next()?.parse().ok()?;
        let mut number = || words.next()?.parse().ok();
        Some((id, [number()?, number()?, number()?]))
    };
    Ok(text.lines().filter(|line| !line.starts_with('#')).filter_map(point).collect())
}

/// The files of a text model with one image a camera.
///
/// - `names`: of the images, such as `cam01`
pub(super) fn to_text(cameras: &[RigCamera], tracks: &[Track], names: &[&str]) -> Vec<(&'static str, String)> {
    let (mut of_cameras, mut of_images) = (String::new(), String::new());
    let mut of_points = String::from("# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)\n");
    let _ = writeln!(of_cameras, "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]");
    let _ = writeln!(
        of_images,
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then X, Y, POINT3D_ID of each point"
    );
    let mut seen: Vec<Vec<(usize, [f64; 2])>> = vec![Vec::new(); cameras.len()];
    for (id, track) in tracks.iter().enumerate() {
        let [x, y, z] = track.point;
        let errors = super::bundle::errors(cameras, track);
        let error = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        let _ = write!(of_points, "{} {x} {y} {z} 128 128 128 {error}", id + 1);
        for &(camera, pixel) in &track.seen {
            let _ = write!(of_points, " {} {}", camera + 1, seen[camera].len());
            seen[camera].push((id + 1, pixel));
        }
        of_points.push('\n');
    }
    for (i, (camera, name)) in cameras.iter().zip(names).enumerate() {
        let (lens, id) = (&camera.lens, i + 1);
        let ([fx, fy], [cx, cy], [k1, k2, k3, k4, k5, k6]) = (lens.focal, lens.principal, lens.radial);
        let [p1, p2] = lens.tangential;
        let _ = write!(of_cameras, "{id} FULL_OPENCV {} {} {fx} {fy} {cx} {cy} ", lens.width, lens.height);
        let _ = writeln!(of_cameras, "{k1} {k2} {p1} {p2} {k3} {k4} {k5} {k6}");
        let [w, x, y, z] = quat(&camera.camera_from_world);
        let [tx, ty, tz] = camera.camera_from_world.map(|row| row[3]);
        let _ = writeln!(of_images, "{id} {w} {x} {y} {z} {tx} {ty} {tz} {id} {name}.png");
        let shown: Vec<String> = seen[i].iter().map(|(point, [u, v])| format!("{u} {v} {point}")).collect();
        let _ = writeln!(of_images, "{}", shown.join(" "));
    }
    vec![("cameras.txt", of_cameras), ("images.txt", of_images), ("points3D.txt", of_points)]
}

/// Quaternion `w, x, y, z` of a pose, its largest component first (Shepperd 1978).
fn quat(m: &[[f64; 4]; 3]) -> [f64; 4] {
    let squares = [
        1.0 + m[0][0] + m[1][1] + m[2][2],
        1.0 + m[0][0] - m[1][1] - m[2][2],
        1.0 - m[0][0] + m[1][1] - m[2][2],
        1.0 - m[0][0] - m[1][1] + m[2][2],
    ];
    let largest = (0..4).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
    let (s, t) = (squares[largest], 2.0 * squares[largest].sqrt());
    let (x, y, z) = (m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]);
    let (xy, xz, yz) = (m[0][1] + m[1][0], m[0][2] + m[2][0], m[1][2] + m[2][1]);
    let quat = match largest {
        0 => [s, x, y, z],
        1 => [x, s, xy, xz],
        2 => [y, xy, s, yz],
        _ => [z, xz, yz, s],
    };
    quat.map(|value| value / t)
}
