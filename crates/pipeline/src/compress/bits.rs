//! Bits of a scene that learned none, from how much its images depend on each parameter.

use std::sync::Arc;

use tcgs_capture::Split;
use tcgs_codec::{BitMap, BitSettings, assign_bits};
use tcgs_core::{Camera, Gaussians, Sensitivity, Tour};

use super::CompressOptions;
use super::kept::Kept;
use crate::{OpenScene, PipelineError};

/// Cameras around a scene without a capture, and the size of their images.
const NUM_CAMERAS: usize = 16;
const IMAGE_SIZE: [usize; 2] = [640, 360];

/// Timesteps at which sensitivities are measured. A Gaussian that is hidden at one, or transparent, may be
/// in full view at another.
const NUM_TIMESTEPS: usize = 4;

/// Bits from sensitivities, and how they were measured.
///
/// - `kept`: the Gaussians that stay, of at least one timestep
///
/// The cameras take turns at the timesteps, so that more timesteps take no longer.
pub fn measured_bits(
    scene: &OpenScene,
    kept: &Kept,
    options: &CompressOptions,
) -> Result<(BitMap, String), PipelineError> {
    let (cameras, of) = cameras(scene, &kept.at(0)?, options)?;
    let last = kept.num_timesteps() - 1;
    let count = NUM_TIMESTEPS.min(last + 1).min(cameras.len().max(1));
    // Every Gaussian as it is at one of the timesteps: for the spread of values over the scene.
    let mut stored = kept.at(0)?;
    let layout = Arc::clone(stored.layout());
    let mut sum = Sensitivity::zeros_of(&layout, kept.num_gaussians());
    for turn in 0..count {
        let gaussians = kept.at(turn * last / (count - 1).max(1))?;
        let of_turn: Vec<Camera> = cameras.iter().skip(turn).step_by(count).cloned().collect();
        let Ok(sensitivity) = tcgs_train::sensitivity(&tcgs_render::CpuRasterizer, &gaussians, &of_turn);
        for attribute in layout.attributes() {
            let (row, rows) = (attribute.components(), sum.values_mut(attribute));
            rows.iter_mut().zip(sensitivity.values(attribute)).for_each(|(sum, s)| *sum += s / count as f32);
            let rows =
                stored.values_mut(attribute).chunks_exact_mut(row).zip(gaussians.values(attribute).chunks_exact(row));
            rows.skip(turn).step_by(count).for_each(|(to, from)| to.copy_from_slice(from));
        }
    }
    let bit_map = assign_bits(&sum, &stored, &bit_settings(scene, options))?;
    Ok((bit_map, format!("bits: by sensitivity, measured with {} {of}", cameras.len())))
}

fn bit_settings(scene: &OpenScene, options: &CompressOptions) -> BitSettings {
    let mut bits = match scene.run() {
        Some(run) => tcgs_train::bit_settings(run.config()),
        None => BitSettings::default(),
    };
    bits.mapping = options.mapping;
    if let Some((min, max)) = options.bits {
        (bits.min_bits, bits.max_bits) = (min, max);
        // A mean outside of the range would give every parameter the same bits.
        if !(f32::from(min)..=f32::from(max)).contains(&bits.mean_bits) {
            bits.mean_bits = (f32::from(min) + f32::from(max)) / 2.0;
        }
    }
    bits
}

fn cameras(
    scene: &OpenScene,
    gaussians: &Gaussians,
    options: &CompressOptions,
) -> Result<(Vec<Camera>, String), PipelineError> {
    let Some(path) = options.capture.as_deref().or(scene.capture()) else {
        let cameras = Tour::Orbit.cameras(gaussians.means(), scene.up().direction(), NUM_CAMERAS, IMAGE_SIZE);
        return Ok((cameras, "cameras around the scene (a capture would give the real ones)".into()));
    };
    let capture = scene.open_capture(path)?;
    let cameras = capture.cameras(Split::Train, scene.first_frame, scene.downscale)?;
    let cameras = cameras.into_iter().map(|(_, camera)| camera).collect();
    Ok((cameras, format!("training cameras of {}", path.display())))
}
