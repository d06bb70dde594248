//! What each kind of capture asks of the training settings.

use std::borrow::Cow;

use tcgs_capture::{Capture, Split};
use tcgs_train::{Preset, TrainConfig};

use crate::PipelineError;

/// Learning rate of scales in which Dynamic 3D Gaussians, and the paper after it, were compared on scenes without
/// depth cameras; see `docs/PAPER.md`.
const LOG_SCALE_RATE: f32 = 0.005;

/// Weight of the loss that holds what shows no change, where nothing else says what moves.
const STILLNESS: f32 = 0.5;

/// A capture as a run trains on it: the cameras of `data.hold_out` are its test cameras. Without any it stays as it is.
///
/// # Errors
/// [`PipelineError::Capture`] if it has no such camera; [`PipelineError::Input`] if it has no other.
pub fn capture_for<'a>(config: &TrainConfig, capture: &'a Capture) -> Result<Cow<'a, Capture>, PipelineError> {
    let names = &config.data.hold_out;
    if names.is_empty() {
        return Ok(Cow::Borrowed(capture));
    }
    let chosen = capture.with_test_cameras(names)?;
    if chosen.cameras(Split::Train, config.data.first_frame, 1)?.is_empty() {
        let found = format!("all cameras are held out: {}", names.join(", "));
        return Err(PipelineError::input(capture.name(), found, "at least one to train with"));
    }
    Ok(Cow::Owned(chosen))
}

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
