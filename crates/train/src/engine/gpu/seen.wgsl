
// The colours in which a camera sees Gaussians with spherical harmonics, and back.
//
// - params, grads: as in activate.wgsl; band l of the harmonics begins at SHl_AT times N
// - activated: the colours of the N rows, stored ones in, seen ones out
// - lists, seen_elsewhere: the Gaussians of each view, see parts.rs, and the colours [L, C] in which it sees them
//
// One thread per Gaussian.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> params: array<f32>;
@group(0) @binding(2) var<storage, read_write> activated: array<f32>;
@group(0) @binding(3) var<storage, read_write> grads: array<f32>;
@group(0) @binding(4) var<storage, read> lists: array<u32>;
@group(0) @binding(5) var<storage, read> seen_elsewhere: array<f32>;

fn num_channels() -> u32 {
    return select(3u, 5u, (step.flags & SEGMENTED) != 0u);
}

// From the camera to the centre of Gaussian `n`.
fn offset(n: u32) -> vec3<f32> {
    let at = MEAN_AT * step.num_gaussians + 3u * n;
    return vec3(params[at] - step.eye_x, params[at + 1u] - step.eye_y, params[at + 2u] - step.eye_z);
}

// Where coefficient `k` of Gaussian `n` lies, from 0 on for the first of degree 1.
fn coefficient_at(k: u32, n: u32) -> u32 {
    let num = step.num_gaussians;
    if (k < 3u) {
        return SH1_AT * num + 9u * n + 3u * k;
    }
    if (k < 8u) {
        return SH2_AT * num + 15u * n + 3u * (k - 3u);
    }
    return SH3_AT * num + 21u * n + 3u * (k - 8u);
}

fn coefficient(k: u32, n: u32) -> vec3<f32> {
    let at = coefficient_at(k, n);
    return vec3(params[at], params[at + 1u], params[at + 2u]);
}

// Gradient to the direction, without the constraint of unit length.
fn harmonics_vjp(d: vec3<f32>, v: array<f32, 15>) -> vec3<f32> {
    let x = d.x;
    let y = d.y;
    let z = d.z;
    let xx = x * x;
    let yy = y * y;
    let zz = z * z;
    let degree_1 = vec3(-C1 * v[2], -C1 * v[0], C1 * v[1]);
    let degree_2 = vec3(
        C21 * (y * v[3] - z * v[6]) + 2.0 * x * (C22 * v[7] - C20 * v[5]),
        C21 * (x * v[3] - z * v[4]) - 2.0 * y * (C22 * v[7] + C20 * v[5]),
        4.0 * C20 * z * v[5] - C21 * (y * v[4] + x * v[6]),
    );
    let degree_3 = vec3(
        2.0 * C32 * z * (y * v[9] + x * v[13]) + 2.0 * C31 * x * y * v[10] - 6.0 * (C33 * x * y * v[8] + C30 * x * z * v[11])
            - C31 * (4.0 * zz - 3.0 * xx - yy) * v[12] - 3.0 * C33 * (xx - yy) * v[14],
        2.0 * C32 * z * (x * v[9] - y * v[13]) + 2.0 * C31 * x * y * v[12] + 6.0 * (C33 * x * y * v[14] - C30 * y * z * v[11])
            - C31 * (4.0 * zz - xx - 3.0 * yy) * v[10] - 3.0 * C33 * (xx - yy) * v[8],
        C32 * (2.0 * x * y * v[9] + (xx - yy) * v[13]) - 8.0 * C31 * z * (y * v[10] + x * v[12])
            + 3.0 * C30 * (2.0 * zz - xx - yy) * v[11],
    );
    return degree_1 + degree_2 + degree_3;
}

// Overwrites the colours of drawn Gaussians that are not rows of the state; these colours are constant.
@compute @workgroup_size(256)
fn place_seen(@builtin(global_invocation_id) id: vec3<u32>) {
    if (id.x >= step.num_listed) {
        return;
    }
    let n = lists[step.lists_at + id.x];
    if (n < step.num_gaussians) {
        return;
    }
    let channels = num_channels();
    for (var c = 0u; c < channels; c += 1u) {
        let value = seen_elsewhere[step.colors_at + channels * id.x + c];
        activated[COLORS_AT * step.num_drawn + channels * n + c] = value;
    }
}

// Replaces the stored colours of the rows in `activated` by the seen ones.
@compute @workgroup_size(256)
fn seen_fwd(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = id.x;
    if (n >= step.num_gaussians) {
        return;
    }
    let at = COLORS_AT * step.num_drawn + num_channels() * n;
    var sum = vec3(activated[at], activated[at + 1u], activated[at + 2u]);
    let to = offset(n);
    let distance = length(to);
    var values = harmonics(select(vec3(0.0), to / distance, distance > 0.0));
    for (var k = 0u; k < NUM_COEFFICIENTS; k += 1u) {
        sum += values[k] * coefficient(k, n);
    }
    let color = max(sum, vec3(0.0));
    activated[at] = color.x;
    activated[at + 1u] = color.y;
    activated[at + 2u] = color.z;
}

// Overwrites the gradients of the harmonics, and replaces the gradients of the seen colours by those of the stored
// colours. Accumulates into the gradients of the means, on which the direction depends.
@compute @workgroup_size(256)
fn seen_bwd(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = id.x;
    let num = step.num_gaussians;
    if (n >= num) {
        return;
    }
    let at = COLOR_AT * num + 3u * n;
    let seen_at = COLORS_AT * step.num_drawn + num_channels() * n;
    // A clamped channel passes no gradient.
    var v_sum = vec3(0.0);
    for (var c = 0u; c < 3u; c += 1u) {
        if (activated[seen_at + c] > 0.0) {
            v_sum[c] = grads[at + c];
        }
        grads[at + c] = v_sum[c];
    }
    let to = offset(n);
    let distance = length(to);
    let direction = select(vec3(0.0), to / distance, distance > 0.0);
    var values = harmonics(direction);
    var v_values = array<f32, 15>();
    for (var k = 0u; k < NUM_COEFFICIENTS; k += 1u) {
        v_values[k] = dot(coefficient(k, n), v_sum);
        let v_coefficient = values[k] * v_sum;
        let place = coefficient_at(k, n);
        grads[place] = v_coefficient.x;
        grads[place + 1u] = v_coefficient.y;
        grads[place + 2u] = v_coefficient.z;
    }
    if (distance > 0.0) {
        let v_direction = harmonics_vjp(direction, v_values);
        let v_mean = (v_direction - direction * dot(direction, v_direction)) / distance;
        let mean_at = MEAN_AT * num + 3u * n;
        grads[mean_at] += v_mean.x;
        grads[mean_at + 1u] += v_mean.y;
        grads[mean_at + 2u] += v_mean.z;
    }
}
