// What every kernel of the renderer knows: the camera and the sizes.
struct View {
    rows: array<vec4<f32>, 3>,          // camera_from_world
    focal: vec2<f32>,                   // pixels
    principal: vec2<f32>,
    slope_min: vec2<f32>,               // range of x/z and y/z in which projection is linearised
    slope_max: vec2<f32>,
    size: vec2<u32>,                    // width, height in pixels
    grid: vec2<u32>,                    // tiles in a row and in a column
    num_gaussians: u32,
    pair_capacity: u32,
    statistic_channels: u32,
    unused: u32,
    background: array<vec4<f32>, 2>,    // one value a channel
}

@group(0) @binding(0) var<uniform> view: View;

fn num_tiles() -> u32 {
    return view.grid.x * view.grid.y;
}

// Marks a bucket that forward did not reach: its tile was finished before.
const DEAD: u32 = 0x80000000u;
