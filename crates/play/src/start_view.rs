//! From where a scene is seen first, if neither its file nor the page says so.
//!
//! A choice of the player alone: nothing that is written to a file depends on it.

use tcgs_core::{Camera, Extent, upright_axes};

/// Horizontal field of view, radians.
const FIELD_OF_VIEW: f64 = 1.1;
/// Width and height of the picture that the camera is made for, pixels. [`Camera::fitted`] adapts it to the window.
const SIZE: [usize; 2] = [640, 360];
/// Distance of the camera from the scene's middle, in radii of its [`Extent`]: a captured scene is mostly its
/// surroundings, and the cameras that captured it stood just within them.
const DISTANCE: f64 = 0.85;
/// Least radius, scene units: a scene of one point too has to be looked at from somewhere.
const MIN_RADIUS: f64 = 1e-3;
/// Height of the camera above the scene's middle, in distances of the camera.
const HEIGHT: f64 = 0.25;

/// The camera with which a player begins, and its pivot: the median of the centres, seen from among the surroundings and
/// a little above.
///
/// - `means`: `[N, 3]`, scene units, finite
/// - `up`: direction in the world that points up, not zero
/// - returns: a camera of 640 x 360 pixels, and the pivot in the world, at which it looks
///
/// ```
/// let (camera, pivot) = tcgs_play::start_view(&[[-1.0, 0.0, 2.0], [0.0, 0.0, 2.0], [1.0, 0.0, 2.0]], [0.0, -1.0, 0.0]);
/// assert_eq!(pivot, [0.0, 0.0, 2.0]);
/// assert!(camera.center()[1] < 0.0, "a little above, where y points down");
/// ```
pub fn start_view(means: &[[f32; 3]], up: [f64; 3]) -> (Camera, [f64; 3]) {
    let Extent { center, radius } = Extent::of(means);
    let distance = DISTANCE * radius.max(MIN_RADIUS);
    let [_, up, forward] = upright_axes(up);
    let position = std::array::from_fn(|i| center[i] + distance * (HEIGHT * up[i] - forward[i]));
    let focal_px = 0.5 * SIZE[0] as f64 / (FIELD_OF_VIEW / 2.0).tan();
    (Camera::look_at(position, center, up, focal_px, SIZE[0], SIZE[1]), center)
}

#[cfg(test)]
mod tests {
    use tcgs_codec::UpAxis;

    use super::*;

    #[test]
    fn the_middle_is_in_the_middle_and_up_is_up() {
        let means: Vec<[f32; 3]> =
            (0..1001_u16).map(|i| [5.0 + (f32::from(i)).sin(), 1.0, 2.0 * f32::from(i).cos()]).collect();
        for up in [UpAxis::Unknown, UpAxis::PlusX, UpAxis::PlusY, UpAxis::PlusZ, UpAxis::MinusX, UpAxis::MinusZ] {
            let direction = up.direction();
            let (camera, center) = start_view(&means, direction);
            let m = &camera.camera_from_world;
            let at = |p: [f64; 3]| [0, 1, 2].map(|i| m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2] + m[i][3]);
            let [x, y, depth] = at(center);
            assert!(x.abs() < 1e-9 && y.abs() < 1e-9 && depth > 1.0, "{up:?}");
            let above = at(std::array::from_fn(|i| center[i] + 0.1 * direction[i]));
            assert!(above[1] < -0.05 && above[0].abs() < 1e-9, "{up:?}: {above:?}");
        }
    }

    #[test]
    fn a_few_far_away_and_a_single_point_do_not_matter() {
        let mut means = vec![[0.0, 0.0, 0.0]; 100];
        means[7] = [1e9, 0.0, 0.0];
        let (camera, _) = start_view(&means, [0.0, -1.0, 0.0]);
        assert!(camera.center().iter().all(|x| x.abs() < 1.0));
        start_view(&[], [0.0, 0.0, 1.0]);
    }
}
