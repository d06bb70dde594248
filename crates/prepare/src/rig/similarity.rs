//! Moves, turns and scales a whole rig, which changes no picture.

use tcgs_core::{distance, dot, normalize, rotmat_from_quat, sub};

use super::bundle::Track;
use super::camera::RigCamera;

/// `p_new = scale * (rotation * p) + shift`
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Similarity {
    pub scale: f64,
    pub rotation: [[f64; 3]; 3],
    pub shift: [f64; 3],
}

impl Similarity {
    pub fn of_point(&self, point: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| self.scale * dot(self.rotation[i], point) + self.shift[i])
    }

    /// The same camera in the new world.
    pub fn of_camera(&self, camera: &RigCamera) -> RigCamera {
        let center = self.of_point(camera.center());
        let rows = camera.camera_from_world.map(|[a, b, c, _]| self.rotation.map(|row| dot(row, [a, b, c])));
        let pose = rows.map(|row| [row[0], row[1], row[2], -dot(row, center)]);
        RigCamera { camera_from_world: pose, ..camera.clone() }
    }

    pub fn apply(&self, cameras: &mut [RigCamera], tracks: &mut [Track]) {
        for camera in cameras {
            *camera = self.of_camera(camera);
        }
        for track in tracks {
            track.point = self.of_point(track.point);
        }
    }
}

/// Moves and scales a rig onto another one by the cameras that both have: least squares over directions of the axes,
/// then over centres.
///
/// - `counts`: the cameras that are compared
pub(super) fn align(cameras: &mut [RigCamera], tracks: &mut [Track], onto: &[RigCamera], counts: &[bool]) {
    if !counts.iter().all(|&counts| counts) || cameras.len() < 2 {
        return; // cameras that stay fix the rig
    }
    between(cameras, onto).apply(cameras, tracks);
}

/// The similarity that brings one rig onto another.
pub(super) fn between(cameras: &[RigCamera], onto: &[RigCamera]) -> Similarity {
    // Rotation: the sum over cameras of R_ontoᵀ R. Its nearest rotation is that of the largest eigenvector of Horn's
    // matrix (Horn 1987). Centres have a part, too, since axes of telephoto lenses say little about places.
    let mean = |rig: &[RigCamera]| -> [f64; 3] {
        std::array::from_fn(|i| rig.iter().map(|c| c.center()[i]).sum::<f64>() / rig.len() as f64)
    };
    let (middle, onto_middle) = (mean(cameras), mean(onto));
    let spread = |rig: &[RigCamera], middle| -> f64 {
        (rig.iter().map(|c| distance(c.center(), middle).powi(2)).sum::<f64>() / rig.len() as f64).sqrt()
    };
    let (size, onto_size) = (spread(cameras, middle).max(1e-12), spread(onto, onto_middle).max(1e-12));
    let mut sums = [[0.0; 3]; 3];
    for (camera, other) in cameras.iter().zip(onto) {
        let mut pairs: Vec<([f64; 3], [f64; 3])> = (0..3)
            .map(|row| {
                let axis = |c: &RigCamera| std::array::from_fn(|i| c.camera_from_world[row][i]);
                (axis(camera), axis(other))
            })
            .collect();
        let arm =
            |c: &RigCamera, middle: [f64; 3], size: f64| std::array::from_fn(|i| (c.center()[i] - middle[i]) / size);
        pairs.push((arm(camera, middle, size), arm(other, onto_middle, onto_size)));
        for (a, b) in pairs {
            for i in 0..3 {
                for j in 0..3 {
                    sums[i][j] += a[i] * b[j];
                }
            }
        }
    }
    let rotation = rotmat_from_quat(horn(sums));
    let mut along = 0.0;
    for (camera, other) in cameras.iter().zip(onto) {
        let (a, b) = (sub(camera.center(), middle), sub(other.center(), onto_middle));
        along += dot(rotation.map(|row| dot(row, a)), b);
    }
    let scale = (along / (cameras.len() as f64 * size * size)).max(1e-12);
    let shift = std::array::from_fn(|i| onto_middle[i] - scale * dot(rotation[i], middle));
    Similarity { scale, rotation, shift }
}

/// The quaternion of the rotation that brings all `a` nearest to their `b`.
///
/// - `s`: sum of `a bᵀ`
fn horn(s: [[f64; 3]; 3]) -> [f64; 4] {
    let m = [
        [s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]],
        [s[1][2] - s[2][1], s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]],
        [s[2][0] - s[0][2], s[0][1] + s[1][0], s[1][1] - s[0][0] - s[2][2], s[1][2] + s[2][1]],
        [s[0][1] - s[1][0], s[2][0] + s[0][2], s[1][2] + s[2][1], s[2][2] - s[0][0] - s[1][1]],
    ];
    // Power iteration on a matrix that is shifted to be positive; the shift bounds its eigenvalues.
    let bound: f64 = m.as_flattened().iter().map(|x| x.abs()).sum();
    let mut best = [1.0, 0.1, 0.2, 0.3];
    for _ in 0..5000 {
        let next = normalize(std::array::from_fn(|i| bound * best[i] + dot(m[i], best)));
        let change: f64 = (0..4).map(|i| (next[i] - best[i]).abs()).sum();
        best = next;
        if change < 1e-15 {
            break;
        }
    }
    best
}
