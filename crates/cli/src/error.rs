//! Which exit code an error has. Nothing else looks at an error's type; `main` prints it.

use std::io::ErrorKind;

use tcgs_capture::CaptureError;
use tcgs_codec::DecodeError;
use tcgs_interchange::InterchangeError;
use tcgs_metrics::MetricsError;
use tcgs_train::TrainError;

/// Wrong usage or input, as against a computer that fails: one line that names the culprit, what was
/// found and what was expected.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct WrongInput(String);

/// An error for which the exit code is 2.
pub fn wrong_input(message: impl Into<String>) -> anyhow::Error {
    WrongInput(message.into()).into()
}

/// 2 for wrong usage or input, 1 for the rest.
pub fn exit_code(error: &anyhow::Error) -> u8 {
    let wrong = error.is::<WrongInput>()
        || match error.downcast_ref::<CaptureError>() {
            Some(CaptureError::Io { error, .. }) => is_wrong_path(error),
            Some(CaptureError::Points(error)) => is_wrong_archive(error),
            other => other.is_some(),
        }
        || match error.downcast_ref::<TrainError>() {
            Some(TrainError::Io { action, source, .. }) => *action == "reading" && is_wrong_path(source),
            Some(TrainError::NotFinite { .. } | TrainError::Gpu(_)) => false,
            other => other.is_some(),
        }
        || match error.downcast_ref::<MetricsError>() {
            Some(MetricsError::Io { error, .. }) => is_wrong_path(error),
            other => other.is_some(),
        }
        || error.downcast_ref::<InterchangeError>().is_some_and(is_wrong_archive)
        || error.downcast_ref::<DecodeError>().is_some_and(|error| !matches!(error, DecodeError::Io(_)));
    if wrong { 2 } else { 1 }
}

fn is_wrong_archive(error: &InterchangeError) -> bool {
    match error {
        InterchangeError::Io { action, error, .. } => *action != "writing" && is_wrong_path(error),
        _ => true,
    }
}

/// Whether a file could not be read because of how it was named or what it holds.
pub fn is_wrong_path(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::NotFound
            | ErrorKind::PermissionDenied
            | ErrorKind::IsADirectory
            | ErrorKind::NotADirectory
            | ErrorKind::InvalidData
            | ErrorKind::InvalidInput
            | ErrorKind::UnexpectedEof
    )
}

#[cfg(test)]
mod tests {
    use std::io::Error;

    use tcgs_render::gpu::GpuError;

    use super::*;

    #[test]
    fn whose_fault_it_is_decides_the_exit_code() {
        let path = || "x".into();
        let full = || Error::from(ErrorKind::StorageFull);
        let train = |action| TrainError::Io { action, path: path(), source: full() };
        let missing = Error::from(ErrorKind::NotFound);
        let lost = GpuError::Lost("x".into());
        let cases: [(anyhow::Error, u8); 11] = [
            (wrong_input("x"), 2),
            (anyhow::anyhow!("x"), 1),
            (train("writing").into(), 1),
            (TrainError::File { path: path(), problem: "x".into() }.into(), 2),
            (CaptureError::Io { path: path(), error: missing }.into(), 2),
            (MetricsError::Weights { path: path(), problem: "x".into() }.into(), 2),
            (MetricsError::Io { path: path(), error: Error::other("x") }.into(), 1),
            (InterchangeError::Io { path: path(), action: "writing", error: full() }.into(), 1),
            (full().into(), 1),
            (TrainError::from(lost.clone()).into(), 1),
            (lost.into(), 1),
        ];
        for (error, code) in cases {
            assert_eq!(exit_code(&error), code, "{error:#}");
            assert_eq!(exit_code(&error.context("more")), code, "context changes nothing");
        }
    }
}
