//! The footage of one camera as stored: a video or a folder of images, and the time of each frame.
//!
//! What lives here: from a file to frames with times ([`Recording`]), and from a moment of the capture to an image that
//! is turned, cropped and evened out ([`Take`]). `program` reads videos by `ffmpeg`, `times` finds frames by time. What
//! does not: the built-in decoder (`video`), lenses, and poses of cameras.

mod child;
mod program;
mod take;
mod times;

use std::path::{Path, PathBuf};

use image::RgbImage;

use crate::names::{Files, Names};
use crate::video::Video;
use crate::{CaptureError, decode, files};

pub use child::end_programs;
pub use program::audio;
pub use take::{ColorChange, Take, turned};
pub use times::Times;

use program::ProgramVideo;

/// Endings of videos in the search of a folder. A file that the user names may have any ending.
pub const VIDEO_ENDINGS: [&str; 10] = ["mp4", "mov", "m4v", "mkv", "webm", "avi", "mpg", "mpeg", "mts", "ts"];

/// A video, or a folder of images.
#[derive(Debug)]
pub struct Recording {
    /// The file, or the folder of images.
    pub path: PathBuf,
    pixels: Source,
    /// Width and height as stored, before any turn.
    pub size: (usize, usize),
    /// Clockwise quarter turns for players, as the file says.
    pub quarter_turns: u8,
    /// Presentation times of the frames.
    pub times: Times,
    /// Frames that are stored before the first of `times`.
    first_frame: usize,
}

#[derive(Debug)]
enum Source {
    Images(Files),
    BuiltIn(Video),
    Program(ProgramVideo),
}

impl Recording {
    /// Whether it is a video rather than a folder of images.
    pub fn is_video(&self) -> bool {
        !matches!(self.pixels, Source::Images(_))
    }

    /// Reads everything but the frames.
    ///
    /// - `path`: a file of any format that `ffmpeg` reads, or a folder of images, one a frame, in the natural order of
    ///   their names
    /// - `images_fps`: frames per second of a folder of images, which has none of its own
    ///
    /// # Errors
    /// [`CaptureError`] if there is no such recording, or neither the built-in decoder nor `ffmpeg` reads it.
    pub fn open(path: &Path, images_fps: f64) -> Result<Self, CaptureError> {
        if path.is_dir() {
            return Self::of_images(path, images_fps);
        }
        if !path.is_file() {
            return Err(CaptureError::invalid(path, "no such file, expected a video or a folder of images"));
        }
        if !is_mp4(path)? {
            let problem = "is no MP4 file, expected H.264 of 8 bits, 4:2:0, in MP4 where ffmpeg is not installed";
            return Self::of_program(path, problem);
        }
        match Video::open_if_known(path)? {
            Ok(video) => Self::of_video(path, video),
            Err(problem) => Self::of_program(path, &problem),
        }
    }

    fn of_images(path: &Path, images_fps: f64) -> Result<Self, CaptureError> {
        let images = files::images(path)?;
        let first = images.first();
        let first =
            first.ok_or_else(|| CaptureError::invalid(path, "has no images, expected a file a frame, .png or .jpg"))?;
        let names: Vec<(usize, String)> = images.iter().map(|image| files::name(image)).enumerate().collect();
        Ok(Self {
            path: path.into(),
            size: decode::size(first)?,
            pixels: Source::Images(Files { folder: path.into(), names: Names::of(&names) }),
            quarter_turns: 0,
            times: Times::at_rate(images.len(), images_fps),
            first_frame: 0,
        })
    }

    fn of_video(path: &Path, video: Video) -> Result<Self, CaptureError> {
        let shown = video.shown();
        let all: Vec<f64> = video.times_secs().iter().map(|secs| secs + shown.shift_secs).collect();
        // Cutting a video without re-encoding keeps frames that only later frames need.
        const ROUNDING_SECS: f64 = 1e-4;
        let first_frame = all.iter().take_while(|&&secs| secs < -ROUNDING_SECS).count();
        let kept = all[first_frame..].iter().take_while(|&&secs| secs < shown.end_secs);
        let times = Times::listed(kept.copied().collect());
        Self::with_frames(path, video.size(), Source::BuiltIn(video), shown.quarter_turns, times, first_frame)
    }

    fn of_program(path: &Path, problem: &str) -> Result<Self, CaptureError> {
        let (video, times) = ProgramVideo::open(path, problem)?;
        let quarter_turns = video.quarter_turns;
        Self::with_frames(path, video.size, Source::Program(video), quarter_turns, times, 0)
    }

    fn with_frames(
        path: &Path,
        size: (usize, usize),
        pixels: Source,
        quarter_turns: u8,
        times: Times,
        first_frame: usize,
    ) -> Result<Self, CaptureError> {
        if times.num_frames() == 0 {
            return Err(CaptureError::invalid(path, "has no frames, expected at least one"));
        }
        Ok(Self { path: path.into(), pixels, size, quarter_turns, times, first_frame })
    }

    /// Name of the frames' codec.
    pub fn codec(&self) -> &str {
        match &self.pixels {
            Source::Images(_) => "images",
            Source::BuiltIn(_) => "h264",
            Source::Program(video) => &video.codec,
        }
    }

    /// Whether the frames are image files, which have no clock.
    pub fn is_images(&self) -> bool {
        matches!(self.pixels, Source::Images(_))
    }

    /// Number of frames, at least 1.
    pub fn num_frames(&self) -> usize {
        self.times.num_frames()
    }

    /// Decodes a frame as stored. In sequential order each frame is decoded once.
    ///
    /// # Errors
    /// [`CaptureError`] if the frame cannot be decoded.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn frame(&self, frame: usize) -> Result<RgbImage, CaptureError> {
        assert!(frame < self.num_frames(), "frame {frame} of {}", self.num_frames());
        match &self.pixels {
            Source::Images(files) => decode::image(&files.path(frame), self.size),
            Source::BuiltIn(video) => video.frame(self.first_frame + frame),
            Source::Program(video) => video.frame(frame, &self.times),
        }
    }
}

/// Whether a file begins like the MP4 family.
fn is_mp4(path: &Path) -> Result<bool, CaptureError> {
    use std::io::Read;
    let failed = |error| CaptureError::Io { path: path.into(), error };
    let mut head = Vec::new();
    tcgs_core::open_file(path).map_err(failed)?.take(8).read_to_end(&mut head).map_err(failed)?;
    Ok(head.get(4..8) == Some(b"ftyp"))
}
