//! The progress of a step of [`prepare`](super::prepare()), and the check, its last step.

use std::ops::ControlFlow;

use tcgs_capture::Capture;
use tcgs_prepare::{Diagnosis, PrepareError, check};

use crate::error::PipelineError;
use crate::observe::{Event, Observer, Work, tell};

/// Checks a capture, and reports its progress.
///
/// # Errors
/// [`PipelineError`] if images or points cannot be read, or a capture without points is of cameras that points cannot
/// be made of. [`PipelineError::Stopped`] if the observer stops the call.
pub fn examine(capture: &Capture, observer: &mut dyn Observer) -> Result<Diagnosis, PipelineError> {
    /// Usual number of steps.
    const NUM_STEPS: usize = 6;
    reported(observer, Work::Checking, NUM_STEPS, |report| check(capture, report))
}

/// Runs work that tells its steps and cannot be stopped between them.
pub(super) fn reported<T>(
    observer: &mut dyn Observer,
    work: Work,
    num_steps: usize,
    run: impl FnOnce(&mut dyn FnMut(&str)) -> Result<T, PrepareError>,
) -> Result<T, PipelineError> {
    tell(observer, Event::Begun { work, num_steps })?;
    let (mut num_done, mut is_stopped) = (0, false);
    let result = run(&mut |what: &str| {
        num_done += 1;
        is_stopped |= observer.hear(&Event::Step { num_done, what }).is_break();
    });
    if is_stopped { Err(PipelineError::Stopped) } else { Ok(result?) }
}

/// Runs work that tells its steps, and that the observer stops.
///
/// - `num_steps`: usual number of steps; the text up to a comma identifies a step
pub(super) fn stoppable<T>(
    observer: &mut dyn Observer,
    work: Work,
    num_steps: usize,
    run: impl FnOnce(&mut dyn FnMut(&str) -> ControlFlow<()>) -> Result<T, PrepareError>,
) -> Result<T, PipelineError> {
    tell(observer, Event::Begun { work, num_steps })?;
    let (mut step, mut told, mut is_stopped) = (0, String::new(), false);
    let result = run(&mut |what: &str| {
        let head = what.split(',').next().unwrap_or_default();
        if told != head {
            (step, told) = ((step + 1).min(num_steps), head.into());
        }
        let answer = observer.hear(&Event::Step { num_done: step - 1, what });
        is_stopped |= answer.is_break();
        answer
    });
    if is_stopped { Err(PipelineError::Stopped) } else { Ok(result?) }
}
