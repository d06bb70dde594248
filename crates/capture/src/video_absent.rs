//! Videos, where this crate is compiled without them: there is no [`Video`], and opening one says so.

use std::path::Path;

use image::RgbImage;

use crate::CaptureError;

/// A video of one camera, of which there are none.
#[derive(Debug)]
pub(crate) enum Video {}

impl Video {
    /// Refuses: nothing here decodes videos.
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        let problem = "is a video, which this program was compiled without (feature `video`), expected a folder of its \
                       frames instead, such as `ffmpeg -i cam00.mp4 cam00/%06d.png` writes";
        Err(CaptureError::invalid(path, problem))
    }

    pub fn size(&self) -> (usize, usize) {
        match *self {}
    }

    pub fn frame_rate(&self) -> f64 {
        match *self {}
    }

    pub fn num_frames(&self) -> usize {
        match *self {}
    }

    pub fn frame(&self, _frame: usize) -> Result<RgbImage, CaptureError> {
        match *self {}
    }
}
