//! What can go wrong while training.

use std::path::PathBuf;

use tcgs_codec::CompressError;
use tcgs_render::gpu::GpuError;

use crate::config::ConfigError;

/// Why training stopped.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// Settings.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A loss or a parameter became NaN or infinite.
    #[error("{term} became {value} at timestep {timestep}, iteration {iteration}; the checkpoints before it are whole")]
    NotFinite {
        /// Which loss or attribute.
        term: &'static str,
        /// Its value.
        value: f64,
        /// Counted from the run's first.
        timestep: usize,
        /// Within the timestep.
        iteration: usize,
    },
    /// Nothing to train on.
    #[error("{what}: found {found}, expected {expected}")]
    Input {
        /// What is wrong.
        what: String,
        /// As it is.
        found: String,
        /// As it should be.
        expected: String,
    },
    /// The GPU.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// Parameters or sensitivities from which no bits can be assigned.
    #[error(transparent)]
    Bits(#[from] CompressError),
    /// A file of a run folder.
    #[error("{path}: {problem}")]
    File {
        /// Which.
        path: PathBuf,
        /// What is wrong with it and what was expected.
        problem: String,
    },
    /// Reading or writing a run folder.
    #[error("{action} {path}: {source}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// On which file.
        path: PathBuf,
        /// How it failed.
        source: std::io::Error,
    },
}
