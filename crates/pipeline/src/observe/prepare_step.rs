//! Results of the steps that make a capture.

use std::path::Path;

use tcgs_capture::{CaptureDescription, Prepared};
use tcgs_prepare::{Clocks, PlacedCameras, RawCamera};

use super::Work;

/// The result of a step of [`prepare`](crate::prepare()).
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub enum PrepareStep<'a> {
    /// A dry run: the work would be done.
    Planned(Work),
    /// Cameras and clocks are taken from this file of an earlier call.
    Reused(&'a Path),
    /// The source's points are not used.
    PointsIgnored,
    /// The videos that were found.
    Recordings(&'a [RawCamera]),
    /// The calibration is assigned to the videos. `None` without a calibration: COLMAP is to find the cameras.
    Placed(Option<&'a PlacedCameras>),
    /// The clocks are known, and so is the span of the capture.
    Clocks {
        /// The clocks.
        clocks: &'a Clocks,
        /// The capture.
        description: &'a CaptureDescription,
    },
    /// These cameras have the same place and the same direction.
    SamePose(&'a [&'a str]),
    /// COLMAP found the cameras: how, in words.
    CamerasFound(&'a str),
    /// The calibration was refined, or not: lines of `calibration.changes` in `capture.toml`.
    Refined(&'a [String]),
    /// All lengths were scaled: by what, in words.
    Scaled(&'a str),
    /// The cameras' colours were compared: lines in words.
    ColorsCompared(&'a [String]),
    /// The capture's masks are used.
    MasksKept,
    /// No masks are made, since that is impossible.
    NoMasks {
        /// Name of the capture.
        name: &'a str,
        /// The reason.
        problem: &'a str,
    },
    /// Masks were made.
    Masks {
        /// Number of masks.
        num_masks: usize,
        /// Share of their pixels that move.
        share: f64,
        /// Seconds of making them.
        secs: f64,
    },
    /// The capture's points are used.
    PointsKept,
    /// Points were made by stereo.
    Points {
        /// The points.
        prepared: &'a Prepared,
        /// Seconds of making them.
        secs: f64,
    },
    /// Points were strewn, since stereo cannot make any.
    PointsStrewn {
        /// The points.
        prepared: &'a Prepared,
        /// The reason.
        why: &'a str,
    },
    /// A warning: the replaced capture could not be removed.
    LeftOver(&'a str),
}
