//! Captures of every kind, made up and real.

// What helps a test may unwrap as a test may.
#![allow(clippy::unwrap_used)]

mod built;
mod colmap;
mod nerfstudio;
#[cfg(feature = "video")]
mod neural3d;
mod panoptic;
mod prepare;
mod real;
#[cfg(feature = "video")]
mod real_raw;
#[cfg(feature = "video")]
mod recordings;
mod support;
mod technicolor;
mod untrusted;
#[cfg(not(feature = "video"))]
mod without_video;
