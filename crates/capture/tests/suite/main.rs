//! Captures of every kind, synthetic and real.

// Helpers of tests may unwrap, as tests may.
#![allow(clippy::unwrap_used)]

mod built;
mod colmap;
mod nerfstudio;
#[cfg(feature = "video")]
mod neural3d;
mod panoptic;
mod real;
#[cfg(feature = "video")]
mod recordings;
mod spoilt;
mod support;
mod technicolor;
mod untrusted;
#[cfg(not(feature = "video"))]
mod without_video;
