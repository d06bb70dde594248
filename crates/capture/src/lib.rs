//! Multi-view captures: loading, checking and synthesising them.
//!
//! What lives here: everything between files of images, masks, cameras and points, and
//! [`tcgs_core::View`]. What does not: what is made of the views.

mod capture;
mod colmap;
mod decode;
mod doctor;
mod error;
mod files;
mod kind;
mod lanczos;
mod lens;
mod meta;
mod middlebury;
mod nerfstudio;
mod neural3d;
mod panoptic;
mod points;
mod prepare;
mod shot;
mod sight;
mod split;
mod synthetic;
mod technicolor;
mod video;

pub use capture::{Capture, Split};
pub use doctor::{CameraFit, Diagnosis, Finding, FindingKind, check};
pub use error::CaptureError;
pub use kind::CaptureKind;
pub use points::{POINTS_FILE, write_points};
pub use prepare::{Origin, PrepareSettings, Prepared, prepare};
pub use synthetic::{SYNTHETIC_FRAME_RATE, SyntheticSettings, ball_at, write_synthetic};
