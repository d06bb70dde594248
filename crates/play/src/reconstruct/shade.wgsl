// The colours in which a camera sees Gaussians with spherical harmonics.
//
//   shade   a thread per Gaussian: the harmonics in the direction from the camera to its centre, times its coefficients
//
// The host puts the constants before this source: DEGREE, 1 to 3. Functions and signs are those of `core/src/harmonics.rs`.

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
@group(0) @binding(2) var<storage, read> harmonics: array<f32>;
@group(0) @binding(5) var<storage, read_write> values: array<f32>;

fn triple(at: u32) -> vec3<f32> {
    return vec3<f32>(harmonics[at], harmonics[at + 1u], harmonics[at + 2u]);
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
    let x = direction.x;
    let y = direction.y;
    let z = direction.z;
    var color = triple(3u * i);
    var at = 3u * n + 9u * i;
    let c1 = 0.4886025119029199;
    color += -c1 * y * triple(at);
    color += c1 * z * triple(at + 3u);
    color += -c1 * x * triple(at + 6u);
    if DEGREE >= 2u {
        let xx = x * x;
        let yy = y * y;
        let zz = z * z;
        at = 12u * n + 15u * i;
        color += 1.0925484305920792 * x * y * triple(at);
        color += -1.0925484305920792 * y * z * triple(at + 3u);
        color += 0.31539156525252005 * (2.0 * zz - xx - yy) * triple(at + 6u);
        color += -1.0925484305920792 * x * z * triple(at + 9u);
        color += 0.5462742152960396 * (xx - yy) * triple(at + 12u);
        if DEGREE >= 3u {
            at = 27u * n + 21u * i;
            color += -0.5900435899266435 * y * (3.0 * xx - yy) * triple(at);
            color += 2.890611442640554 * x * y * z * triple(at + 3u);
            color += -0.4570457994644658 * y * (4.0 * zz - xx - yy) * triple(at + 6u);
            color += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * triple(at + 9u);
            color += -0.4570457994644658 * x * (4.0 * zz - xx - yy) * triple(at + 12u);
            color += 1.445305721320277 * z * (xx - yy) * triple(at + 15u);
            color += -0.5900435899266435 * x * (xx - 3.0 * yy) * triple(at + 18u);
        }
    }
    color = max(color, vec3<f32>(0.0));
    let color_at = tracks.base + 3u * i;
    values[color_at] = color.x;
    values[color_at + 1u] = color.y;
    values[color_at + 2u] = color.z;
}
