//! From where a scene is seen, if its file does not say.

use tcgs_codec::UpAxis;
use tcgs_core::Camera;

/// Horizontal field of view, radians.
pub const FIELD_OF_VIEW: f64 = 1.1;
/// The picture that it is for.
const SIZE: [usize; 2] = [640, 360];
/// Distance of the camera from the scene's middle, in its radius: a captured scene is mostly its surroundings, and the
/// cameras stood just within them.
const DISTANCE: f64 = 0.85;
/// Share of the Gaussians within the radius: a few far away do not matter.
const WITHIN: f64 = 0.75;
/// Height of the camera above the middle, in its distance.
pub const HEIGHT: f64 = 0.25;

/// A camera that looks at the median of the centres, from among the surroundings and a little above, and that median.
///
/// - `means`: `[N, 3]`, not empty
pub fn start_view(means: &[[f32; 3]], up: UpAxis) -> (Camera, [f64; 3]) {
    let (center, radius) = extent(means);
    let reach = distance(radius);
    let [_, up, forward] = axes(up);
    let position = std::array::from_fn(|i| center[i] + reach * (HEIGHT * up[i] - forward[i]));
    let focal = 0.5 * SIZE[0] as f64 / (FIELD_OF_VIEW / 2.0).tan();
    (Camera::look_at(position, center, up, focal, SIZE[0], SIZE[1]), center)
}

/// Middle of a scene, the median of its Gaussians' centres, and its radius, within which most of them lie.
///
/// - `means`: `[N, 3]`
pub fn extent(means: &[[f32; 3]]) -> ([f64; 3], f64) {
    let center: [f64; 3] = std::array::from_fn(|axis| quantile(means.iter().map(|m| f64::from(m[axis])), 0.5));
    let distance = |m: &[f32; 3]| (0..3).map(|i| (f64::from(m[i]) - center[i]).powi(2)).sum::<f64>().sqrt();
    (center, quantile(means.iter().map(distance), WITHIN))
}

/// Distance from the middle of a scene of some radius to see it from. A scene of one point still has to be looked at
/// from somewhere.
pub fn distance(radius: f64) -> f64 {
    DISTANCE * radius.max(1e-3)
}

/// Right, up and forward in the world for someone upright. Any direction across will do; this one is forward where down
/// is y, as in captures.
pub fn axes(up: UpAxis) -> [[f64; 3]; 3] {
    let up = up_direction(up);
    let forward = if up[2] == 0.0 { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
    let right = std::array::from_fn(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        forward[j] * up[k] - forward[k] * up[j]
    });
    [right, up, forward]
}

/// Where up is in the world: in captures' worlds, if the file does not say, where y is less.
pub fn up_direction(up: UpAxis) -> [f64; 3] {
    match up {
        UpAxis::Unknown | UpAxis::MinusY => [0.0, -1.0, 0.0],
        UpAxis::PlusX => [1.0, 0.0, 0.0],
        UpAxis::PlusY => [0.0, 1.0, 0.0],
        UpAxis::PlusZ => [0.0, 0.0, 1.0],
        UpAxis::MinusX => [-1.0, 0.0, 0.0],
        UpAxis::MinusZ => [0.0, 0.0, -1.0],
    }
}

/// The value that a share of the values lies below; 0 of none.
fn quantile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let index = (share * (values.len() - 1) as f64) as usize;
    *values.select_nth_unstable_by(index, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_middle_is_in_the_middle_and_up_is_up() {
        let means: Vec<[f32; 3]> =
            (0..1001_u16).map(|i| [5.0 + (f32::from(i)).sin(), 1.0, 2.0 * f32::from(i).cos()]).collect();
        for up in [UpAxis::Unknown, UpAxis::PlusX, UpAxis::PlusY, UpAxis::PlusZ, UpAxis::MinusX, UpAxis::MinusZ] {
            let (camera, center) = start_view(&means, up);
            let m = &camera.camera_from_world;
            let at = |p: [f64; 3]| [0, 1, 2].map(|i| m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2] + m[i][3]);
            let [x, y, depth] = at(center);
            assert!(x.abs() < 1e-9 && y.abs() < 1e-9 && depth > 1.0, "{up:?}");
            let direction = up_direction(up);
            let above = at(std::array::from_fn(|i| center[i] + 0.1 * direction[i]));
            assert!(above[1] < -0.05 && above[0].abs() < 1e-9, "{up:?}: {above:?}");
        }
    }

    #[test]
    fn a_few_far_away_and_a_single_point_do_not_matter() {
        let mut means = vec![[0.0, 0.0, 0.0]; 100];
        means[7] = [1e9, 0.0, 0.0];
        let (camera, _) = start_view(&means, UpAxis::Unknown);
        assert!(camera.center().iter().all(|x| x.abs() < 1.0));
        start_view(&[], UpAxis::PlusZ);
    }
}
