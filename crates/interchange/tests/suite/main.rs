//! Files of other programs: their values, damaged ones, and limits of readers.

// Helpers of tests may unwrap, as tests may.
#![allow(clippy::unwrap_used)]

mod limits;
mod mutants;
mod other_programs;

use std::path::{Path, PathBuf};

/// Files of one timestep, of every kind.
const ONE_TIMESTEP: [&str; 9] = [
    "gaussian_splats_3d_0.ksplat",
    "gaussian_splats_3d_2.ksplat",
    "original.ply",
    "splat_transform.compressed.ply",
    "splat_transform.glb",
    "splat_transform_37.sog",
    "splat_transform_v3.spz",
    "splat_transform_v4.spz",
    "spz_v2.spz",
];
/// Files of three timesteps, of both temporal models.
const SCENES: [&str; 2] = ["fourdgs_births.4dgs", "fourdgs_states.4dgs"];

/// A file of `testdata/interchange`.
fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../testdata/interchange").join(name)
}
