//! Multi-view captures: loading, checking and synthesising them.
//!
//! The feature `video`, on by default, reads captures of videos; it needs a C++ compiler, for H.264.
//!
//! What lives here: everything between files of images, masks, cameras and points, and
//! [`tcgs_core::View`]. What does not: what is made of the views.

mod builder;
mod capture;
mod colmap;
mod contents;
mod decode;
mod doctor;
mod error;
mod files;
mod footage;
mod kind;
mod kinds;
mod lanczos;
mod lens;
mod names;
mod points;
mod points_in_view;
mod prepare;
mod synthetic;
#[cfg(feature = "video")]
mod video;
#[cfg(not(feature = "video"))]
#[path = "video_absent.rs"]
mod video;

pub use builder::{CameraBuilder, CaptureBuilder};
pub use capture::{Capture, Split};
pub use doctor::{CameraFit, Diagnosis, Finding, FindingKind, check};
pub use error::CaptureError;
pub use kind::{CaptureFacts, CaptureKind};
pub use points::{POINTS_FILE, write_points};
pub use prepare::{Origin, PrepareSettings, Prepared, prepare};
pub use synthetic::{SYNTHETIC_FRAME_RATE, SyntheticSettings, ball_at, write_synthetic};
