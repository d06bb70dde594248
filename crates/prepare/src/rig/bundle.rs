//! Bundle adjustment: fits cameras and points to observed tracks, robustly.
//!
//! Levenberg–Marquardt on the Schur complement of the points (Triggs et al. 2000, "Bundle Adjustment — A Modern
//! Synthesis", §6). Observations have the weights of Cauchy's loss. Gaussian priors hold the cameras near their given
//! poses.

use tcgs_core::{distance, dot, upper_median};

use super::camera::{K1, LOG_FOCAL, PARAMETERS, RigCamera};
use super::normal::{Slopes, System, inverse};

/// One point of the scene at one moment, and its observations.
#[derive(Clone, Debug)]
pub(super) struct Track {
    pub point: [f64; 3],
    /// Camera, and pixel of its distorted image.
    pub seen: Vec<(usize, [f64; 2])>,
}

/// Standard deviations of the priors around the given cameras. They matter only where tracks decide nothing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Freedom {
    /// Radians.
    pub turn: f64,
    /// Share of the rig's size.
    pub shift: f64,
    /// Logarithm of the focal length.
    pub log_focal: f64,
    pub k1: f64,
}

/// Scale of Cauchy's loss over the median error. It makes the loss 95 % as efficient as squares for Gaussian errors:
/// 2.385 standard deviations. The median length of a Gaussian error in two dimensions is 1.177 standard deviations.
const CAUCHY_PER_MEDIAN: f64 = 2.385 / 1.177;
/// Lower bound of the error's scale, pixels.
pub(super) const MIN_SCALE_PX: f64 = 0.3;
const MAX_ITERATIONS: usize = 60;
/// A fall of the cost by less than this share ends the search.
const MIN_FALL: f64 = 1e-6;

/// Fits cameras and points to the tracks.
///
/// - `is_free`: whether each camera may move
/// - `min_scale`: errors up to about this many pixels count as squares, even if most are smaller
pub(super) fn bundle(
    cameras: &mut [RigCamera],
    tracks: &mut [Track],
    is_free: &[bool],
    freedom: Freedom,
    min_scale: f64,
) {
    let before = cameras.to_vec();
    let size = rig_size(cameras);
    let mut changes = vec![[0.0; PARAMETERS]; cameras.len()];
    let mut damping = 1e-3;
    let mut scale = robust_scale(cameras, tracks).max(min_scale);
    for _ in 0..MAX_ITERATIONS {
        let weights = prior_weights(freedom, size, scale);
        let cost = cost(cameras, tracks, &changes, &weights, scale);
        let system = System::new(cameras, tracks, &changes, &weights, scale, is_free);
        let mut fell = None;
        for _ in 0..8 {
            let Some((moves, points)) = system.solve(damping) else {
                damping *= 10.0;
                continue;
            };
            let new_cameras: Vec<RigCamera> =
                cameras.iter().zip(&moves).map(|(c, m)| c.moved(m).straightened()).collect();
            let mut new_changes = changes.clone();
            for (change, step) in new_changes.iter_mut().zip(&moves) {
                for (a, b) in change.iter_mut().zip(step) {
                    *a += b;
                }
            }
            let mut new_tracks = tracks.to_vec();
            for (track, step) in new_tracks.iter_mut().zip(&points) {
                for (a, b) in track.point.iter_mut().zip(step) {
                    *a += b;
                }
            }
            let new_cost = self::cost(&new_cameras, &new_tracks, &new_changes, &weights, scale);
            if new_cost < cost {
                cameras.clone_from_slice(&new_cameras);
                tracks.clone_from_slice(&new_tracks);
                changes = new_changes;
                damping = (damping * 0.2).max(1e-9);
                fell = Some((cost - new_cost) / cost);
                break;
            }
            damping *= 10.0;
        }
        let new_scale = robust_scale(cameras, tracks).max(min_scale);
        let is_settled = (new_scale / scale - 1.0).abs() < 1e-3;
        scale = new_scale;
        match fell {
            Some(fall) if fall > MIN_FALL || !is_settled => {}
            _ => break,
        }
    }
    // The tracks determine neither the rig's place nor its direction nor its size (gauge freedom).
    super::similarity::align(cameras, tracks, &before, is_free);
}

