// Copies the renderer's image to a texture of the same size, pixel by pixel, and multiplies by the gains of the light.

struct Picture {
    light: vec3<f32>,
    width: u32,
    height: u32,
}

@group(0) @binding(0) var<uniform> picture: Picture;
// [C + 1, H, W]
@group(0) @binding(1) var<storage, read> image: array<f32>;

// One triangle that covers the whole texture.
@vertex
fn cover(@builtin(vertex_index) i: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(i & 1u) * 4.0 - 1.0, f32(i >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn show(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let pixel = min(vec2<u32>(position.xy), vec2<u32>(picture.width - 1u, picture.height - 1u));
    let at = pixel.y * picture.width + pixel.x;
    let plane = picture.width * picture.height;
    return vec4<f32>(picture.light * vec3<f32>(image[at], image[plane + at], image[2u * plane + at]), 1.0);
}
