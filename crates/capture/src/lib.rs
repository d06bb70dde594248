//! Multi-view captures: opens, checks, prepares and synthesises them.
//!
//! - [`Capture::open`] recognises a folder's kind and reads its cameras; [`Capture::views`] decodes one frame.
//! - [`CaptureBuilder`] makes a capture of cameras and images that a program already has.
//! - [`RawFootage`], [`Calibration`] and [`Clocks`] turn a folder of videos into a [`CaptureDescription`], which
//!   [`Capture::open`] opens.
//! - [`find_cameras`] has COLMAP place the cameras of a description, [`refine_cameras`] mends a calibration,
//!   [`balance_colors`] measures how the cameras differ in exposure and white balance.
//! - [`prepare`] makes initial points by multi-view stereo, for a capture that has none.
//! - [`check`] looks for wrong cameras, masks and clocks.
//! - [`write_synthetic`] renders a small capture with known cameras, for tests and examples.
//!
//! The feature `video`, on by default, decodes H.264 videos; the decoder needs a C++ compiler. Without the feature only
//! a described capture has videos, which `ffmpeg` then decodes. Videos of any other capture are an error that names the
//! feature.
//!
//! What lives here: the way from files of images, videos, masks, cameras and points to [`tcgs_core::View`] and
//! [`tcgs_core::PointCloud`]. What does not: training and evaluation on the views. The split keeps the decoders of
//! images and videos out of the programs that only play scenes.

mod builder;
mod calibration;
mod capture;
mod checked;
mod clocks;
mod colmap;
mod contents;
mod decode;
mod description;
mod doctor;
mod error;
mod files;
mod footage;
mod kind;
mod kinds;
mod lanczos;
mod lens;
mod masks;
mod names;
mod points;
mod points_in_view;
mod prepare;
mod prepared;
mod raw;
mod recording;
mod rig;
mod synthetic;
#[cfg(feature = "video")]
mod video;
#[cfg(not(feature = "video"))]
#[path = "video_absent.rs"]
mod video;

pub use builder::{CameraBuilder, CaptureBuilder};
pub use calibration::{CalibratedCamera, Calibration};
pub use capture::{Capture, Split};
pub use clocks::{ClockEvidence, Clocks, ClocksFrom};
pub use description::{
    CalibrationSource, CaptureDescription, ClockSource, ColorSource, DESCRIPTION_FILE, DescribedCamera, Role,
};
pub use doctor::{CameraFit, CameraPictures, Diagnosis, Finding, FindingKind, check, same_poses};
pub use error::CaptureError;
pub use kind::{CaptureFacts, CaptureKind};
pub use kinds::MASKS_FOLDER;
pub use masks::{MaskSettings, make_masks, obstacle_to_masks};
pub use points::{POINTS_FILE, write_points, write_prepared};
pub use prepare::{PrepareSettings, prepare, spread_points};
pub use prepared::{Origin, Prepared};
pub use raw::{DescribeSettings, PlacedCameras, RawCamera, RawFootage};
pub use recording::end_programs;
pub use rig::{
    ColorBalance, FoundCameras, Refinement, balance_colors, find_cameras, has_colmap, moving_cameras, refine_cameras,
    scale_cameras,
};
pub use synthetic::{Late, SYNTHETIC_FRAME_RATE, SyntheticSettings, ball_at, write_synthetic};
