//! Cameras on a path around a scene: among the cameras of its capture (`rig`), or around a scene without cameras.

mod rig;

use std::f64::consts::TAU;

use self::rig::Rig;
use crate::subject::{DISTANCE, MIN_RADIUS};
use crate::{Camera, Extent, Subject, add_scaled, cross, dot, normalize, sub};

/// Horizontal field of view without cameras, radians.
const FIELD_OF_VIEW: f64 = 1.1;
/// Height of an orbit above the scene's middle, in distances of the cameras.
const ORBIT_HEIGHT: f64 = 0.25;
/// Distance from the subject at the end of a spiral among cameras, in distances at its beginning.
const NEAREST: f64 = 0.65;

/// A path of cameras around a scene.
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
    /// One turn at one height; among cameras, at their heights.
    Orbit,
    /// Two turns that come closer; without cameras also rising.
    Spiral,
}

impl Tour {
    /// Cameras at equal steps along the tour, all of which look at the middle of the [`Extent`] of all centres.
    ///
    /// Compression measures the bits of a scene without cameras from such an orbit, so another orbit changes the bytes
    /// of files. For pictures use [`Self::among`].
    ///
    /// - `means`: `[N, 3]`, scene units, finite
    /// - `up`: direction in the world that points up, not zero
    /// - `count`: number of cameras
    /// - `size`: width and height of their images, pixels
    pub fn cameras(self, means: &[[f32; 3]], up: [f64; 3], count: usize, size: [usize; 2]) -> Vec<Camera> {
        let Extent { center, radius } = Extent::of(means);
        self.around(center, DISTANCE * radius.max(MIN_RADIUS), up, count, size)
    }

    /// Cameras at equal steps along the tour, on a path that the cameras of a capture enclose.
    ///
    /// - Cameras around the subject, with gaps below 100 degrees: full turns at their heights and distances. The path
    ///   begins at the angle of the first camera.
    /// - Cameras on one side: from the middle of their arc to both ends and back.
    /// - 2 to 7 cameras: the same, but through each camera exactly and looking as the cameras do.
    /// - No cameras: a circle around the subject.
    ///
    /// The path among 8 or more cameras looks at the subject.
    ///
    /// - `cameras`: of the capture; the path begins near the first if it can
    /// - `up`: direction in the world that points up, not zero
    /// - `count`: number of cameras on the path
    /// - `size`: width and height of their images, pixels; they show at least as much as the capture's
    ///
    /// ```
    /// use tcgs_core::{Camera, Gaussians, Subject, Tour};
    /// let up = [0.0, -1.0, 0.0];
    /// let arc = [-1.0, 0.0, 1.0].map(|x| Camera::look_at([x, -0.5, -3.0], [0.0; 3], up, 50.0, 64, 48));
    /// let subject = Subject::of(&Gaussians::zeros(1), &[], &arc);
    /// let path = Tour::Orbit.among(&subject, &arc, up, 16, [64, 48]);
    /// assert!(path.iter().all(|camera| camera.center()[0].abs() < 1.01 && camera.center()[2] < -2.8));
    /// ```
    pub fn among(
        self,
        subject: &Subject,
        cameras: &[Camera],
        up: [f64; 3],
        count: usize,
        size: [usize; 2],
    ) -> Vec<Camera> {
        let Some(rig) = Rig::new(subject, cameras, up, size) else {
            return self.around(subject.center, subject.distance, up, count, size);
        };
        (0..count)
            .map(|i| {
                let share = i as f64 / count as f64;
                match self {
                    Self::Orbit => rig.camera_at(share),
                    Self::Spiral => closer(&rig.camera_at(2.0 * share % 1.0), subject, 1.0 - (1.0 - NEAREST) * share),
                }
            })
            .collect()
    }

    /// Cameras on a circle or a spiral, for a scene without cameras.
    fn around(self, center: [f64; 3], distance: f64, up: [f64; 3], count: usize, size: [usize; 2]) -> Vec<Camera> {
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

/// The camera moved towards the subject, in the same direction.
///
/// - `share`: share of its distance that remains
fn closer(camera: &Camera, subject: &Subject, share: f64) -> Camera {
    let center = camera.center();
    let position = add_scaled(subject.center, share, sub(center, subject.center));
    let [x, y, z, last] = camera.camera_from_world;
    let row = |[a, b, c, _]: [f64; 4]| [a, b, c, -dot([a, b, c], position)];
    Camera { camera_from_world: [row(x), row(y), row(z), last], ..camera.clone() }
}

/// Right, up and forward in the world for someone who stands upright: unit directions, orthogonal.
///
/// Forward is one of the horizontal directions, by convention. It is z if up is orthogonal to z, as in captures, whose
/// y points down; otherwise it is y.
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
    let forward = normalize(add_scaled(near, -along, up));
    [cross(forward, up), up, forward]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::length;

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
            assert!((dot(upward, up) - length(up)).abs() < 1e-9, "{up:?}");
        }
    }
}
