//! The crate's error: what is wrong with another program's file.

use std::{io, path::PathBuf};

/// Why a file could not be read or written. Every message is one line and begins with the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InterchangeError {
    /// The operating system failed to open or read a file or folder.
    #[error("{}: reading failed: {error}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's error.
        error: io::Error,
    },
    /// The operating system failed to write a file.
    #[error("{}: writing failed: {error}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        error: io::Error,
    },
    /// The file is not a complete zip archive.
    #[error("{}: {problem}, expected a complete npz archive", path.display())]
    Archive {
        /// The file.
        path: PathBuf,
        /// The message of the zip reader.
        problem: String,
    },
    /// A file of Gaussians or points is damaged, lacks something or holds a number that is not finite; or the files of a
    /// folder are no sequence.
    #[error("{}: {problem}", path.display())]
    File {
        /// The first file that is wrong, or the folder.
        path: PathBuf,
        /// The content that was found, and the expected one.
        problem: String,
    },
    /// A file claims more than [`ReadLimits`](crate::ReadLimits) allow. Nothing was allocated for the claim.
    #[error("{}: needs {needed} {unit}, limit is {limit}", path.display())]
    Limit {
        /// The file.
        path: PathBuf,
        /// `bytes of memory` or `timesteps`.
        unit: &'static str,
        /// The file's claim.
        needed: u64,
        /// The most for a file of its length.
        limit: u64,
    },
    /// A `.npy` file is damaged, of a type that is not supported, or holds a number that is not finite.
    #[error("{}: {problem}", path.display())]
    Npy {
        /// The file.
        path: PathBuf,
        /// The content that was found, and the expected one.
        problem: String,
    },
    /// One array of an npz archive is missing, damaged, of the wrong type or shape, or holds values out of range.
    #[error("{}: {key} {problem}", path.display())]
    Array {
        /// The file.
        path: PathBuf,
        /// Name of the array, without `.npy`.
        key: String,
        /// The content that was found, and the expected one.
        problem: String,
    },
}
