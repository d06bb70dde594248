//! The crate's error: the fault of footage, of a capture, or of a program that this crate runs.

use std::{io, path::PathBuf};

use tcgs_capture::CaptureError;

/// Why footage cannot become a capture, or a capture cannot get points or masks. Every message is one line and begins
/// with the culprit, except that of [`Self::Program`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PrepareError {
    /// A capture, a recording or a calibration cannot be read.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// The operating system failed to read or write a file or folder.
    #[error("{}: reading failed: {error}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's error.
        error: io::Error,
    },
    /// A file or folder is missing, or holds what is out of range or contradicts another.
    #[error("{}: {problem}", path.display())]
    Invalid {
        /// The file or folder.
        path: PathBuf,
        /// Description of the fault: found and expected.
        problem: String,
    },
    /// [`stereo_points`](crate::stereo_points) found no depth on which views agree. [`check`](crate::check) looks for
    /// the reason.
    #[error("{}: no views agree on any depth, expected cameras that fit the images", path.display())]
    NoDepth {
        /// The capture's folder.
        path: PathBuf,
    },
    /// [`stereo_points`](crate::stereo_points) compares cameras, and these stand too far apart, or all in one place.
    /// [`spread_points`](crate::spread_points) makes points all the same.
    #[error(
        "{}: has no training camera with two others within {degrees} degrees of its direction and away from its place, \
         expected cameras closer together, or points from elsewhere",
        path.display()
    )]
    FarApart {
        /// The capture's folder.
        path: PathBuf,
        /// How far two cameras that are compared may differ in direction, degrees.
        degrees: usize,
    },
    /// A program that finds cameras could not be run, or failed, or was stopped.
    #[error("{problem}")]
    Program {
        /// Description of the failure, and of what was expected.
        problem: String,
    },
}

impl PrepareError {
    pub(crate) fn invalid(path: impl Into<PathBuf>, problem: impl Into<String>) -> Self {
        // Texts of a file, such as a camera's name, may hold line breaks.
        let problem = problem.into().split_whitespace().collect::<Vec<_>>().join(" ");
        Self::Invalid { path: path.into(), problem }
    }
}
