//! What each kind of capture asks of the training settings.

use tcgs_capture::Capture;
use tcgs_train::{Preset, TrainConfig};

/// Learning rate of scales in which Dynamic 3D Gaussians, and the paper after it, were compared on scenes without
/// depth cameras; see `docs/PAPER.md`.
const LOG_SCALE_RATE: f32 = 0.005;

/// Weight of the loss that holds what shows no change, where nothing else says what moves.
const STILLNESS: f32 = 0.5;

/// The settings of a preset, as a capture of this kind needs them: its frames and frame rate, and no losses on what it
/// does not have (a floor, masks). Where no masks say what moves, what shows no change is held (`weights.stillness`).
///
/// - returns: settings whose `data.capture` is still empty
pub fn settings_for(preset: Preset, capture: &Capture) -> TrainConfig {
    let mut config = TrainConfig::preset(preset);
    let (facts, frames) = (capture.facts(), capture.usual_frames());
    config.data.layout = capture.kind().name.into();
    (config.data.first_frame, config.data.end_frame) = (frames.start, frames.end);
    config.data.frame_rate = capture.frame_rate();
    if !facts.has_floor {
        config.weights.floor = 0.0;
    }
    if !facts.labels_motion {
        // Nothing says what moves.
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