/// Size of the rig: the median distance of the cameras from their middle.
pub(super) fn rig_size(cameras: &[RigCamera]) -> f64 {
    let centers: Vec<[f64; 3]> = cameras.iter().map(RigCamera::center).collect();
    let middle: [f64; 3] = std::array::from_fn(|i| centers.iter().map(|c| c[i]).sum::<f64>() / centers.len() as f64);
    upper_median(centers.iter().map(|&center| distance(center, middle))).unwrap_or_default().max(1e-9)
}

/// Reprojection error of one observation, pixels; large where the point is behind the camera.
pub(super) fn residual(camera: &RigCamera, point: [f64; 3], pixel: [f64; 2]) -> [f64; 2] {
    match camera.project(point) {
        Some([u, v]) => [u - pixel[0], v - pixel[1]],
        None => [1e4; 2],
    }
}

/// Reprojection errors of all observations of a track, pixels.
pub(super) fn errors(cameras: &[RigCamera], track: &Track) -> Vec<f64> {
    let error = |&(camera, pixel): &(usize, [f64; 2])| {
        let [du, dv] = residual(&cameras[camera], track.point, pixel);
        du.hypot(dv)
    };
    track.seen.iter().map(error).collect()
}

fn robust_scale(cameras: &[RigCamera], tracks: &[Track]) -> f64 {
    let all = tracks.iter().flat_map(|track| errors(cameras, track));
    CAUCHY_PER_MEDIAN * upper_median(all).unwrap_or_default()
}

fn prior_weights(freedom: Freedom, size: f64, scale: f64) -> [f64; PARAMETERS] {
    let mut deviations = [freedom.turn; PARAMETERS];
    deviations[3..6].fill(freedom.shift * size);
    deviations[LOG_FOCAL] = freedom.log_focal;
    deviations[K1] = freedom.k1;
    // In the unit of the loss, whose standard deviation is the scale over 2.385.
    deviations.map(|deviation| (scale / 2.385 / deviation).powi(2))
}

fn cost(
    cameras: &[RigCamera],
    tracks: &[Track],
    changes: &[[f64; PARAMETERS]],
    weights: &[f64; PARAMETERS],
    scale: f64,
) -> f64 {
    let of_track = |track: &Track| errors(cameras, track).iter().map(|e| (e / scale).powi(2).ln_1p()).sum::<f64>();
    let of_tracks: f64 = tracks.iter().map(of_track).sum();
    let of_priors: f64 = changes.iter().flat_map(|c| c.iter().zip(weights).map(|(x, w)| w * x * x)).sum();
    scale * scale * of_tracks + of_priors
}

/// The point nearest to the rays of all observations, then refined to the least reprojection error; cameras stay fixed.
///
/// - returns: `None` if the rays are parallel or meet behind a camera
pub(super) fn triangulate(cameras: &[RigCamera], seen: &[(usize, [f64; 2])]) -> Option<[f64; 3]> {
    let (mut matrix, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
    for &(camera, pixel) in seen {
        let (center, ray) = (cameras[camera].center(), cameras[camera].ray(pixel));
        for k in 0..3 {
            for l in 0..3 {
                let across = f64::from(u8::from(k == l)) - ray[k] * ray[l];
                matrix[k][l] += across;
                right[k] += across * center[l];
            }
        }
    }
    let mut point = inverse(matrix)?.map(|row| dot(row, right));
    for _ in 0..10 {
        let (mut matrix, mut right) = ([[0.0; 3]; 3], [0.0; 3]);
        for &(camera, pixel) in seen {
            let error = residual(&cameras[camera], point, pixel);
            let slopes = Slopes::new(&cameras[camera], point)?.point;
            let weight = 1.0 / (1.0 + (error[0].powi(2) + error[1].powi(2)) / 4.0);
            for axis in 0..2 {
                for k in 0..3 {
                    for l in 0..3 {
                        matrix[k][l] += weight * slopes[axis][k] * slopes[axis][l];
                    }
                    right[k] -= weight * slopes[axis][k] * error[axis];
                }
            }
        }
        let step = inverse(matrix)?.map(|row| dot(row, right));
        point = std::array::from_fn(|k| point[k] + step[k]);
    }
    point.iter().all(|x| x.is_finite()).then_some(point)
}
