//! Reasons why a scene does not play.

use std::sync::Arc;

use tcgs_codec::DecodeError;
use tcgs_core::{CameraError, CameraPathError};
use tcgs_render::device::GpuError;

use crate::source::SourceError;

/// Why a scene does not play. Programs tell the cases apart by [`PlayError::code`].
#[derive(Clone, Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlayError {
    /// The file is not a `.tcgs` file.
    #[error("this is not a .tcgs file")]
    NotTcgs,
    /// The file ends too early.
    #[error("the file is cut off: {found} bytes, expected {expected}")]
    Truncated {
        /// Length of the file, bytes.
        found: u64,
        /// Least length of the file according to its own tables, bytes.
        expected: u64,
    },
    /// A later version of the programs wrote the file.
    #[error("the file has version {found} of the format, this player knows version {expected}")]
    NewerVersion {
        /// Version of the file.
        found: u16,
        /// The one version that this player knows.
        expected: u16,
    },
    /// The file needs more memory than [`PlayerSettings::limits`](crate::PlayerSettings::limits) allows.
    #[error("the scene is too large to play here: {0}")]
    TooLarge(Arc<DecodeError>),
    /// The bytes of the file contradict its checksums or the format.
    #[error("the file is damaged: {0}")]
    Damaged(Arc<DecodeError>),
    /// The bytes of the file do not arrive.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// There is no fitting GPU, its memory is full, or it stopped working.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The given camera is not valid.
    #[error(transparent)]
    Camera(#[from] BadCamera),
    /// Another scene was opened before this one was ready.
    #[error("another scene was opened")]
    Replaced,
    /// The worker that decodes the scene met an error.
    #[error("{message}")]
    Worker {
        /// Kind of the error.
        code: ErrorCode,
        /// Its text.
        message: String,
    },
}

/// Why a camera is not valid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BadCamera {
    /// An object of the page lacks a number.
    #[error("{field} of the camera is missing, expected a number")]
    Missing {
        /// Name of the property.
        field: &'static str,
    },
    /// An object of the page has a matrix of another size.
    #[error("cameraFromWorld has {0} numbers, expected 16 in rows")]
    Matrix(usize),
    /// The numbers do not describe a pinhole camera.
    #[error(transparent)]
    Numbers(#[from] CameraError),
    /// The camera path has no camera at that timestep.
    #[error(transparent)]
    Path(#[from] CameraPathError),
    /// The file has fewer cameras.
    #[error("there is no camera {index}, the file has {count}")]
    Index {
        /// The camera that was asked for, from 0.
        index: usize,
        /// Number of cameras in the file.
        count: usize,
    },
}

/// The kinds of [`PlayError`] for programs. The words for people are the page's (`web/src/failures.js`).
///
/// ```
/// use tcgs_play::{ErrorCode, PlayError};
/// let error = PlayError::Truncated { found: 10, expected: 20 };
/// assert_eq!(error.code(), ErrorCode::Truncated);
/// assert_eq!(error.code().as_str(), "truncated");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorCode {
    /// The file is not a `.tcgs` file.
    NotTcgs,
    /// The file ends too early.
    Truncated,
    /// A later version of the programs wrote the file.
    NewerVersion,
    /// The file is damaged.
    Damaged,
    /// The bytes of the file do not arrive.
    Network,
    /// There is no GPU that can draw the scene.
    NoGpu,
    /// Memory, of the GPU or of this program, is too small for the scene.
    OutOfMemory,
    /// The GPU stopped working.
    DeviceLost,
    /// The given camera is not valid.
    BadCamera,
    /// Another scene was opened.
    Aborted,
}

impl ErrorCode {
    /// All kinds.
    pub const ALL: [Self; 10] = [
        Self::NotTcgs,
        Self::Truncated,
        Self::NewerVersion,
        Self::Damaged,
        Self::Network,
        Self::NoGpu,
        Self::OutOfMemory,
        Self::DeviceLost,
        Self::BadCamera,
        Self::Aborted,
    ];

    /// The code that a page reads in the property `code` of an error. It does not change with the message.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::NotTcgs => "not-tcgs",
            Self::Truncated => "truncated",
            Self::NewerVersion => "newer-version",
            Self::Damaged => "damaged",
            Self::Network => "network",
            Self::NoGpu => "no-webgpu",
            Self::OutOfMemory => "out-of-memory",
            Self::DeviceLost => "device-lost",
            Self::BadCamera => "bad-camera",
            Self::Aborted => "aborted",
        }
    }
}

impl PlayError {
    /// The kind of the error.
    pub fn code(&self) -> ErrorCode {
        match self {
            Self::NotTcgs => ErrorCode::NotTcgs,
            Self::Truncated { .. } => ErrorCode::Truncated,
            Self::NewerVersion { .. } => ErrorCode::NewerVersion,
            Self::TooLarge(_) => ErrorCode::OutOfMemory,
            Self::Damaged(_) => ErrorCode::Damaged,
            Self::Source(_) => ErrorCode::Network,
            Self::Gpu(GpuError::NotFound { .. } | GpuError::Unfit { .. }) => ErrorCode::NoGpu,
            Self::Gpu(GpuError::Memory { .. }) => ErrorCode::OutOfMemory,
            Self::Gpu(_) => ErrorCode::DeviceLost,
            Self::Camera(_) => ErrorCode::BadCamera,
            Self::Replaced => ErrorCode::Aborted,
            Self::Worker { code, .. } => *code,
        }
    }
}

impl From<DecodeError> for PlayError {
    fn from(error: DecodeError) -> Self {
        match error {
            DecodeError::Version { found, expected } if found > expected => Self::NewerVersion { found, expected },
            DecodeError::Limit { .. } => Self::TooLarge(Arc::new(error)),
            _ => Self::Damaged(Arc::new(error)),
        }
    }
}

impl From<CameraError> for PlayError {
    fn from(error: CameraError) -> Self {
        BadCamera::from(error).into()
    }
}

impl From<CameraPathError> for PlayError {
    fn from(error: CameraPathError) -> Self {
        BadCamera::from(error).into()
    }
}
