//! Which Gaussians the training cameras see.
//!
//! The learned masks of a run leave out what the colour loss does not miss. What remains has many Gaussians that are hidden,
//! or smaller than a pixel: each costs as much as any other, and together they matter little enough for refinement to make
//! up for them.

use tcgs_core::{Camera, Image, activate};
use tcgs_render::{CpuRasterizer, blending_weights, weights_step};

use super::kept::Kept;
use crate::PipelineError;

/// Timesteps at which is looked, at most.
const NUM_TIMESTEPS: usize = 30;

/// What the training cameras see of a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Seen {
    /// Its largest share of the pixels of all images of a timestep, 0 to 1.
    pub share: f32,
    /// Last timestep that it has to live to: afterwards its share stays below the least.
    pub last: u16,
}

/// Looks at timesteps spread evenly, of which the first is one.
///
/// - `kept`: of at least one timestep
/// - `cameras`: of the images; at least one
/// - `least`: share below which a Gaussian is not seen
/// - returns: `[N]`
///
/// # Errors
/// [`PipelineError`] if a timestep cannot be read.
pub fn seen(kept: &Kept, cameras: &[Camera], least: f32) -> Result<Vec<Seen>, PipelineError> {
    let cameras: Vec<Camera> = cameras.iter().map(|camera| camera.downscaled(weights_step(camera))).collect();
    let num_pixels: usize = cameras.iter().map(|camera| camera.width * camera.height).sum();
    let num_timesteps = kept.num_timesteps();
    let stride = num_timesteps.div_ceil(NUM_TIMESTEPS);
    let mut seen = vec![Seen::default(); kept.num_gaussians()];
    for timestep in (0..num_timesteps).step_by(stride) {
        let drawn = activate(&kept.at(timestep)?);
        let mut weights = vec![0.0_f32; seen.len()];
        for camera in &cameras {
            let ones = Image::filled(camera.width, camera.height, 1, 1.0);
            let Ok(of_view) = blending_weights(&CpuRasterizer, &drawn, camera, &ones);
            weights.iter_mut().zip(of_view).for_each(|(sum, weight)| *sum += weight);
        }
        // It is not known when between two looks it vanished.
        let last = (timestep + stride).min(num_timesteps) - 1;
        for (seen, weight) in seen.iter_mut().zip(weights) {
            let share = weight / num_pixels as f32;
            seen.share = seen.share.max(share);
            if share >= least {
                seen.last = last as u16;
            }
        }
    }
    Ok(seen)
}
