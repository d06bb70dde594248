//! Cameras around a scene that brings none.

use std::f64::consts::TAU;

use crate::{Camera, Extent, dot, normalize};

/// Horizontal field of view, radians.
const FIELD_OF_VIEW: f64 = 1.1;
/// Distance of the cameras from the scene's middle, in radii of its [`Extent`]: a captured scene is mostly its
/// surroundings, and the cameras that captured it stood just within them.
const DISTANCE: f64 = 0.85;
/// Least radius, scene units: a scene of one point too has to be looked at from somewhere.
const MIN_RADIUS: f64 = 1e-3;
/// Height of an orbit above the scene's middle, in distances of the cameras.
const ORBIT_HEIGHT: f64 = 0.25;

/// A path of cameras around a scene, all of which look at the middle of its [`Extent`].
///
/// Where a scene brings no cameras, compression measures its bits from an orbit, so another orbit changes the bytes of
/// files.
///
/// ```
/// use tcgs_core::Tour;
/// let means = [[-1.0, 0.0, 2.0], [0.0, 0.0, 2.0], [1.0, 0.0, 2.0]];
/// let cameras = Tour::Orbit.cameras(&means, [0.0, -1.0, 0.0], 4, [64, 36]);
/// assert_eq!(cameras.len(), 4);
/// assert!(cameras[0].forward()[2] > 0.9 && cameras[2].forward()[2] < -0.9, "from two opposite sides");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tour {
    /// One turn at one height.
    Orbit,
    /// Two turns, rising and coming closer.
    Spiral,
}

impl Tour {
    /// Cameras at equal steps along the tour.
    ///
    /// - `means`: `[N, 3]`, scene units, finite
    /// - `up`: direction in the world that points up, not zero
    /// - `count`: number of cameras
    /// - `size`: width and height of their images, pixels
    pub fn cameras(self, means: &[[f32; 3]], up: [f64; 3], count: usize, size: [usize; 2]) -> Vec<Camera> {
        let Extent { center, radius } = Extent::of(means);
        let distance = DISTANCE * radius.max(MIN_RADIUS);
        let [right, up, forward] = upright_axes(up);
        let [width, height] = size;
        let focal_px = 0.5 * width as f64 / (FIELD_OF_VIEW / 2.0).tan();
        (0..count)
            .map(|i| {
                let share = i as f64 / count as f64;
                let (angle, reach, rise) = match self {
                    Self::Orbit => (TAU * share, 1.0, ORBIT_HEIGHT),
                    Self::Spiral => (2.0 * TAU * share, 1.2 - 0.5 * share, 0.6 * share),
                };
                let (across, ahead) = (reach * angle.sin(), -reach * angle.cos());
                let offset = |axis: usize| across * right[axis] + rise * up[axis] + ahead * forward[axis];
                let position = std::array::from_fn(|axis| center[axis] + distance * offset(axis));
                Camera::look_at(position, center, up, focal_px, width, height)
            })
            .collect()
    }
}

/// Right, up and forward in the world for someone who stands upright: unit directions, orthogonal.
///
/// Forward is one of the horizontal directions, which one is a choice: that of z where up is orthogonal to it, as in
/// captures, whose y points down; else that of y.
///
/// - `up`: direction in the world that points up, not zero
///
/// ```
/// assert_eq!(tcgs_core::upright_axes([0.0, -2.0, 0.0]), [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]);
/// ```
pub fn upright_axes(up: [f64; 3]) -> [[f64; 3]; 3] {
    let up = normalize(up);
    let near = if up[2] == 0.0 { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
    let along = dot(near, up);
    let forward: [f64; 3] = normalize(std::array::from_fn(|i| near[i] - along * up[i]));
    let right = std::array::from_fn(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        forward[j] * up[k] - forward[k] * up[j]
    });
    [right, up, forward]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tours_look_at_the_middle_from_around_it() {
        let mut means: Vec<[f32; 3]> =
            (0..1001_u16).map(f32::from).map(|angle| [5.0 + 2.0 * angle.sin(), 1.0, 2.0 * angle.cos()]).collect();
        means[0] = [1e6; 3];
        for tour in [Tour::Orbit, Tour::Spiral] {
            let cameras = tour.cameras(&means, [0.0, -1.0, 0.0], 8, [64, 36]);
            for camera in &cameras {
                let (center, forward) = (camera.center(), camera.forward());
                let to_middle = normalize([5.0 - center[0], 1.0 - center[1], -center[2]]);
                assert!(dot(forward, to_middle) > 0.99, "{camera:?}");
                assert!(center[1] <= 1.0 + 1e-2, "above, where y is less");
            }
            assert_ne!(cameras[0], cameras[4]);
            let upright = tour.cameras(&means, [0.0, 0.0, 1.0], 8, [64, 36]);
            assert!(upright.iter().all(|camera| camera.center()[2] >= -1e-2), "above, where z is more");
        }
    }

    #[test]
    fn axes_are_orthonormal_and_right_handed_for_any_up() {
        for up in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.3, -0.8, 0.1], [0.0, 5.0, 0.001]] {
            let [right, upward, forward] = upright_axes(up);
            for (a, b, expected) in [
                (right, right, 1.0),
                (upward, upward, 1.0),
                (forward, forward, 1.0),
                (right, upward, 0.0),
                (upward, forward, 0.0),
                (forward, right, 0.0),
            ] {
                assert!((dot(a, b) - expected).abs() < 1e-9, "{up:?}");
            }
            assert!((dot(upward, up) - dot(up, up).sqrt()).abs() < 1e-9, "{up:?}");
        }
    }
}
