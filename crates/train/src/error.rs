//! What can go wrong while training.

use std::borrow::Cow;
use std::io;
use std::path::PathBuf;

use tcgs_codec::CompressError;
use tcgs_render::device::GpuError;

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
        term: Cow<'static, str>,
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
    #[error("{}: {problem}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// What is wrong with it and what was expected.
        problem: String,
    },
    /// A file of a run folder cannot be read. The cause is part of the message, not a source beside it.
    #[error("reading {}: {error}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        error: io::Error,
    },
    /// A file of a run folder cannot be written. The cause is part of the message, not a source beside it.
    #[error("writing {}: {error}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        error: io::Error,
    },
    /// The observer of [`Trainer::fit`](crate::Trainer::fit) asked to stop.
    #[error(
        "training stopped in timestep {timestep} after iteration {iteration}, as asked; the checkpoints before it are whole"
    )]
    Stopped {
        /// The timestep that stays unfinished, counted from the run's first.
        timestep: usize,
        /// The last iteration whose losses were reported, within the timestep.
        iteration: usize,
    },
}
