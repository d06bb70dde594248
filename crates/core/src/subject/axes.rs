//! The point where the axes of cameras meet.

use std::array::from_fn;

use super::quantile;
use crate::{Camera, Gaussians, Pinhole, add_scaled, dot, sigmoid, sub};

/// Weight of the guess from depths against the axes of the cameras. Axes that differ by less than 3 degrees leave the
/// depth of their meeting point to the guess.
pub(crate) const PARALLEL: f64 = 0.003;
/// The same weight if the axes alone decide, so that exactly parallel axes still have a solution.
const NO_WEIGHT: f64 = 1e-9;
/// Most cameras and Gaussians used for the guess of depths.
const MAX_CAMERAS: usize = 8;
const MAX_GAUSSIANS: usize = 20_000;

/// The point nearest to all axes of the cameras, in least squares.
///
/// A guess has a small weight: the median depth in the middle of the pictures. The guess decides if axes are parallel.
/// If axes meet behind the cameras, it is the result.
pub(super) fn meeting_point(gaussians: &Gaussians, cameras: &[Camera]) -> [f64; 3] {
    let count = cameras.len() as f64;
    let mean = |of: &dyn Fn(&Camera) -> [f64; 3]| -> [f64; 3] {
        from_fn(|axis| cameras.iter().map(|camera| of(camera)[axis]).sum::<f64>() / count)
    };
    let depth = depth_seen(gaussians, cameras);
    let (center, forward) = (mean(&Camera::center), mean(&Camera::forward));
    let guess = add_scaled(center, depth, forward);
    let drawn = |weight| nearest_to_axes(cameras, weight, guess);
    let meeting = drawn(NO_WEIGHT);
    let is_before = |camera: &&Camera| dot(camera.forward(), sub(meeting, camera.center())) > 0.0;
    if 2 * cameras.iter().filter(is_before).count() >= cameras.len() { drawn(PARALLEL) } else { guess }
}

/// The point nearest to all axes of the cameras, in least squares.
///
/// - `weight`: of the guess, against 1 of all axes together; above 0, because axes may be parallel
pub(crate) fn nearest_to_axes(cameras: &[Camera], weight: f64, guess: [f64; 3]) -> [f64; 3] {
    let count = cameras.len() as f64;
    let mut matrix = [[0.0; 3]; 3];
    let mut right = guess.map(|x| weight * x);
    (0..3).for_each(|i| matrix[i][i] = weight);
    // A camera adds the projection across its axis, `I - d dᵀ`.
    for camera in cameras {
        let (direction, center) = (camera.forward(), camera.center());
        for i in 0..3 {
            for j in 0..3 {
                let across = f64::from(u8::from(i == j)) - direction[i] * direction[j];
                matrix[i][j] += across / count;
                right[i] += across * center[j] / count;
            }
        }
    }
    solved(matrix, right)
}

/// Median depth of the Gaussians in the middle half of the cameras' pictures, scene units; 1 if there are none. The
/// weight of a Gaussian is the area that it covers.
fn depth_seen(gaussians: &Gaussians, cameras: &[Camera]) -> f64 {
    let (stride, of_cameras) =
        (gaussians.num_gaussians().div_ceil(MAX_GAUSSIANS).max(1), cameras.len().div_ceil(MAX_CAMERAS).max(1));
    let mut depths = Vec::new();
    for camera in cameras.iter().step_by(of_cameras) {
        let pinhole = Pinhole::<f64>::new(camera);
        for i in (0..gaussians.num_gaussians()).step_by(stride) {
            let Some(([x, y], depth)) = pinhole.project(gaussians.means()[i].map(f64::from)) else { continue };
            let in_middle = |at: f64, side: usize| (at / side as f64 - 0.5).abs() < 0.25;
            if in_middle(x, camera.width) && in_middle(y, camera.height) {
                let mut scales = gaussians.log_scales()[i].map(|scale| f64::from(scale).exp());
                scales.sort_by(f64::total_cmp);
                let covered = (scales[1] * scales[2] / (depth * depth)).min(1.0);
                depths.push((depth, covered * sigmoid(f64::from(gaussians.logit_opacities()[i]))));
            }
        }
    }
    if depths.is_empty() { 1.0 } else { quantile(depths.into_iter(), 0.5) }
}

/// `x` of `matrix x = right`, by Cramer's rule.
fn solved(matrix: [[f64; 3]; 3], right: [f64; 3]) -> [f64; 3] {
    let determinant = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    from_fn(|column| {
        let replaced = from_fn(|i| from_fn(|j| if j == column { right[i] } else { matrix[i][j] }));
        determinant(replaced) / determinant(matrix)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const UP: [f64; 3] = [0.0, -1.0, 0.0];

    /// A wall at depth 3 across the picture, and as many Gaussians of the same size at depth 90.
    fn wall() -> Gaussians {
        let mut gaussians = Gaussians::zeros(200);
        gaussians.log_scales_mut().fill([-2.0; 3]);
        for (i, mean) in gaussians.means_mut().iter_mut().enumerate() {
            let [x, y] = [i % 10, i / 10 % 10].map(|at| 0.1 * at as f32 - 0.45);
            *mean = if i < 100 { [x, y, 3.0] } else { [30.0 * x, 30.0 * y, 90.0] };
        }
        gaussians
    }

    fn grid(turn: f64) -> Vec<Camera> {
        let at = |i: u8| [f64::from(i % 4) * 0.2 - 0.3, f64::from(i / 4) * 0.2 - 0.2, 0.0];
        let ahead = |[x, y, _]: [f64; 3]| [x + turn * x, y + turn * y, 1.0];
        (0..12).map(|i| Camera::look_at(at(i), ahead(at(i)), UP, 50.0, 64, 48)).collect()
    }

    #[test]
    fn parallel_axes_meet_at_the_depth_of_what_is_seen() {
        // Diverging axes meet behind the cameras; converging axes, in front of them.
        for (turn, depth) in [(0.0, 3.0), (0.02, 3.0), (0.5, 3.0), (-0.5, 2.0), (-1.0, 1.0)] {
            let [x, y, z] = meeting_point(&wall(), &grid(turn));
            assert!(x.abs() < 0.05 && y.abs() < 0.05 && (z - depth).abs() < 0.2 * depth, "{turn}: {x} {y} {z}");
        }
    }

    #[test]
    fn equations_are_solved() {
        let [x, y, z] = solved([[2.0, 1.0, 0.0], [1.0, 3.0, 1.0], [0.0, 1.0, 1.0]], [4.0, 10.0, 5.0]);
        assert!((x - 1.0).abs() < 1e-12 && (y - 2.0).abs() < 1e-12 && (z - 3.0).abs() < 1e-12);
    }
}
