//! Captures from footage: recordings on one clock, points from images alone, and the check of both.

// Helpers of tests may unwrap, as tests may.
#![allow(clippy::unwrap_used)]

#[cfg(feature = "video")]
mod raw;
// The folders of this module are made of symbolic links.
#[cfg(all(feature = "video", unix))]
mod real_raw;
mod spoilt;
mod stereo;
mod support;
