//! Training: engines against each other, against finite differences and vectors of other programs, and runs as a whole.

// Test helpers may unwrap, like tests.
#![allow(clippy::unwrap_used)]

mod births;
mod checkpoints;
mod columns;
mod deaths;
mod differences;
mod gate;
mod golden;
#[cfg(feature = "gpu")]
mod gpu_engine;
#[cfg(feature = "gpu")]
mod gpu_engine_edges;
#[cfg(feature = "gpu")]
mod gpu_engine_scenery;
#[cfg(feature = "gpu")]
mod gpu_fake_quant;
#[cfg(feature = "gpu")]
mod gpu_prior;
mod harmonics;
#[cfg(feature = "gpu")]
mod support;
mod trainer;
mod wall;
