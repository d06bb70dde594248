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
    /// A PLY file, or a folder of them, is not as expected.
    #[error("{}: {problem}", path.display())]
    Ply {
        /// The first file that does not fit.
        path: PathBuf,
        /// What was found, and what was expected.
        problem: String,
    },
    /// A PLY file has colours that depend on the direction of view, which were not to be dropped.
    #[error(
        "{}: has spherical harmonics above degree 0 ({num_rest} properties f_rest), expected colours of degree 0 alone",
        path.display()
    )]
    HigherHarmonics {
        /// The file.
        path: PathBuf,
        /// Coefficients above degree 0, of all three channels.
        num_rest: usize,
    },
    /// A file of one array is not as expected.
    #[error("{}: {problem}", path.display())]
    Npy {
        /// The file.
        path: PathBuf,
        /// What was found, and what was expected.
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
