//! Numbers that both engines compute with. They stand here once; shaders get them through
//! [`tcgs_render::device::Wgsl::constant`].

/// Share of L1 in the image loss; the rest is SSIM's. Kerbl et al. 2023, Eq. 7.
pub(crate) const L1_SHARE: f32 = 0.8;

/// Channels of the images that the image losses are means over. The segmentation image's middle one is always zero, is
/// not rendered, and still counts.
pub(crate) const COUNTED_CHANNELS: f32 = 3.0;

/// Decay of Adam's first moments.
pub(crate) const BETA1: f32 = 0.9;

/// Decay of Adam's second moments.
pub(crate) const BETA2: f32 = 0.999;

/// Added to the root of Adam's second moment. Reference: far below any gradient, so that the step does not depend on the
/// loss's scale.
pub(crate) const ADAM_EPSILON: f32 = 1e-15;

/// A quantizer's step never falls below this share of where it started.
pub(crate) const MIN_STEP_SHARE: f32 = 0.1;

/// Added under square roots of the losses on motion, so that they have a derivative at zero. Reference.
pub(crate) const ROOT_EPSILON: f64 = 1e-20;

/// What Adam's update number `count` multiplies with: the step size `rate / (1 − β1ᵗ)` and the second moment's
/// correction `1 / √(1 − β2ᵗ)`.
///
/// - `rate`: learning rate
/// - `count`: `t`, updates including this one, from 1
pub(crate) fn adam_factors(rate: f32, count: u64) -> [f32; 2] {
    let t = i32::try_from(count).unwrap_or(i32::MAX);
    [rate / (1.0 - BETA1.powi(t)), 1.0 / (1.0 - BETA2.powi(t)).sqrt()]
}
