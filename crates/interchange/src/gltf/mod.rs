//! glTF files with the extension `KHR_gaussian_splatting`: one timestep. `document` is their JSON, `buffers` their
//! numbers, `placement` where nodes put a mesh.
//!
//! | attribute of a primitive of mode `POINTS` | here |
//! |---|---|
//! | `POSITION` | `means` |
//! | `KHR_gaussian_splatting:ROTATION` | `quats`; `x, y, z, w`, unit |
//! | `KHR_gaussian_splatting:SCALE` | `log_scales`; standard deviations, not their logarithms |
//! | `KHR_gaussian_splatting:OPACITY` | `logit_opacities`; activated, in `[0, 1]` |
//! | `KHR_gaussian_splatting:SH_DEGREE_0_COEF_0` | `colors`, as coefficients: `(color - 0.5) / 0.28209…` |
//! | `KHR_gaussian_splatting:SH_DEGREE_l_COEF_n` | `sh1` to `sh3`; `n` counts `m` from `-l` to `l` |
//! | `COLOR_0` | written as colour and opacity, for viewers of points; not read |
//!
//! The harmonics have the signs of 3D Gaussian splatting. Axes are x left, y up, z forward; here they are those of PLY
//! files, so positions, rotations and harmonics turn by 180 degrees about z. Numbers are floats, or integers as glTF
//! quantises.
//!
//! An opacity of 1 has no logit; it is read as the largest float that is distinguishable from 1. Activation rounds: a
//! log scale comes back within 2e-7, the opacity of a logit within 6e-8.
//!
//! Facts: the extension as ratified by the Khronos Group (README of `KHR_gaussian_splatting`, 2026), in which scales
//! are linear. Its drafts before February 2026 had logarithms; these are negative for scales below 1, and refused.

mod buffers;
mod document;
mod placement;
mod read;
mod write;

pub(crate) use read::{is_gltf, read_gltf, read_head};
pub use write::write_glb_to;

/// Name of the extension.
const EXTENSION: &str = "KHR_gaussian_splatting";
/// Type of the chunk of a `.glb` file that holds the JSON.
const JSON: u32 = u32::from_le_bytes(*b"JSON");
/// Type of the chunk that holds the buffer.
const BIN: u32 = u32::from_le_bytes(*b"BIN\0");

/// Name of the attribute of one coefficient.
fn harmonic(l: usize, n: usize) -> String {
    format!("{EXTENSION}:SH_DEGREE_{l}_COEF_{n}")
}

/// Name of an attribute of the extension.
fn attribute(name: &str) -> String {
    format!("{EXTENSION}:{name}")
}

#[cfg(test)]
mod tests;
