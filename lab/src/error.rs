//! Exit codes of errors; `main` prints the messages.

use tcgs_capture::CaptureError;
use tcgs_pipeline::{Fault, HasFault, PipelineError};
use tcgs_train::TrainError;

/// Wrong usage or input: one line with the culprit, what was found and what was expected.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct WrongInput(String);

/// An error with exit code 2.
pub fn wrong_input(problem: impl Into<String>) -> anyhow::Error {
    WrongInput(problem.into()).into()
}

/// A signal ended a step.
#[derive(Debug, thiserror::Error)]
#[error("stopped; the same command goes on")]
pub struct Stopped;

/// 2 for wrong usage or input, 130 after a signal, 1 for the rest.
pub fn exit_code(error: &anyhow::Error) -> u8 {
    fn fault<E: HasFault + std::error::Error + Send + Sync + 'static>(error: &anyhow::Error) -> Option<Fault> {
        error.downcast_ref::<E>().map(HasFault::fault)
    }
    let fault = error
        .is::<WrongInput>()
        .then_some(Fault::Input)
        .or_else(|| error.is::<Stopped>().then_some(Fault::Stopped))
        .or_else(|| fault::<PipelineError>(error))
        .or_else(|| fault::<CaptureError>(error))
        .or_else(|| fault::<TrainError>(error));
    match fault {
        Some(Fault::Input) => 2,
        Some(Fault::Stopped) => 130,
        _ => 1,
    }
}
