//! The calls of other programs, from captures and scenes to files.

// Test helpers may unwrap, like tests.
#![allow(clippy::unwrap_used)]

mod bad_input;
mod births;
mod points;
mod progress;
mod rate;
mod seen;
mod start_view;
mod support;
mod timesteps;
