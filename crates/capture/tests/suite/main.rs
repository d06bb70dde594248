//! Captures of every kind, synthetic and real.

// Helpers of tests may unwrap, as tests may.
#![allow(clippy::unwrap_used)]

mod built;
mod colmap;
mod nerfstudio;
#[cfg(feature = "video")]
mod neural3d;
mod panoptic;
mod prepare;
mod real;
// The folders of this module are made of symbolic links.
#[cfg(all(feature = "video", unix))]
mod real_raw;
#[cfg(feature = "video")]
mod recordings;
mod spoilt;
mod support;
mod technicolor;
mod untrusted;
#[cfg(not(feature = "video"))]
mod without_video;
