//! Errors of this crate, and whose fault each is: the input's or the machine's.

use std::io;
use std::path::{Path, PathBuf};

use tcgs_capture::{Calibration, CaptureError, Split};
use tcgs_codec::{CompressError, DecodeError};
use tcgs_interchange::InterchangeError;
use tcgs_metrics::MetricsError;
use tcgs_prepare::PrepareError;
use tcgs_render::device::GpuError;
use tcgs_train::TrainError;

/// Why a call of this crate ended early. Every message is one line that names the culprit; a cause is part of the
/// message and not a source beside it, so that printing the chain of sources prints it once.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PipelineError {
    /// Something that the caller gave is wrong.
    #[error("{culprit}: {found}, expected {expected}")]
    Input {
        /// The file or the argument.
        culprit: String,
        /// What was found.
        found: String,
        /// The correct form.
        expected: String,
    },
    /// A file that the caller named cannot be read.
    #[error("{}: {error}, expected {expected}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        error: io::Error,
        /// The expected kind of file.
        expected: &'static str,
    },
    /// A file cannot be written.
    #[error("writing {}: {error}", path.display())]
    Unwritable {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        error: io::Error,
    },
    /// The place of a new folder is taken.
    #[error("{}: exists already, expected a new name", path.display())]
    Exists {
        /// The place.
        path: PathBuf,
    },
    /// Videos have no calibration, and nothing finds their cameras.
    #[error(
        "{}: has no calibration, expected {}, or the program colmap, which finds cameras from their images",
        path.display(), Calibration::marks()
    )]
    NoCalibration {
        /// The folder of the videos.
        path: PathBuf,
    },
    /// Masks that were asked for are impossible.
    #[error("{name}: {problem}")]
    NoMasks {
        /// Name of the capture.
        name: String,
        /// The reason.
        problem: String,
    },
    /// A `.tcgs` file cannot be decoded.
    #[error("{}: {error}, expected a whole .tcgs file", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// The decoder's error.
        error: DecodeError,
    },
    /// A scene cannot be compressed.
    #[error(transparent)]
    Compress(#[from] CompressError),
    /// A frame was asked for that the scene does not have.
    #[error("{}: has the frames {}..{}, found {}..{}, expected some of these",
        path.display(), has.start, has.end, wanted.start, wanted.end)]
    Frames {
        /// The scene.
        path: PathBuf,
        /// The frames asked for.
        wanted: std::ops::Range<usize>,
        /// The frames there are.
        has: std::ops::Range<usize>,
    },
    /// No quality gives a file as small as wanted.
    #[error("a target of {target} bytes: the smallest file is {smallest} bytes, expected that or more")]
    TargetBytes {
        /// As wanted.
        target: u64,
        /// Length of the smallest file that was tried.
        smallest: u64,
    },
    /// No quality gives a PSNR as high as wanted.
    #[error("a target of {target} dB: the best against {of} is {best:.2} dB, expected that or less")]
    TargetPsnr {
        /// As wanted, dB.
        target: f64,
        /// The highest PSNR that was measured, rounded down to hundredths, dB.
        best: f64,
        /// The images that were compared with, in words.
        of: String,
    },
    /// No setting makes an error as small as wanted.
    #[error("an error of {attribute} of {wanted}: the smallest is {smallest:.3e}, expected that or more")]
    MaxError {
        /// Name of the attribute.
        attribute: String,
        /// As wanted, in the unit of [`tcgs_codec::attribute_error`].
        wanted: f64,
        /// The smallest that was found, rounded up to the digits that are said.
        smallest: f64,
    },
    /// A capture has no cameras of the split that was asked for.
    #[error("{}: has no {} cameras, expected one that has, or another choice of cameras", path.display(), split_name(*split))]
    NoCameras {
        /// The capture.
        path: PathBuf,
        /// Which cameras were asked for.
        split: Split,
    },
    /// A capture.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// Making or checking a capture. [`PrepareError::Capture`] becomes [`PipelineError::Capture`].
    #[error(transparent)]
    Prepare(PrepareError),
    /// Training, or a run folder. [`TrainError::Stopped`] becomes [`PipelineError::Stopped`].
    #[error(transparent)]
    Train(TrainError),
    /// Another program's file.
    #[error(transparent)]
    Interchange(#[from] InterchangeError),
    /// Weights of a metric.
    #[error(transparent)]
    Metrics(#[from] MetricsError),
    /// The observer broke off. Nothing half-written stays.
    #[error("stopped as asked")]
    Stopped,
    /// The GPU.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// This build lacks what was asked for.
    #[error("this build has no {what}, expected one with feature {feature}")]
    NotBuilt {
        /// What it lacks.
        what: &'static str,
        /// The feature of cargo that brings it.
        feature: &'static str,
    },
}

impl PipelineError {
    /// Wrong input.
    ///
    /// - `culprit`: the file or the argument
    pub(crate) fn input(
        culprit: impl std::fmt::Display,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Input { culprit: culprit.to_string(), found: found.into(), expected: expected.into() }
    }

    pub(crate) fn unreadable(path: &Path, error: io::Error, expected: &'static str) -> Self {
        Self::Unreadable { path: path.into(), error, expected }
    }
}

fn split_name(split: Split) -> &'static str {
    match split {
        Split::Train => "training",
        Split::Test => "test",
        Split::All => "usable",
    }
}

impl From<TrainError> for PipelineError {
    fn from(error: TrainError) -> Self {
        if matches!(error, TrainError::Stopped { .. }) { Self::Stopped } else { Self::Train(error) }
    }
}

