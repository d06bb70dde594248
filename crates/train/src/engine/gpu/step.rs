//! What one iteration is asked for, as the shaders read it, and the text that every shader starts with.

use tcgs_render::device::Wgsl;

use crate::adam::{BETA1, BETA2, EPSILON, adam_factors};

/// One iteration, written by the host before it; twin of `Step` in `step.wgsl`.
///
/// Counts and positions are of elements, weights those of [`crate::WeightConfig`].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct StepUniform {
    /// `N`
    pub num_gaussians: u32,
    /// `F`
    pub num_foreground: u32,
    /// Edges of a foreground Gaussian.
    pub per_node: u32,
    /// `B`
    pub num_background: u32,
    /// `K`
    pub num_cameras: u32,
    /// Position of this view's camera.
    pub camera: u32,
    /// Where in the ring of losses this iteration writes.
    pub slot: u32,
    /// Sum of [`Self::MASKED`] and the others.
    pub flags: u32,
    /// Of this view's image, pixels.
    pub width: u32,
    /// Of this view's image, pixels.
    pub height: u32,
    /// `Q`
    pub num_quantizers: u32,
    /// Position of this view's first value in the targets.
    pub target_offset: u32,
    /// `ε` of the masks.
    pub mask_threshold: f32,
    /// Of the colour image.
    pub image_weight: f32,
    /// Of the segmentation image.
    pub segmentation_weight: f32,
    /// See [`crate::WeightConfig`].
    pub rigid_weight: f32,
    /// See [`crate::WeightConfig`].
    pub rot_weight: f32,
    /// See [`crate::WeightConfig`].
    pub iso_weight: f32,
    /// 0 without segmentation.
    pub floor_weight: f32,
    /// See [`crate::WeightConfig`].
    pub background_weight: f32,
    /// See [`crate::WeightConfig`].
    pub soft_color_weight: f32,
    /// `λ_mask`
    pub mask_weight: f32,
    /// `λ_mc`
    pub mask_consistency_weight: f32,
    /// A quantizer's step never falls below this share of where it started.
    pub step_min_share: f32,
    /// [`adam_rates`] of the groups: mean, quat, log_scale, logit_opacity, color, mask, gains, offsets,
    /// quantizers' steps, quantizers' offsets.
    pub adam: [[f32; 4]; 10],
}

impl StepUniform {
    /// Masks are on.
    pub const MASKED: u32 = 1;
    /// The densification statistic is counted.
    pub const COUNTS: u32 = 2;
    /// Gaussians move.
    pub const MOVES: u32 = 4;
    /// Fake quantisation is on.
    pub const QUANTIZED: u32 = 8;
    /// `L_mc` is on: there are mask logits of the timestep before.
    pub const COMPARES_MASKS: u32 = 16;
    /// Two channels of segmentation beside the colours.
    pub const SEGMENTED: u32 = 32;
    /// Losses on motion are on.
    pub const HAS_PRIOR: u32 = 64;
    /// Quantizers' offsets are learned.
    pub const LEARNED_OFFSET: u32 = 128;

    /// Names of the flags in the shaders.
    const FLAGS: [(&str, u32); 8] = [
        ("MASKED", Self::MASKED),
        ("COUNTS", Self::COUNTS),
        ("MOVES", Self::MOVES),
        ("QUANTIZED", Self::QUANTIZED),
        ("COMPARES_MASKS", Self::COMPARES_MASKS),
        ("SEGMENTED", Self::SEGMENTED),
        ("HAS_PRIOR", Self::HAS_PRIOR),
        ("LEARNED_OFFSET", Self::LEARNED_OFFSET),
    ];
}

/// What a shader needs of Adam for one group: `(step size, correction, 0, 0)`.
///
/// - `rate`: learning rate; 0 leaves the group as it is
/// - `count`: updates including this one, from 1
pub fn adam_rates(rate: f32, count: u64) -> [f32; 4] {
    let [step_size, correction] = adam_factors(rate, count);
    [step_size, correction, 0.0, 0.0]
}

/// A source with the uniform's declaration, its flags and Adam's constants.
///
/// - `constants`: what else the shader needs
pub(super) fn source(constants: Wgsl) -> Wgsl {
    let mut source = constants.part(include_str!("step.wgsl"));
    for (name, flag) in StepUniform::FLAGS {
        source = source.constant(name, flag);
    }
    source.constant("BETA1", BETA1).constant("BETA2", BETA2).constant("EPSILON", EPSILON)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_uniform_has_the_layout_of_the_shader() {
        let module = wgpu::naga::front::wgsl::parse_str(&source(Wgsl::new()).finish()).expect("the shader parses");
        let (_, declared) = module.types.iter().find(|(_, t)| t.name.as_deref() == Some("Step")).expect("a Step");
        let wgpu::naga::TypeInner::Struct { members, span } = &declared.inner else { panic!("not a struct") };
        assert_eq!(*span as usize, size_of::<StepUniform>());
        // Every member but the last is one word, so that names and order say where it lies.
        let text = format!("{:?}", StepUniform::default());
        let mut rest = text.as_str();
        for (i, member) in members.iter().enumerate() {
            let name = member.name.as_deref().expect("a name");
            let at = rest.find(&format!("{name}: ")).unwrap_or_else(|| panic!("{name} is missing or out of order"));
            rest = &rest[at + name.len()..];
            assert_eq!(member.offset as usize, 4 * i, "{name}");
        }
        assert_eq!(members.len(), 25);
        assert_eq!(std::mem::offset_of!(StepUniform, adam), members[24].offset as usize);
    }
}
