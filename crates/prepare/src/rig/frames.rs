//! The images of a description's cameras, before straightening.

use std::path::Path;

use image::RgbImage;
use rayon::prelude::*;
use tcgs_capture::{CaptureDescription, Take};

use crate::PrepareError;

/// All cameras of a description.
pub(super) struct Frames {
    takes: Vec<Take>,
}

impl Frames {
    /// - `folder`: the folder that the files are relative to
    pub fn open(folder: &Path, description: &CaptureDescription) -> Result<Self, PrepareError> {
        let takes: Vec<_> =
            description.cameras.par_iter().map(|camera| Take::open(folder, description, camera)).collect();
        Ok(Self { takes: takes.into_iter().collect::<Result<_, _>>()? })
    }

    /// One image of every camera.
    pub fn at(&self, frame: usize) -> Result<Vec<RgbImage>, PrepareError> {
        let images: Vec<_> = self.takes.par_iter().map(|take| take.image(frame)).collect();
        Ok(images.into_iter().collect::<Result<_, _>>()?)
    }
}

/// Frames spread over a capture, at most `count`.
pub(super) fn moments(num_frames: usize, count: usize) -> Vec<usize> {
    let mut frames: Vec<usize> = (0..count).map(|i| (2 * i + 1) * num_frames / (2 * count)).collect();
    frames.dedup();
    frames
}
