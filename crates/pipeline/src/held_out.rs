//! Cameras that a run leaves out of its training.

use std::borrow::Cow;

use tcgs_capture::{Capture, Split};
use tcgs_train::TrainConfig;

use crate::PipelineError;

/// A capture as a run trains on it: the cameras of `data.hold_out` are its test cameras. If there are none, the capture
/// is unchanged.
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
