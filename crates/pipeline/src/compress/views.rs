//! Cameras that a file gives players to start from: application data, as `docs/FORMAT.md` says.

use std::path::Path;

use serde_json::{Value, json};
use tcgs_capture::{Capture, Split};
use tcgs_codec::UpAxis;
use tcgs_core::Camera;

use super::CompressOptions;
use super::judge::spread;
use crate::{OpenScene, PipelineError};

/// Name of the data.
pub const VIEWS: &str = "tcgs.views";

/// The training cameras of the capture given, or of the run's if it is still there; none without.
pub fn cameras(scene: &OpenScene, options: &CompressOptions) -> Result<Vec<(usize, Camera)>, PipelineError> {
    let of = |path: &Path| Capture::open(path)?.cameras(Split::Train, scene.first_frame, 1);
    Ok(match (&options.capture, scene.run()) {
        (Some(path), _) => of(path)?,
        (None, Some(run)) => of(Path::new(&run.config().data.capture)).unwrap_or_default(),
        (None, None) => Vec::new(),
    })
}

/// Some of the cameras as the file says them; none without.
pub fn views(cameras: &[(usize, Camera)], options: &CompressOptions) -> Option<Vec<u8>> {
    let views: Vec<Value> = spread(cameras.len(), options.views).map(|i| view(&cameras[i])).collect();
    (!views.is_empty()).then(|| json!({ "views": views }).to_string().into_bytes())
}

/// The axis along which the cameras stand upright; unknown where none is near.
pub fn up_axis(cameras: &[(usize, Camera)]) -> UpAxis {
    // The rows of a rotation from the world are the camera's axes in it; the second points down.
    let sum = |axis: usize| -> f64 { cameras.iter().map(|(_, camera)| -camera.camera_from_world[1][axis]).sum() };
    let mean = [0, 1, 2].map(|axis| sum(axis) / cameras.len().max(1) as f64);
    let length = mean.iter().map(|x| x * x).sum::<f64>().sqrt();
    let axes = [[UpAxis::PlusX, UpAxis::MinusX], [UpAxis::PlusY, UpAxis::MinusY], [UpAxis::PlusZ, UpAxis::MinusZ]];
    let along = (0..3).find(|&axis| length > MIN_AGREEMENT && mean[axis].abs() > MIN_COSINE * length);
    along.map_or(UpAxis::Unknown, |axis| axes[axis][usize::from(mean[axis] < 0.0)])
}

/// Length of the mean of the cameras' upright directions below which they stand anyhow.
const MIN_AGREEMENT: f64 = 0.4;
/// Of the angle between that mean and an axis: 30 degrees.
const MIN_COSINE: f64 = 0.866;

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
    fn up_is_where_cameras_stand_upright() {
        let ring = |up: [f64; 3], sideways: [f64; 3]| -> Vec<(usize, Camera)> {
            let eyes = [1.0, -1.0].map(|s| [0, 1, 2].map(|i| 3.0 * s * sideways[i] + 1.5 * up[i]));
            eyes.map(|eye| (0, Camera::look_at(eye, [0.0; 3], up, 50.0, 64, 48))).to_vec()
        };
        assert_eq!(up_axis(&ring([0.0, -1.0, 0.0], [0.0, 0.0, 1.0])), UpAxis::MinusY);
        assert_eq!(up_axis(&ring([0.0, 0.0, 1.0], [1.0, 0.0, 0.0])), UpAxis::PlusZ);
        assert_eq!(up_axis(&ring([0.1, 0.0, 1.0], [0.0, 1.0, 0.0])), UpAxis::PlusZ);
        assert_eq!(up_axis(&ring([0.0, 0.7, 0.7], [1.0, 0.0, 0.0])), UpAxis::Unknown);
        assert_eq!(up_axis(&[]), UpAxis::Unknown);
    }

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
