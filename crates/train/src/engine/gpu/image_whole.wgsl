// The pixels of a whole image: all blocks are compared, row by row. image_listed.wgsl has the same functions for an
// image of which some tiles are drawn.
//
// targets [views, H, W]

fn block_at(number: u32) -> vec2<u32> {
    let columns = (step.width + SIDE - 1u) / SIDE;
    return vec2(number % columns, number / columns);
}

// The rendered value before the camera's correction, and the target.
fn raw_and_target(pixel: vec2<u32>, channel: u32) -> vec2<f32> {
    let at = pixel.y * step.width + pixel.x;
    let word = targets[step.target_offset + at];
    return vec2(rendered[channel * step.width * step.height + at], target_value(word, channel));
}

// Whether the loss at a pixel depends on drawn content.
fn is_compared(pixel: vec2<u32>) -> bool {
    return true;
}
