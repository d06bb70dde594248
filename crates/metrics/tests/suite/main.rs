//! Metrics against their definitions and against values of other programs.

// Test helpers may unwrap, like tests.
#![allow(clippy::unwrap_used)]

mod definition;
mod golden;
#[cfg(feature = "lpips")]
mod lpips;
mod similarity;
mod ssim;
