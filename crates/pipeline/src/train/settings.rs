//! Training settings for each kind of capture.

use tcgs_capture::Capture;
use tcgs_train::{Preset, TrainConfig};

/// Learning rate of scales with which Dynamic 3D Gaussians and the paper were compared on scenes without depth cameras;
/// see `docs/PAPER.md`.
const LOG_SCALE_RATE: f32 = 0.005;

/// Weight of the loss on stillness (`weights.stillness`) if the capture does not label motion.
const STILLNESS: f32 = 0.5;

/// The settings of a preset, adapted to a capture: its frames and frame rate. A capture of one frame has a background
/// of its own, unless a preset repeats a publication. Losses without data in the capture (a floor, masks) are off. If no
/// masks label motion, the loss `weights.stillness` holds unchanged content.
///
/// - returns: settings whose `data.capture` is still empty
pub fn settings_for(preset: Preset, capture: &Capture) -> TrainConfig {
    let mut config = TrainConfig::preset(preset);
    let (facts, frames) = (capture.facts(), capture.usual_frames());
    config.data.layout = capture.kind().name.into();
    (config.data.first_frame, config.data.end_frame) = (frames.start, frames.end);
    config.data.frame_rate = capture.frame_rate();
    // Moving things uncover places. On a background like the surroundings these places show smaller errors, and stay as
    // they are.
    config.render.background = frames.len() == 1 && matches!(config.preset, Preset::Default | Preset::Fast);
    if !facts.has_floor {
        config.weights.floor = 0.0;
    }
    if !facts.labels_motion {
        // No labels of motion.
        config.weights.segmentation = 0.0;
        config.weights.background = 0.0;
        if config.gate.enabled {
            config.weights.stillness = STILLNESS;
        }
        if matches!(config.preset, Preset::D3dgs | Preset::Paper) {
            config.rates.log_scale = LOG_SCALE_RATE;
        }
    }
    config
}
