//! The resolution at which blending weights are measured.

use tcgs_core::Camera;

/// A camera's image is halved if its shorter side has at least this many pixels.
const MIN_HALVED: usize = 128;

/// Step between the camera's pixels at which weights are sampled, in either direction: 1 or 2.
pub fn weights_step(camera: &Camera) -> usize {
    1 + usize::from(camera.width.min(camera.height) >= MIN_HALVED)
}
