//! The player: requests, shaders, pictures.

// Test helpers may unwrap, like tests.
#![allow(clippy::unwrap_used)]

mod picture;
mod player;
mod shaders;
mod start_view;
mod support;
