//! Compression, files and their decoders; vectors of both versions.

// Test helpers may unwrap, like tests.
#![allow(clippy::unwrap_used)]

mod bitstream;
mod cohorts;
mod compress;
mod declared_errors;
mod keypoints;
mod quantizers;
mod sequences;
mod streaming;
mod support;
mod vectors;
mod views;
