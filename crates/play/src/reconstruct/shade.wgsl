// The colours in which a camera sees Gaussians with spherical harmonics.
//
//   shade   one thread per Gaussian: spherical harmonics of the direction from camera to centre, times the coefficients
//
// The host puts the constants before this source: DEGREE, 1 to 3; and the function `harmonics`.

struct FrameUniform {
    eye: vec3<f32>,
    timestep: u32,
}

struct TrackUniform {
    // Gaussians.
    count: u32,
    // Index of the first colour in values.
    base: u32,
    // Index of the first mean in values.
    means_at: u32,
    unused: u32,
}

@group(0) @binding(0) var<uniform> frame: FrameUniform;
@group(0) @binding(1) var<uniform> tracks: TrackUniform;
// colors [N, 3] | degree 1 [N, 3, 3] | degree 2 [N, 5, 3] | degree 3 [N, 7, 3]
@group(0) @binding(2) var<storage, read> coefficients: array<f32>;
@group(0) @binding(5) var<storage, read_write> values: array<f32>;

fn triple(at: u32) -> vec3<f32> {
    return vec3<f32>(coefficients[at], coefficients[at + 1u], coefficients[at + 2u]);
}

@compute @workgroup_size(WORKGROUP)
fn shade(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    let n = tracks.count;
    if i >= n {
        return;
    }
    let mean_at = tracks.means_at + 3u * i;
    let offset = vec3<f32>(values[mean_at], values[mean_at + 1u], values[mean_at + 2u]) - frame.eye;
    let squares = dot(offset, offset);
    // A Gaussian around the camera has no direction; it is nearer than anything that is drawn.
    let direction = select(vec3<f32>(0.0), offset * inverseSqrt(max(squares, 1e-37)), squares > 1e-37);
    var basis = harmonics(direction);
    var color = triple(3u * i);
    for (var k = 0u; k < 3u; k += 1u) {
        color += basis[k] * triple(3u * n + 9u * i + 3u * k);
    }
    if DEGREE >= 2u {
        for (var k = 0u; k < 5u; k += 1u) {
            color += basis[3u + k] * triple(12u * n + 15u * i + 3u * k);
        }
    }
    if DEGREE >= 3u {
        for (var k = 0u; k < 7u; k += 1u) {
            color += basis[8u + k] * triple(27u * n + 21u * i + 3u * k);
        }
    }
    color = max(color, vec3<f32>(0.0));
    let color_at = tracks.base + 3u * i;
    values[color_at] = color.x;
    values[color_at + 1u] = color.y;
    values[color_at + 2u] = color.z;
}
