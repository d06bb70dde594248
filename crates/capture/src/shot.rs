//! One image of a capture that is still on disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use image::RgbImage;
use rayon::prelude::*;
use tcgs_core::{Camera, Image, View};

use crate::{CaptureError, decode, files, lanczos, lens::Lens, technicolor, video::Video};

/// Camera, image and mask of one frame.
#[derive(Clone, Debug)]
pub(crate) struct Shot {
    pub camera_id: usize,
    /// Of the image as it is given out.
    pub camera: Camera,
    pub source: Source,
    pub change: Change,
    pub mask: Option<PathBuf>,
}

/// Where an image is.
#[derive(Clone, Debug)]
pub(crate) enum Source {
    /// In a file of its own.
    File(PathBuf),
    /// In a file that is known to be cut short; what it lacks is taken from another.
    Cut {
        /// The file.
        file: PathBuf,
        /// The same camera a frame earlier.
        before: PathBuf,
    },
    /// In a video.
    Video {
        /// All frames of its camera.
        video: Arc<Video>,
        /// Which, in the order in which they are shown.
        frame: usize,
    },
}

/// What is done to an image before it is given out.
#[derive(Clone, Debug)]
pub(crate) enum Change {
    /// Nothing.
    Nothing,
    /// Half as wide and high, by Lanczos resampling.
    Halve,
    /// The bends of the lens are taken out.
    Straighten(Arc<Lens>),
}

impl Shot {
    /// A file that is used as it is.
    pub fn of_file(camera_id: usize, camera: Camera, image: PathBuf) -> Self {
        Self { camera_id, camera, source: Source::File(image), change: Change::Nothing, mask: None }
    }

    /// The same, seen through a lens: bends are taken out, if it has any.
    pub fn through(self, lens: Arc<Lens>) -> Self {
        let change = if lens.is_straight() { Change::Nothing } else { Change::Straighten(lens) };
        Self { change, ..self }
    }

    /// The file that holds the image.
    pub fn path(&self) -> &Path {
        match &self.source {
            Source::File(path) | Source::Cut { file: path, .. } => path,
            Source::Video { video, .. } => video.path(),
        }
    }

    /// - `downscale`: the image is averaged over that many pixels squared, the mask by majority
    pub fn view(&self, frame: usize, downscale: usize) -> Result<View, CaptureError> {
        let segmentation = self.mask.as_ref().map(|mask| decode::mask(mask, self.size())).transpose()?;
        let (camera, camera_id) = (self.camera.clone(), self.camera_id);
        let view = View { camera, image: self.image()?, segmentation, frame, camera_id };
        if downscale == 1 {
            return Ok(view);
        }
        Ok(View {
            camera: view.camera.downscaled(downscale),
            image: view.image.downscaled(downscale),
            segmentation: view.segmentation.map(|mask| mask.downscaled(downscale)),
            ..view
        })
    }

    fn size(&self) -> (usize, usize) {
        (self.camera.width, self.camera.height)
    }

    fn image(&self) -> Result<Image, CaptureError> {
        let from_rgb = |rgb: &RgbImage| Image::from_rgb8(rgb.width() as usize, rgb.height() as usize, rgb.as_raw());
        match &self.change {
            Change::Nothing => Ok(from_rgb(&self.pixels(self.size())?)),
            Change::Halve => {
                let (width, height) = self.size();
                Ok(from_rgb(&lanczos::halve(&self.pixels((2 * width, 2 * height))?)))
            }
            Change::Straighten(lens) => Ok(lens.straighten(&self.pixels(lens.size())?)),
        }
    }

    /// - `size`: what the image must have
    fn pixels(&self, size: (usize, usize)) -> Result<RgbImage, CaptureError> {
        match &self.source {
            Source::File(path) => decode::image(path, size),
            Source::Cut { file, before } => technicolor::mend(file, before, size),
            Source::Video { video, frame } => video.frame(*frame),
        }
    }
}

/// Checks that the images of shots exist.
///
/// - `named_by`: the file that says so
pub(crate) fn check_files(shots: &[Shot], named_by: &Path) -> Result<(), CaptureError> {
    match shots.par_iter().find_first(|shot| !shot.path().is_file()) {
        Some(missing) => {
            let problem = format!("no such file, expected it as {} names it", files::name(named_by));
            Err(CaptureError::invalid(missing.path(), problem))
        }
        None => Ok(()),
    }
}
