//! The kernels of the reconstruction as WGSL.

use bytemuck::{Pod, Zeroable};
use tcgs_core::{Activation, Layout, MAX_SH_DEGREE};
use tcgs_render::device::{MAX_GROUPS_X, WORKGROUP, Wgsl};

/// Timestep and camera position of a cohort; mirrors `FrameUniform` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub(super) struct FrameUniform {
    /// Position of the camera in the world.
    pub(super) eye: [f32; 3],
    /// Counted from the first timestep of the cohort.
    pub(super) timestep: u32,
}

/// A kernel's data about its attribute; mirrors `TrackUniform` in the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub(super) struct TrackUniform {
    /// Units of the attribute that move, or Gaussians.
    pub(super) count: u32,
    /// Index of the attribute's first value in the buffer that the kernel writes.
    pub(super) base: u32,
    /// Index of the first keypoint time, in words of 16 bits; for spherical harmonics, index of the first mean.
    pub(super) times_at: u32,
    /// Index of the first code, in words of 16 bits.
    pub(super) codes_at: u32,
}

/// Marks an opacity that moves, in place of a constant one. No opacity has these bits.
pub(super) const MOVES: u32 = u32::MAX;

/// Interpolation of an attribute.
///
/// - `unit`: components of a unit
/// - `activation`: of the interpolated values
pub(super) fn interpolate(unit: usize, activation: Activation) -> String {
    Wgsl::new()
        .constant("UNIT", unit)
        .constant("ACTIVATION", activation as u32)
        .constant("EXP", Activation::Exp as u32)
        .constant("SIGMOID", Activation::Sigmoid as u32)
        .constant("NORMALIZE", Activation::Normalize as u32)
        .constant("MOVES", MOVES)
        .constant("WORKGROUP", WORKGROUP)
        .constant("MAX_GROUPS_X", MAX_GROUPS_X)
        .part(include_str!("interpolate.wgsl"))
        .finish()
}

/// Colours from harmonics up to a degree.
pub(super) fn shade(degree: usize) -> String {
    let constants = Wgsl::new().constant("DEGREE", degree).constant("WORKGROUP", WORKGROUP);
    constants.harmonics().part(include_str!("shade.wgsl")).finish()
}

/// Name and WGSL of every shader of the reconstruction, as the GPU gets it.
pub(crate) fn sources() -> Vec<(String, String)> {
    use Activation::{Exp, Identity, Normalize, Sigmoid};
    let base = [(1, Identity), (1, Exp), (1, Sigmoid), (3, Identity), (3, Exp), (4, Normalize)];
    let bands = Layout::with_harmonics(MAX_SH_DEGREE).harmonics().into_iter().map(|band| (band.components(), Identity));
    let name = |unit, activation| format!("reconstruct_{unit}_{activation:?}").to_lowercase();
    let interpolations =
        base.into_iter().chain(bands).map(|(unit, activation)| (name(unit, activation), interpolate(unit, activation)));
    let shades = (1..=MAX_SH_DEGREE).map(|degree| (format!("shade_{degree}"), shade(degree)));
    interpolations.chain(shades).collect()
}
