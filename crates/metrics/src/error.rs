//! How reading weights fails; metrics themselves never fail.

use std::path::PathBuf;

/// A file of weights that cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MetricsError {
    /// The file could not be read.
    #[error("{}: {error}, expected LPIPS weights", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        error: std::io::Error,
    },
    /// The file is not what `scripts/fetch_lpips_weights.py` makes.
    #[error("{}: {problem}, expected LPIPS weights as scripts/fetch_lpips_weights.py makes them", path.display())]
    Weights {
        /// The file.
        path: PathBuf,
        /// What was found.
        problem: String,
    },
    /// This build computes no LPIPS.
    #[error("{}: this build computes no LPIPS, expected one with feature lpips", path.display())]
    NotBuilt {
        /// The file.
        path: PathBuf,
    },
}
