//! Multi-view captures: loading, checking and synthesising them.
//!
//! What lives here: everything between files of images, masks, cameras and points, and
//! [`tcgs_core::View`]. What does not: what is made of the views.

mod capture;
mod decode;
mod error;
mod meta;
mod panoptic;
mod points;
mod sight;
mod synthetic;

pub use capture::{Capture, CaptureKind, Split};
pub use error::CaptureError;
pub use synthetic::{SYNTHETIC_FRAME_RATE, SyntheticSettings, ball_at, write_synthetic};
