//! Makes captures: from videos to cameras on one clock, masks and initial points, and a check of all of them.
//!
//! - [`RawFootage`] finds the videos of a folder, places them by a [`Calibration`](tcgs_capture::Calibration), and
//!   describes them with their [`Clocks`]. [`Capture::open`](tcgs_capture::Capture::open) opens the description.
//! - [`find_cameras`] has COLMAP place the cameras of a description, [`refine_cameras`] mends a calibration,
//!   [`balance_colors`] measures how the cameras differ in exposure and white balance.
//! - [`make_masks`] marks what moves in a capture without masks.
//! - [`stereo_points`] makes initial points by multi-view stereo, for a capture that has none;
//!   [`close_holes`] adds to given points what no image shows.
//! - [`check`] looks for wrong cameras, masks and clocks.
//!
//! What lives here: everything that makes a capture from footage, or examines one. What does not: the readers of
//! videos, calibrations and captures (`tcgs_capture`), and the order of these steps. The split keeps bundle adjustment
//! and stereo out of the programs that read captures.

mod clocks;
mod doctor;
mod error;
mod masks;
mod raw;
mod rig;
mod stereo;

pub use clocks::{ClockEvidence, Clocks, ClocksFrom};
pub use doctor::{CameraFit, CameraPictures, Diagnosis, Finding, FindingKind, check, same_poses};
pub use error::PrepareError;
pub use masks::{MaskSettings, make_masks, obstacle_to_masks};
pub use raw::{DescribeSettings, PlacedCameras, RawCamera, RawFootage};
pub use rig::{
    ColorBalance, FoundCameras, Refinement, balance_colors, find_cameras, has_colmap, moving_cameras, refine_cameras,
    scale_cameras,
};
pub use stereo::{StereoSettings, close_holes, spread_points, stereo_points};
