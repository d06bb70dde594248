//! Cameras around a scene that brings none: a turn around it, or a spiral.

use std::f64::consts::TAU;

use tcgs_core::{Camera, Gaussians};

use crate::options::Size;

/// Shape of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraPath {
    /// One turn at one height
    Orbit,
    /// Two turns, rising and coming closer
    Spiral,
}

/// Horizontal field of view.
const FIELD_OF_VIEW: f64 = 1.1;
/// Distance of the cameras from the scene's middle, in its radius: a captured scene is mostly its
/// surroundings, and the cameras stood just within them.
const DISTANCE: f64 = 0.85;
/// Share of the Gaussians within the radius: a few far away do not matter.
const WITHIN: f64 = 0.75;
/// Height of the cameras above the middle, in their distance.
const HEIGHT: f64 = 0.25;

impl CameraPath {
    /// Cameras evenly along the path.
    ///
    /// They look at the median of the Gaussians' centres. Up is `−y`, as in the captures' worlds.
    pub fn cameras(self, gaussians: &Gaussians, count: usize, size: Size) -> Vec<Camera> {
        let (center, radius) = extent(gaussians);
        // A scene of one point still has to be looked at from somewhere.
        let radius = DISTANCE * radius.max(1e-3);
        let focal_px = 0.5 * size.width as f64 / (FIELD_OF_VIEW / 2.0).tan();
        (0..count)
            .map(|i| {
                let share = i as f64 / count as f64;
                let (angle, reach, height) = match self {
                    Self::Orbit => (TAU * share, 1.0, HEIGHT),
                    Self::Spiral => (2.0 * TAU * share, 1.2 - 0.5 * share, 0.6 * share),
                };
                let offset = [reach * angle.sin(), -height, -reach * angle.cos()];
                let position = std::array::from_fn(|axis| center[axis] + radius * offset[axis]);
                Camera::look_at(position, center, [0.0, -1.0, 0.0], focal_px, size.width, size.height)
            })
            .collect()
    }
}

/// Middle of a scene, the median of its Gaussians' centres, and its radius, within which most of them lie.
pub fn extent(gaussians: &Gaussians) -> ([f64; 3], f64) {
    let center: [f64; 3] =
        std::array::from_fn(|axis| quantile(gaussians.means.iter().map(|m| f64::from(m[axis])).collect(), 0.5));
    let distance = |m: &[f32; 3]| (0..3).map(|i| (f64::from(m[i]) - center[i]).powi(2)).sum::<f64>().sqrt();
    (center, quantile(gaussians.means.iter().map(distance).collect(), WITHIN))
}

/// The value that a share of the values lies below; 0 of none.
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
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
    fn cameras_look_at_the_middle_from_around_it() {
        let mut gaussians = Gaussians::zeros(1001);
        for (i, mean) in gaussians.means.iter_mut().enumerate() {
            let angle = i as f32;
            *mean = [5.0 + 2.0 * angle.sin(), 1.0, 2.0 * angle.cos()];
        }
        gaussians.means[0] = [1e6; 3];
        for path in [CameraPath::Orbit, CameraPath::Spiral] {
            let cameras = path.cameras(&gaussians, 8, Size { width: 64, height: 36 });
            for camera in &cameras {
                let (center, forward) = (camera.center(), camera.forward());
                let to_middle = tcgs_core::normalize([5.0 - center[0], 1.0 - center[1], -center[2]]);
                assert!(tcgs_core::dot(forward, to_middle) > 0.99, "{camera:?}");
                assert!(center[1] <= 1.0 + 1e-2, "above, where y is less");
            }
            assert_ne!(cameras[0], cameras[4]);
        }
    }
}
