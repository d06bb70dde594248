//! The cameras of a capture with their images, in the player's JSON format (`docs/PLAYER.md`, "Cameras").

use serde_json::{Value, json};
use tcgs_capture::{Capture, Split};
use tcgs_core::{Camera, add_scaled, distance, dot, length, mean_vector, normalize, upper_median, upright_axes};

use crate::pictures::jpeg_uri;
use crate::progress::Progress;

/// Largest width of the images, pixels.
const WIDTH: usize = 320;
/// Depth of a frustum: a share of the median distance to the nearest camera, clamped to `DEPTH_OF_RIG` of the rig's
/// radius.
const DEPTH: f64 = 0.5;
const DEPTH_OF_RIG: [f64; 2] = [0.06, 0.25];
/// Largest number of points from which a camera's median depth is computed.
const NUM_POINTS: usize = 2000;
/// Elevation of the first view above the rig's middle, radians.
const ELEVATION: f64 = 0.45;
/// Distance of the first view from the middle, in radii of the rig.
const FAR: f64 = 2.6;
/// Least length of the mean of unit vectors that counts as a common direction. If the mean viewing direction is
/// shorter, the cameras surround their subject.
const SAME_WAY: f64 = 0.3;

/// Cameras and images of the first frame as JSON.
///
/// - `names`: of all cameras, in the order of [`Split::All`]
pub fn cameras_file(capture: &Capture, names: &[String]) -> anyhow::Result<Vec<u8>> {
    let cameras: Vec<Camera> = capture.cameras(Split::All, 0, 1)?.into_iter().map(|(_, camera)| camera).collect();
    let rig = Rig::of(capture, &cameras)?;
    let mut progress = Progress::new("reading images", cameras.len());
    let mut entries = Vec::new();
    for (i, camera) in cameras.iter().enumerate() {
        progress.step(|| names[i].clone());
        let downscale = camera.width.div_ceil(WIDTH).min(camera.height);
        let mut views = capture.some_views(Split::All, 0, downscale, &[i])?;
        let view = views.swap_remove(0);
        let mut entry = camera_json(&view.camera);
        entry["name"] = names[i].as_str().into();
        entry["image"] = jpeg_uri(&view.image)?.into();
        entries.push(entry);
    }
    Ok(json!({ "depth": rig.depth, "start": camera_json(&rig.overview), "cameras": entries }).to_string().into_bytes())
}

/// A camera in the format of the player's page.
fn camera_json(camera: &Camera) -> Value {
    json!({
        "width": camera.width,
        "height": camera.height,
        "fx": camera.focal[0],
        "fy": camera.focal[1],
        "cx": camera.principal[0],
        "cy": camera.principal[1],
        "cameraFromWorld": camera.camera_from_world.as_flattened(),
    })
}

/// Drawn size of the cameras, and a view of all of them.
struct Rig {
    /// Length of a frustum, scene units.
    depth: f64,
    overview: Camera,
}

impl Rig {
    fn of(capture: &Capture, cameras: &[Camera]) -> anyhow::Result<Self> {
        let centers: Vec<[f64; 3]> = cameras.iter().map(Camera::center).collect();
        let spread = centers.iter().flat_map(|a| centers.iter().map(|b| distance(*a, *b))).fold(0.0, f64::max);
        // Each camera's target is at the median depth of the points it sees.
        let points = if capture.has_points() { capture.point_cloud()?.points } else { Vec::new() };
        let step = points.len().div_ceil(NUM_POINTS).max(1);
        let usual_depth = |camera: &Camera| {
            let seen = points.iter().step_by(step).filter_map(|point| {
                let ([x, y], depth) = camera.project(point.map(f64::from))?;
                let is_inside = (0.0..camera.width as f64).contains(&x) && (0.0..camera.height as f64).contains(&y);
                is_inside.then_some(depth)
            });
            upper_median(seen).unwrap_or(spread.max(1e-3))
        };
        let ahead = |camera: &Camera| add_scaled(camera.center(), usual_depth(camera), camera.forward());
        let [from, to] = [mean_vector(centers.iter().copied()), mean_vector(cameras.iter().map(ahead))];
        let middle = mean_vector([from, to]);
        let radius = centers.iter().chain([&to]).map(|&place| distance(place, middle)).fold(1e-3, f64::max);

        let nearest = |(i, &a): (usize, &[f64; 3])| {
            let others = centers.iter().enumerate().filter(|&(j, _)| j != i);
            others.map(|(_, &b)| distance(a, b)).reduce(f64::min)
        };
        let apart = upper_median(centers.iter().enumerate().filter_map(nearest)).unwrap_or(radius);
        let [least, most] = DEPTH_OF_RIG.map(|share| share * radius);
        Ok(Self { depth: (DEPTH * apart).clamp(least, most), overview: overview(cameras, middle, radius) })
    }
}

/// A camera that sees the whole rig from above: from behind the cameras, or from one side if they stand all around.
fn overview(cameras: &[Camera], middle: [f64; 3], radius: f64) -> Camera {
    let up = mean_vector(cameras.iter().map(|camera| [0, 1, 2].map(|i| -camera.camera_from_world[1][i])));
    let up = if length(up) > SAME_WAY { normalize(up) } else { [0.0, -1.0, 0.0] };
    let forward = mean_vector(cameras.iter().map(Camera::forward));
    let level = add_scaled(forward, -dot(forward, up), up);
    let level = if length(level) > SAME_WAY { normalize(level) } else { upright_axes(up)[2] };
    let back = add_scaled(middle, -FAR * radius * ELEVATION.cos(), level);
    let eye = add_scaled(back, FAR * radius * ELEVATION.sin(), up);
    Camera::look_at(eye, middle, up, 520.0, 640, 400)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_view_shows_every_camera() {
        let up = [0.0, 0.0, 1.0];
        let around: Vec<Camera> = (0..12)
            .map(|i| f64::from(i) * 0.524)
            .map(|turn| Camera::look_at([3.0 * turn.cos(), 3.0 * turn.sin(), 1.0], [0.0; 3], up, 50.0, 64, 48))
            .collect();
        let in_a_row: Vec<Camera> = (0..5)
            .map(|i| Camera::look_at([f64::from(i), 0.0, 1.0], [f64::from(i), 5.0, 1.0], up, 50.0, 64, 48))
            .collect();
        for cameras in [around, in_a_row] {
            let middle = mean_vector(cameras.iter().map(Camera::center));
            let radius = cameras.iter().map(|camera| distance(camera.center(), middle)).fold(0.0, f64::max);
            let view = overview(&cameras, middle, radius);
            for camera in &cameras {
                let ([x, y], depth) = view.project(camera.center()).unwrap();
                assert!(depth > 0.0 && (0.0..640.0).contains(&x) && (0.0..400.0).contains(&y), "{x} {y}");
            }
            let ([_, above], _) = view.project(add_scaled(middle, 0.5, up)).unwrap();
            assert!(above < 200.0, "up is up");
        }
    }
}
