// What one iteration is asked for; twin of `StepUniform` and its rates in step.rs, which puts WEIGHTS in.
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
    step_min_share: f32,
    WEIGHTS
    adam: array<vec4<f32>, ADAM_GROUPS>,
}
