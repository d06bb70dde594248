//! The player: requests, shaders, pictures.

// Test helpers may unwrap, like tests.
#![allow(clippy::unwrap_used)]

#[cfg(feature = "webgl2")]
mod arranged;
#[cfg(feature = "webgpu")]
mod picture;
mod player;
#[cfg(feature = "webgpu")]
mod shaders;
mod start_view;
mod support;
