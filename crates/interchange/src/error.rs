//! What can be wrong with another program's file.

use std::{io, path::PathBuf};

/// Why a file could not be read or written. Every message is one line and begins with the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InterchangeError {
    /// The file system refused.
    #[error("{}: {action} failed: {error}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried.
        action: &'static str,
        /// The system's answer.
        error: io::Error,
    },
    /// The file is not a whole zip archive.
    #[error("{}: {problem}, expected a complete npz archive", path.display())]
    Archive {
        /// The file.
        path: PathBuf,
        /// What the archive reader found.
        problem: String,
    },
    /// One array of the archive is missing or not as expected.
    #[error("{}: {key} {problem}", path.display())]
    Array {
        /// The file.
        path: PathBuf,
        /// Name of the array, without `.npy`.
        key: String,
        /// What was found, and what was expected.
        problem: String,
    },
}
