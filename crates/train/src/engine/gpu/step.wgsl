// What one iteration is asked for; twin of `StepUniform` in step.rs.
struct Step {
    num_gaussians: u32,
    num_foreground: u32,
    per_node: u32,
    num_background: u32,
    num_cameras: u32,
    camera: u32,
    slot: u32,
    flags: u32,
    width: u32,
    height: u32,
    num_quantizers: u32,
    target_offset: u32,
    mask_threshold: f32,
    image_weight: f32,
    segmentation_weight: f32,
    rigid_weight: f32,
    rot_weight: f32,
    iso_weight: f32,
    floor_weight: f32,
    background_weight: f32,
    soft_color_weight: f32,
    mask_weight: f32,
    mask_consistency_weight: f32,
    step_min_share: f32,
    adam: array<vec4<f32>, 10>,
}

const MASKED: u32 = 1u;
const COUNTS: u32 = 2u;
const MOVES: u32 = 4u;
const QUANTIZED: u32 = 8u;
const COMPARES_MASKS: u32 = 16u;
const SEGMENTED: u32 = 32u;
const HAS_PRIOR: u32 = 64u;
const LEARNED_OFFSET: u32 = 128u;
