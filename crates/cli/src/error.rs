//! Exit codes and messages of errors; `main` prints the messages.

use tcgs_capture::{Calibration, CaptureError, Split};
use tcgs_codec::{CompressError, DecodeError};
use tcgs_core::{Layout, MAX_SH_DEGREE};
use tcgs_interchange::InterchangeError;
use tcgs_metrics::MetricsError;
use tcgs_pipeline::{Fault, HasFault, PipelineError};
use tcgs_prepare::{PrepareError, RawFootage};
use tcgs_train::TrainError;

use crate::{attribute_errors, interrupt, next};

/// Wrong usage or input, in contrast to a failing computer. The message is one line with the culprit, what was found
/// and what was expected.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct WrongInput(String);

/// An error with exit code 2.
pub fn wrong_input(message: impl Into<String>) -> anyhow::Error {
    WrongInput(message.into()).into()
}

/// Ctrl-C ended a command that can report what is left.
#[derive(Debug, thiserror::Error)]
#[error("stopped: {0}")]
struct Stopped(String);

/// An error with exit code 130.
///
/// - `left`: what is left, and how to continue
pub fn stopped(left: String) -> anyhow::Error {
    Stopped(left).into()
}

/// The message of an error. It names options where the library names arguments.
pub fn message(error: &anyhow::Error) -> String {
    let of_prepare = error.downcast_ref::<PrepareError>().or_else(|| match error.downcast_ref::<PipelineError>() {
        Some(PipelineError::Prepare(error)) => Some(error),
        _ => None,
    });
    let of_capture =
        error.downcast_ref::<CaptureError>().or_else(|| match (error.downcast_ref::<PipelineError>(), of_prepare) {
            (Some(PipelineError::Capture(error)), _) | (_, Some(PrepareError::Capture(error))) => Some(error),
            _ => None,
        });
    if let Some(PrepareError::NoDepth { .. }) = of_prepare {
        return format!("{error:#}; `tcgs prepare --check` looks for the reason");
    }
    match of_capture {
        Some(CaptureError::NoPoints { .. }) => {
            return format!("{error:#}; `tcgs prepare` makes them, and `tcgs train --points FILE` takes others");
        }
        Some(CaptureError::NotCapture { path, .. }) if RawFootage::is_in(path).unwrap_or(false) => {
            let (shown, prepare) = (path.display(), next::prepare(path));
            return format!("{shown}: is a folder of videos or images, expected a capture; `{prepare}` makes one");
        }
        _ => {}
    }
    match error.downcast_ref::<PipelineError>() {
        Some(PipelineError::Compress(error @ CompressError::Unsupported { found, .. })) => {
            let hint =
                if is_harmonics(found) { ", and --drop-sh leaves harmonics of other programs' files out" } else { "" };
            format!("{error}; --format 2 holds it{hint}")
        }
        Some(PipelineError::Exists { .. }) => format!("{error:#} or --force to replace it"),
        Some(PipelineError::NoMasks { .. }) => format!("{error:#}; or --masks no"),
        Some(PipelineError::NoCalibration { path }) => format!(
            "{}: has no calibration, expected {}; or --calibration FILE; or the program colmap, which finds cameras from \
             their images (apt install colmap)",
            path.display(),
            Calibration::marks()
        ),
        Some(PipelineError::Frames { path, wanted, has }) => format!(
            "--frames {}..{}: {} has the frames {}..{}, expected some of these",
            wanted.start,
            wanted.end,
            path.display(),
            has.start,
            has.end
        ),
        Some(PipelineError::TargetBytes { target, smallest }) => {
            format!("--target-bytes {target}: the smallest file is {smallest} bytes, expected that or more")
        }
        Some(PipelineError::TargetPsnr { target, best, of }) => {
            format!("--target-psnr {target}: the best against {of} is {best:.2} dB, expected that or less")
        }
        Some(PipelineError::MaxError { attribute, wanted, smallest }) => {
            let word = attribute_errors::word(attribute);
            format!(
                "--max-error {word}={wanted}: the smallest error that is found is {smallest:.3e}, expected that or more"
            )
        }
        Some(PipelineError::Interchange(InterchangeError::Limit { .. })) => format!("{error:#}; --no-limits lifts it"),
        Some(PipelineError::NoCameras { path, split: Split::Test }) => {
            format!("{}: has no test cameras, expected one that has, or --cameras train", path.display())
        }
        _ => format!("{error:#}"),
    }
}

/// Whether a column holds spherical harmonics.
fn is_harmonics(column: &str) -> bool {
    let layout = Layout::with_harmonics(MAX_SH_DEGREE);
    layout.find(column).is_some_and(|attribute| layout.harmonics().contains(&attribute))
}

/// 2 for wrong usage or input, 130 after Ctrl-C, 1 for the rest.
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
        .or_else(|| fault::<PrepareError>(error))
        .or_else(|| fault::<TrainError>(error))
        .or_else(|| fault::<MetricsError>(error))
        .or_else(|| fault::<InterchangeError>(error))
        .or_else(|| fault::<CompressError>(error))
        .or_else(|| fault::<DecodeError>(error));
    match fault {
        Some(Fault::Input) => 2,
        Some(Fault::Stopped) => interrupt::EXIT_CODE,
        _ => 1,
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Error, ErrorKind};

    use tcgs_render::device::GpuError;

    use super::*;

    #[test]
    fn what_the_command_line_offers_is_added_to_what_a_library_says() {
        let no_points = || CaptureError::NoPoints { path: "x".into() };
        let prepare = PrepareError::from(no_points());
        for error in [no_points().into(), PipelineError::Capture(no_points()).into(), anyhow::Error::from(prepare)] {
            let message = message(&error);
            assert!(message.starts_with("x: has no initial points") && message.contains("--points FILE"), "{message}");
        }
        let message = |error: anyhow::Error| message(&error);
        let no_depth = message(PrepareError::NoDepth { path: "x".into() }.into());
        assert!(no_depth.ends_with("`tcgs prepare --check` looks for the reason"), "{no_depth}");
    }

    #[test]
    fn whose_fault_it_is_decides_the_exit_code() {
        let path = || "x".into();
        let full = || Error::from(ErrorKind::StorageFull);
        let train = TrainError::Write { path: path(), error: full() };
        let missing = Error::from(ErrorKind::NotFound);
        let lost = GpuError::Lost("x".into());
        let cases: [(anyhow::Error, u8); 13] = [
            (wrong_input("x"), 2),
            (anyhow::anyhow!("x"), 1),
            (train.into(), 1),
            (PipelineError::Stopped.into(), 130),
            (stopped("x".into()), 130),
            (TrainError::File { path: path(), problem: "x".into() }.into(), 2),
            (CaptureError::Io { path: path(), error: missing }.into(), 2),
            (MetricsError::Weights { path: path(), problem: "x".into() }.into(), 2),
            (MetricsError::Io { path: path(), error: Error::other("x") }.into(), 1),
            (InterchangeError::Write { path: path(), error: full() }.into(), 1),
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
