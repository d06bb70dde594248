//! Renderers against an oracle, against each other and against other programs; shaders.

// Test helpers may unwrap, like tests.
#![allow(clippy::unwrap_used)]

#[cfg(feature = "cpu")]
mod differences;
#[cfg(all(feature = "cpu", feature = "gpu"))]
mod golden;
#[cfg(all(feature = "cpu", feature = "gpu"))]
mod gpu_edges;
#[cfg(feature = "cpu")]
mod harmonics;
#[cfg(all(feature = "cpu", feature = "gpu"))]
mod parity;
#[cfg(feature = "gpu")]
mod shaders;
#[cfg(feature = "cpu")]
mod support;
#[cfg(feature = "cpu")]
mod tiles;
