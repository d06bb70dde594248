//! Multi-view captures: loading, checking and synthesising them.
//!
//! What lives here: everything between files of images, masks, cameras and points, and
//! [`tcgs_core::View`]. What does not: what is made of the views.

mod capture;
mod decode;
mod doctor;
mod error;
mod meta;
mod panoptic;
mod points;
mod prepare;
mod sight;
mod synthetic;

pub use capture::{Capture, CaptureKind, Split};
pub use doctor::{CameraFit, Diagnosis, Finding, FindingKind, check};
pub use error::CaptureError;
pub use prepare::{Origin, PrepareSettings, Prepared, prepare};
pub use synthetic::{SYNTHETIC_FRAME_RATE, SyntheticSettings, ball_at, write_synthetic};
