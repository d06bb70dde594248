//! Videos, where this crate is compiled without them: there is no [`Video`], and opening one is an error that says so.

use std::path::Path;

use image::RgbImage;

use crate::CaptureError;

/// A video of one camera; no value of this type exists.
#[derive(Debug)]
pub(crate) enum Video {}

/// Presentation of the frames by a player.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shown {
    pub quarter_turns: u8,
    pub shift_secs: f64,
    pub end_secs: f64,
}

impl Video {
    /// Refuses every video; an external program may still read it.
    pub fn open_if_known(_path: &Path) -> Result<Result<Self, String>, CaptureError> {
        Ok(Err("is a video, which this program was compiled without (feature `video`)".into()))
    }

    /// Refuses every video: no decoder is built in.
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

    pub fn times_secs(&self) -> &[f64] {
        match *self {}
    }

    pub fn shown(&self) -> Shown {
        match *self {}
    }

    pub fn frame(&self, _frame: usize) -> Result<RgbImage, CaptureError> {
        match *self {}
    }
}
