// Uniform of every kernel of the renderer: the camera and the sizes.
struct View {
    rows: array<vec4<f32>, 3>,          // camera_from_world
    focal: vec2<f32>,                   // pixels
    principal: vec2<f32>,
    slope_min: vec2<f32>,               // range of x/z and y/z in which projection is linearised
    slope_max: vec2<f32>,
    size: vec2<u32>,                    // width, height in pixels
    grid: vec2<u32>,                    // tiles in a row and in a column
    num_gaussians: u32,                 // N: rows of activated and splats
    pair_capacity: u32,
    statistic_channels: u32,
    num_listed: u32,                    // Gaussians that may be drawn
    num_rows: u32,                      // rows of gradients: those of the first Gaussians
    num_active: u32,                    // of these, the first ones that get a gradient
    num_tiles: u32,                     // tiles that are drawn
    lists_at: u32,                      // where this view's lists begin
    antialiased: u32,                   // 1 if a splat gives up opacity for the blur, else 0
    background: array<vec4<f32>, 2>,    // one value a channel
}

@group(0) @binding(0) var<uniform> view: View;

// Marks a bucket that forward did not reach, because its tile was finished before.
const DEAD: u32 = 0x80000000u;