impl From<PrepareError> for PipelineError {
    fn from(error: PrepareError) -> Self {
        if let PrepareError::Capture(error) = error { Self::Capture(error) } else { Self::Prepare(error) }
    }
}

/// The party at fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// The input or the way it was named: the same call fails on any machine.
    Input,
    /// The machine: no space left, a lost GPU, a parameter that became infinite.
    Machine,
    /// No fault: the observer stopped the call.
    Stopped,
}

/// Errors that know who is at fault.
///
/// ```
/// use std::path::Path;
/// use tcgs_pipeline::{Fault, HasFault, OpenScene, OpenSettings};
/// let error = OpenScene::open(Path::new("/no/such.tcgs"), OpenSettings::default()).err().unwrap();
/// assert_eq!(error.fault(), Fault::Input);
/// ```
pub trait HasFault {
    /// The party at fault.
    fn fault(&self) -> Fault;
}

impl HasFault for PipelineError {
    fn fault(&self) -> Fault {
        match self {
            Self::Input { .. }
            | Self::Frames { .. }
            | Self::NoCameras { .. }
            | Self::Exists { .. }
            | Self::NoCalibration { .. }
            | Self::NoMasks { .. }
            | Self::TargetBytes { .. }
            | Self::TargetPsnr { .. }
            | Self::MaxError { .. }
            | Self::NotBuilt { .. } => Fault::Input,
            Self::Unwritable { .. } => Fault::Machine,
            Self::Stopped => Fault::Stopped,
            Self::Unreadable { error, .. } => error.fault(),
            Self::Decode { error, .. } => error.fault(),
            Self::Compress(error) => error.fault(),
            Self::Capture(error) => error.fault(),
            Self::Prepare(error) => error.fault(),
            Self::Train(error) => error.fault(),
            Self::Interchange(error) => error.fault(),
            Self::Metrics(error) => error.fault(),
            Self::Gpu(error) => error.fault(),
        }
    }
}

/// The fault of an error in reading a named file: the name or the content is wrong.
impl HasFault for io::Error {
    fn fault(&self) -> Fault {
        use io::ErrorKind as Kind;
        match self.kind() {
            Kind::NotFound
            | Kind::PermissionDenied
            | Kind::IsADirectory
            | Kind::NotADirectory
            | Kind::InvalidData
            | Kind::InvalidInput
            | Kind::UnexpectedEof => Fault::Input,
            _ => Fault::Machine,
        }
    }
}

impl HasFault for CaptureError {
    fn fault(&self) -> Fault {
        match self {
            Self::Io { error, .. } => error.fault(),
            Self::Points(error) => error.fault(),
            _ => Fault::Input,
        }
    }
}

impl HasFault for PrepareError {
    fn fault(&self) -> Fault {
        match self {
            Self::Capture(error) => error.fault(),
            Self::Io { error, .. } => error.fault(),
            _ => Fault::Input,
        }
    }
}

impl HasFault for TrainError {
    fn fault(&self) -> Fault {
        match self {
            Self::Read { error, .. } => error.fault(),
            Self::Write { .. } | Self::NotFinite { .. } | Self::Bits(_) | Self::Gpu(_) => Fault::Machine,
            Self::Stopped { .. } => Fault::Stopped,
            _ => Fault::Input,
        }
    }
}

impl HasFault for InterchangeError {
    fn fault(&self) -> Fault {
        match self {
            Self::Write { .. } => Fault::Machine,
            Self::Read { error, .. } => error.fault(),
            _ => Fault::Input,
        }
    }
}

impl HasFault for MetricsError {
    fn fault(&self) -> Fault {
        match self {
            Self::Io { error, .. } => error.fault(),
            _ => Fault::Input,
        }
    }
}

impl HasFault for DecodeError {
    fn fault(&self) -> Fault {
        if matches!(self, Self::Io(_)) { Fault::Machine } else { Fault::Input }
    }
}

impl HasFault for CompressError {
    fn fault(&self) -> Fault {
        if matches!(self, Self::Io(_)) { Fault::Machine } else { Fault::Input }
    }
}

impl HasFault for GpuError {
    fn fault(&self) -> Fault {
        Fault::Machine
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Error, ErrorKind};

    use super::*;

    #[test]
    fn the_type_says_who_is_at_fault() {
        let path = || "x".into();
        let full = || Error::from(ErrorKind::StorageFull);
        let missing = || Error::from(ErrorKind::NotFound);
        let cases: [(PipelineError, Fault); 11] = [
            (PipelineError::input("x", "y", "z"), Fault::Input),
            (PipelineError::unreadable(Path::new("x"), missing(), "z"), Fault::Input),
            (PipelineError::unreadable(Path::new("x"), Error::other("x"), "z"), Fault::Machine),
            (TrainError::Write { path: path(), error: full() }.into(), Fault::Machine),
            (TrainError::Read { path: path(), error: missing() }.into(), Fault::Input),
            (TrainError::File { path: path(), problem: "x".into() }.into(), Fault::Input),
            (CaptureError::Io { path: path(), error: missing() }.into(), Fault::Input),
            (MetricsError::Weights { path: path(), problem: "x".into() }.into(), Fault::Input),
            (MetricsError::Io { path: path(), error: Error::other("x") }.into(), Fault::Machine),
            (InterchangeError::Write { path: path(), error: full() }.into(), Fault::Machine),
            (TrainError::from(GpuError::Lost("x".into())).into(), Fault::Machine),
        ];
        for (error, fault) in cases {
            assert_eq!(error.fault(), fault, "{error}");
        }
    }
}
