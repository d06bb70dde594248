//! Cameras that a file gives players to start from: application data, as `docs/FORMAT.md` says.

use std::path::Path;

use serde_json::{Value, json};
use tcgs_capture::{Capture, Split};
use tcgs_core::Camera;

use super::judge::spread;
use super::scene::Settings;
use crate::scene::{Model, Scene};

/// Name of the data.
pub const VIEWS: &str = "tcgs.views";

/// Some training cameras of the capture given, or of the run's if it is still there; none without.
pub fn views(scene: &Scene, settings: &Settings) -> anyhow::Result<Option<Vec<u8>>> {
    let capture = match (&settings.capture, &scene.model) {
        _ if settings.views == 0 => None,
        (Some(path), _) => Some(Capture::open(path)?),
        (None, Model::Run(run)) => Capture::open(Path::new(&run.0.config().data.capture)).ok(),
        _ => None,
    };
    let Some(capture) = capture else { return Ok(None) };
    let cameras = match &settings.capture {
        Some(_) => capture.cameras(Split::Train, scene.first_frame, 1)?,
        None => capture.cameras(Split::Train, scene.first_frame, 1).unwrap_or_default(),
    };
    let views: Vec<Value> = spread(cameras.len(), settings.views).map(|i| view(&cameras[i])).collect();
    Ok((!views.is_empty()).then(|| json!({ "views": views }).to_string().into_bytes()))
}

fn view((id, camera): &(usize, Camera)) -> Value {
    json!({
        "name": id.to_string(),
        "width": camera.width,
        "height": camera.height,
        "focal": camera.focal.map(|x| rounded(x, 1e2)),
        "principal": camera.principal.map(|x| rounded(x, 1e2)),
        "position": camera.center().map(|x| rounded(x, 1e4)),
        "rotation": world_from_camera(&camera.camera_from_world).map(|x| rounded(x, 1e5)),
    })
}

/// To a fraction of one: the digits that nobody sees are half of the text.
fn rounded(x: f64, parts: f64) -> f64 {
    (x * parts).round() / parts
}

/// The rotation from camera to world as a unit quaternion `w, x, y, z`.
fn world_from_camera(camera_from_world: &[[f64; 4]; 4]) -> [f64; 4] {
    let r = |i: usize, j: usize| camera_from_world[j][i];
    // Each row is the quaternion times four times one of its components; the longest is the most exact.
    let rows = [
        [1.0 + r(0, 0) + r(1, 1) + r(2, 2), r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1)],
        [r(2, 1) - r(1, 2), 1.0 + r(0, 0) - r(1, 1) - r(2, 2), r(0, 1) + r(1, 0), r(0, 2) + r(2, 0)],
        [r(0, 2) - r(2, 0), r(0, 1) + r(1, 0), 1.0 - r(0, 0) + r(1, 1) - r(2, 2), r(1, 2) + r(2, 1)],
        [r(1, 0) - r(0, 1), r(0, 2) + r(2, 0), r(1, 2) + r(2, 1), 1.0 - r(0, 0) - r(1, 1) + r(2, 2)],
    ];
    let longest = (1..4).fold(0, |best, i| if rows[i][i] > rows[best][best] { i } else { best });
    tcgs_core::normalize(rows[longest])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_are_those_of_the_cameras() {
        for target in [[1.0, 0.0, 0.0], [0.0, 0.1, 1.0], [-1.0, 2.0, -3.0], [0.1, -1.0, -5.0], [-4.0, 0.1, 0.2]] {
            let camera = Camera::look_at([0.0; 3], target, [0.1, -1.0, 0.0], 50.0, 64, 48);
            let matrix = tcgs_core::rotmat_from_quat(world_from_camera(&camera.camera_from_world));
            for (i, row) in matrix.iter().enumerate() {
                for (j, x) in row.iter().enumerate() {
                    assert!((x - camera.camera_from_world[j][i]).abs() < 1e-12, "{target:?}: {matrix:?}");
                }
            }
        }
    }
}
