//! What can be wrong with a capture.

use std::{io, path::PathBuf};

use tcgs_interchange::InterchangeError;

/// Why a capture cannot be used. Every message is one line and begins with the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// The folder is of no kind that is known.
    #[error("{}: {problem}, expected the folder of a capture with one of {expected}", path.display())]
    NotCapture {
        /// The folder.
        path: PathBuf,
        /// What was found.
        problem: String,
        /// What folders of the known kinds have.
        expected: String,
    },
    /// The file system refused.
    #[error("{}: reading failed: {error}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        error: io::Error,
    },
    /// A file says what cannot be.
    #[error("{}: {problem}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What was found, and what was expected.
        problem: String,
    },
    /// There are no points to start from.
    #[error(
        "{}: has no initial points, expected init_pt_cld.npz, points3D.ply or a COLMAP model in it; `tcgs prepare` \
         makes them, and `tcgs train --points FILE` takes others",
        path.display()
    )]
    NoPoints {
        /// The capture.
        path: PathBuf,
    },
    /// Points or poses cannot be read.
    #[error(transparent)]
    Points(#[from] InterchangeError),
    /// A closure that makes images or masks failed, or made something that does not fit its camera.
    #[error("camera {camera_id}, frame {frame}: {error}")]
    Made {
        /// The camera.
        camera_id: usize,
        /// The frame asked for.
        frame: usize,
        /// Why there is none.
        error: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A capture that a program puts together does not fit together.
    #[error("capture {name}: {problem}")]
    Built {
        /// The capture.
        name: String,
        /// What was found, and what was expected.
        problem: String,
    },
    /// A frame was asked for that the capture does not have.
    #[error("{}: has {num_frames} frames, expected more than {frame} to show frame {frame}", path.display())]
    NoFrame {
        /// The capture.
        path: PathBuf,
        /// The frame asked for.
        frame: usize,
        /// Frames there are.
        num_frames: usize,
    },
    /// Images cannot be made that small.
    #[error(
        "{}: cannot downscale {width}x{height} images by {downscale}, expected 1 to {}",
        path.display(), width.min(height)
    )]
    Downscale {
        /// The capture.
        path: PathBuf,
        /// The factor asked for.
        downscale: usize,
        /// Width of the smallest image.
        width: usize,
        /// Height of the smallest image.
        height: usize,
    },
}

impl CaptureError {
    pub(crate) fn invalid(path: impl Into<PathBuf>, problem: impl Into<String>) -> Self {
        Self::Invalid { path: path.into(), problem: problem.into() }
    }
}
