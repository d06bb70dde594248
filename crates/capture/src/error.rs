//! The crate's error: the fault of a capture, or of a request.

use std::{io, path::PathBuf};

use tcgs_interchange::InterchangeError;

/// Why a capture cannot be opened, built or decoded. Every message is one line and begins with the culprit: a file, a
/// folder, a camera or a capture's name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// No known kind of capture recognises the folder.
    #[error("{}: {problem}, expected the folder of a capture with one of {expected}", path.display())]
    NotCapture {
        /// The folder.
        path: PathBuf,
        /// Description of the folder's content.
        problem: String,
        /// The files by which the known kinds are recognised.
        expected: String,
    },
    /// The operating system failed to read a file or folder.
    #[error("{}: reading failed: {error}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The operating system's error.
        error: io::Error,
    },
    /// A file or folder is missing, damaged, or holds values that are out of range or contradict each other.
    #[error("{}: {problem}", path.display())]
    Invalid {
        /// The file or folder.
        path: PathBuf,
        /// Description of the fault: found and expected.
        problem: String,
    },
    /// The capture has no initial points. [`Capture::with_points`](crate::Capture::with_points) takes them from another
    /// file.
    #[error(
        "{}: has no initial points, expected init_pt_cld.npz, points3D.ply or a COLMAP model in it",
        path.display()
    )]
    NoPoints {
        /// The capture's folder.
        path: PathBuf,
    },
    /// A PLY, npz or npy file of points or poses cannot be read.
    #[error(transparent)]
    Points(#[from] InterchangeError),
    /// A closure that makes images or masks failed, or its image or mask is not of the camera's size.
    #[error("camera {camera_id}, frame {frame}: {error}")]
    Made {
        /// Id of the camera.
        camera_id: usize,
        /// The requested frame.
        frame: usize,
        /// The closure's error, or the difference of its result from the camera.
        error: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The input of a [`CaptureBuilder`](crate::CaptureBuilder) is incomplete or inconsistent.
    #[error("capture {name}: {problem}")]
    Built {
        /// The capture's name.
        name: String,
        /// Description of the fault: found and expected.
        problem: String,
    },
    /// The requested frame does not exist.
    #[error("{}: has {num_frames} frames, expected more than {frame} to show frame {frame}", path.display())]
    NoFrame {
        /// The capture's folder or name.
        path: PathBuf,
        /// The requested frame.
        frame: usize,
        /// Number of frames of the capture.
        num_frames: usize,
    },
    /// The requested factor of downscaling is 0, or leaves no pixel of an image.
    #[error(
        "{}: cannot downscale {width}x{height} images by {downscale}, expected 1 to {}",
        path.display(), width.min(height)
    )]
    Downscale {
        /// The capture's folder or name.
        path: PathBuf,
        /// The requested factor.
        downscale: usize,
        /// Width in pixels of the first image that is too small.
        width: usize,
        /// Height in pixels of the first image that is too small.
        height: usize,
    },
}

impl CaptureError {
    pub(crate) fn invalid(path: impl Into<PathBuf>, problem: impl Into<String>) -> Self {
        // Texts of the file, such as a camera's name, may hold line breaks.
        let problem = problem.into().split_whitespace().collect::<Vec<_>>().join(" ");
        Self::Invalid { path: path.into(), problem }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_line_breaks_leaves_a_message_of_one_line() {
        let error = CaptureError::invalid("images.bin", "image a\n\r\n b: its quaternion has the length 0, expected 1");
        assert_eq!(error.to_string(), "images.bin: image a b: its quaternion has the length 0, expected 1");
    }
}
