//! Reads multi-view captures: recognises their kind, checks them, and decodes their images and videos.
//!
//! - [`Capture::open`] recognises a folder's kind and reads its cameras; [`Capture::views`] decodes one frame.
//! - [`CaptureBuilder`] makes a capture of cameras and images that a program already has.
//! - [`CaptureDescription`] is `capture.toml`, [`Calibration`] a file of cameras that another program wrote.
//! - [`Recording`] decodes a video or a folder of images, [`Take`] the part of it that a capture uses.
//! - [`write_synthetic`] renders a small capture with known cameras, for tests and examples.
//!
//! The feature `video`, on by default, decodes H.264 videos; the decoder needs a C++ compiler. Without the feature only
//! a described capture has videos, which `ffmpeg` then decodes. Videos of any other capture are an error that names the
//! feature.
//!
//! What lives here: the way from files of images, videos, masks, cameras and points to [`tcgs_core::View`] and
//! [`tcgs_core::PointCloud`]. What does not: making captures from footage (`tcgs_prepare`), and training and evaluation
//! on the views. The split keeps the decoders of images and videos out of the programs that only play scenes.

mod builder;
mod calibration;
mod capture;
mod checked;
mod colmap;
mod contents;
mod decode;
mod description;
mod error;
pub mod files;
mod footage;
mod kind;
mod kinds;
mod lanczos;
mod lens;
mod names;
mod points;
mod points_in_view;
mod prepared;
mod recording;
mod synthetic;
#[cfg(feature = "video")]
mod video;
#[cfg(not(feature = "video"))]
#[path = "video_absent.rs"]
mod video;

pub use builder::{CameraBuilder, CaptureBuilder};
pub use calibration::{CalibratedCamera, Calibration};
pub use capture::{BETWEEN_DEGREES, Capture, MOSTLY_MEASURED, Split};
pub use colmap::{ColmapModel, PosedImage};
pub use description::{
    CalibrationSource, CaptureDescription, ClockSource, ColorSource, DESCRIPTION_FILE, DescribedCamera, Role,
};
pub use error::CaptureError;
pub use kind::{CaptureFacts, CaptureKind};
pub use kinds::MASKS_FOLDER;
pub use lens::{Crop, Lens};
pub use points::{POINTS_FILE, write_points, write_prepared};
pub use prepared::{Origin, Prepared};
pub use recording::{ColorChange, Recording, Take, Times, VIDEO_ENDINGS, audio, end_programs, turned};
pub use synthetic::{Late, SYNTHETIC_FRAME_RATE, SyntheticSettings, ball_at, distance_from_surface, write_synthetic};
