//! Cameras around a scene that brings none: a turn around it, or a spiral.

use std::f64::consts::TAU;

use tcgs_codec::UpAxis;
use tcgs_core::{Camera, Gaussians};
use tcgs_play::start_view::{self, FIELD_OF_VIEW, HEIGHT};

use crate::options::Size;

/// Shape of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraPath {
    /// One turn at one height
    Orbit,
    /// Two turns, rising and coming closer
    Spiral,
}

impl CameraPath {
    /// Cameras evenly along the path, which look at the median of the Gaussians' centres.
    ///
    /// - `up`: what points up; in captures' worlds, if it is unknown, where y is less
    pub fn cameras(self, gaussians: &Gaussians, up: UpAxis, count: usize, size: Size) -> Vec<Camera> {
        let (center, radius) = start_view::extent(&gaussians.means);
        let radius = start_view::distance(radius);
        let [right, up, forward] = start_view::axes(up);
        let focal_px = 0.5 * size.width as f64 / (FIELD_OF_VIEW / 2.0).tan();
        (0..count)
            .map(|i| {
                let share = i as f64 / count as f64;
                let (angle, reach, height) = match self {
                    Self::Orbit => (TAU * share, 1.0, HEIGHT),
                    Self::Spiral => (2.0 * TAU * share, 1.2 - 0.5 * share, 0.6 * share),
                };
                let (across, ahead) = (reach * angle.sin(), -reach * angle.cos());
                let offset = |axis: usize| across * right[axis] + height * up[axis] + ahead * forward[axis];
                let position = std::array::from_fn(|axis| center[axis] + radius * offset(axis));
                Camera::look_at(position, center, up, focal_px, size.width, size.height)
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cameras_look_at_the_middle_from_around_it() {
        let mut gaussians = Gaussians::zeros(1001);
        for (i, mean) in gaussians.means.iter_mut().enumerate() {
            let angle = i as f32;
            *mean = [5.0 + 2.0 * angle.sin(), 1.0, 2.0 * angle.cos()];
        }
        gaussians.means[0] = [1e6; 3];
        for path in [CameraPath::Orbit, CameraPath::Spiral] {
            let cameras = path.cameras(&gaussians, UpAxis::Unknown, 8, Size { width: 64, height: 36 });
            for camera in &cameras {
                let (center, forward) = (camera.center(), camera.forward());
                let to_middle = tcgs_core::normalize([5.0 - center[0], 1.0 - center[1], -center[2]]);
                assert!(tcgs_core::dot(forward, to_middle) > 0.99, "{camera:?}");
                assert!(center[1] <= 1.0 + 1e-2, "above, where y is less");
            }
            assert_ne!(cameras[0], cameras[4]);
            let upright = path.cameras(&gaussians, UpAxis::PlusZ, 8, Size { width: 64, height: 36 });
            assert!(upright.iter().all(|camera| camera.center()[2] >= -1e-2), "above, where z is more");
        }
    }
}
