//! The crate's error: why training, or reading and writing a run folder, failed.

use std::borrow::Cow;
use std::io;
use std::path::PathBuf;

use tcgs_codec::CompressError;
use tcgs_render::device::GpuError;

use crate::config::ConfigError;

/// Why training failed or was stopped.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TrainError {
    /// A setting is unknown, of the wrong type or out of range.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A loss or a parameter became NaN or infinite.
    #[error("{term} became {value} at timestep {timestep}, iteration {iteration}; the checkpoints before it are whole")]
    NotFinite {
        /// Name of the loss or attribute.
        term: Cow<'static, str>,
        /// The value that is not finite.
        value: f64,
        /// Index of the timestep, counted from the run's first.
        timestep: usize,
        /// Index of the iteration within the timestep.
        iteration: usize,
    },
    /// Points, cameras or views are missing or of the wrong number, or the timestep before is unfinished.
    #[error("{what}: found {found}, expected {expected}")]
    Input {
        /// The input that is wrong.
        what: String,
        /// What was found.
        found: String,
        /// What was expected.
        expected: String,
    },
    /// The GPU failed: no adapter, out of memory, or a lost device.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// The codec cannot assign bit widths, since a parameter or sensitivity is invalid.
    #[error(transparent)]
    Bits(#[from] CompressError),
    /// A file of a run folder is missing, damaged or of another run.
    #[error("{}: {problem}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The problem, with the finding and the expectation.
        problem: String,
    },
    /// A file of a run folder cannot be read. The cause is part of the message, not a source beside it.
    #[error("reading {}: {error}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        error: io::Error,
    },
    /// A file of a run folder cannot be written. The cause is part of the message, not a source beside it.
    #[error("writing {}: {error}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
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
