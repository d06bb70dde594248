//! Errors of making a table.

use std::io;
use std::path::{Path, PathBuf};

use tcgs_capture::CaptureError;
use tcgs_pipeline::{Fault, HasFault, PipelineError};
use tcgs_render::device::GpuError;
use tcgs_train::TrainError;

/// Why a table could not be made. Every message is one line that includes its causes.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReproduceError {
    /// An argument, a capture, or the content of the output folder is wrong: the culprit, the finding and the
    /// expectation.
    #[error("{0}")]
    Input(String),
    /// The folder of captures lacks a folder for some scenes of the table.
    #[error("{}: has no captures named {}, expected a folder for each", data.display(), missing.join(", "))]
    NoCaptures {
        /// The folder of captures.
        data: PathBuf,
        /// The scenes without a folder, in the table's order.
        missing: Vec<String>,
        /// The scenes that have a folder, in the table's order.
        present: Vec<String>,
    },
    /// The output folder has a result that was made by other arguments than the table's.
    #[error("{}: was made by the arguments {found}, expected {expected}", path.display())]
    OtherArguments {
        /// The file of the result.
        path: PathBuf,
        /// The arguments that the result names.
        found: Box<serde_json::Value>,
        /// The arguments by which the table would make it.
        expected: Box<serde_json::Value>,
    },
    /// The file system refused.
    #[error("{action} {}: {error}", path.display())]
    File {
        /// The attempted action.
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's answer.
        error: io::Error,
    },
    /// A step of a run, which is a process of its own, failed.
    #[error("{command}: {problem}")]
    Step {
        /// The step as a person would type it.
        command: String,
        /// The step's end, and advice for going on.
        problem: String,
    },
    /// A file of this crate that defines a table contradicts itself.
    #[error("{0}")]
    Table(String),
    /// A run, a scene or a capture.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
}

impl HasFault for ReproduceError {
    fn fault(&self) -> Fault {
        match self {
            Self::Input(_) | Self::NoCaptures { .. } | Self::OtherArguments { .. } => Fault::Input,
            Self::Pipeline(error) => error.fault(),
            Self::File { .. } | Self::Step { .. } | Self::Table(_) => Fault::Machine,
        }
    }
}

/// Errors of the crates below the pipeline are the pipeline's.
macro_rules! through_the_pipeline {
    ($($error:ty),*) => {$(
        impl From<$error> for ReproduceError {
            fn from(error: $error) -> Self {
                Self::Pipeline(error.into())
            }
        }
    )*};
}
through_the_pipeline!(CaptureError, TrainError, GpuError);

/// For `map_err` of reading and writing files.
pub(crate) fn file<E: Into<io::Error>>(action: &'static str, path: &Path) -> impl FnOnce(E) -> ReproduceError {
    let path = path.to_path_buf();
    move |error| ReproduceError::File { action, path, error: error.into() }
}

pub(crate) fn wrong_input(problem: impl Into<String>) -> ReproduceError {
    ReproduceError::Input(problem.into())
}
