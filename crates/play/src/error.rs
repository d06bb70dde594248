//! Why a scene does not play.

use tcgs_codec::DecodeError;
use tcgs_render::gpu::GpuError;

use crate::source::SourceError;

/// Why a scene does not play, in words for the person who watches.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PlayError {
    /// Some other kind of file.
    #[error("this is not a .tcgs file")]
    NotTcgs,
    /// The file ends before its end.
    #[error("the file is cut off: {found} bytes, expected {expected}")]
    Truncated {
        /// Bytes there are.
        found: u64,
        /// Bytes there should be at least.
        expected: u64,
    },
    /// Made by a later version of the programs.
    #[error("the file has version {found} of the format, this player knows version {expected}")]
    NewerVersion {
        /// The file's.
        found: u16,
        /// The one known.
        expected: u16,
    },
    /// Not what was written.
    #[error("the file is damaged: {0}")]
    Damaged(String),
    /// The bytes cannot be had.
    #[error("{0}")]
    Network(String),
    /// There is no GPU that could draw.
    #[error("{0}")]
    NoGpu(String),
    /// Larger than what memory or limits allow.
    #[error("{0}")]
    OutOfMemory(String),
    /// The GPU stopped working.
    #[error("{0}")]
    DeviceLost(String),
    /// Numbers that are no camera.
    #[error("{0}")]
    BadCamera(String),
}

impl PlayError {
    /// A word for programs, which stays the same whatever the message says.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NotTcgs => "not-tcgs",
            Self::Truncated { .. } => "truncated",
            Self::NewerVersion { .. } => "newer-version",
            Self::Damaged(_) => "damaged",
            Self::Network(_) => "network",
            Self::NoGpu(_) => "no-webgpu",
            Self::OutOfMemory(_) => "out-of-memory",
            Self::DeviceLost(_) => "device-lost",
            Self::BadCamera(_) => "bad-camera",
        }
    }
}

impl From<DecodeError> for PlayError {
    fn from(error: DecodeError) -> Self {
        match error {
            DecodeError::Format { field: "magic", .. } => Self::NotTcgs,
            DecodeError::Version { found, expected } if found > expected => Self::NewerVersion { found, expected },
            DecodeError::Limit { .. } => Self::OutOfMemory(format!("the scene is too large to play here: {error}")),
            other => Self::Damaged(other.to_string()),
        }
    }
}

impl From<SourceError> for PlayError {
    fn from(error: SourceError) -> Self {
        Self::Network(error.to_string())
    }
}

impl From<GpuError> for PlayError {
    fn from(error: GpuError) -> Self {
        let problem = error.to_string();
        match error {
            GpuError::NotFound { .. } | GpuError::Unfit { .. } => Self::NoGpu(problem),
            GpuError::Memory { .. } => Self::OutOfMemory(problem),
            _ => Self::DeviceLost(problem),
        }
    }
}
