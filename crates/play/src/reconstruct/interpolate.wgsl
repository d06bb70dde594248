// From keypoints to activated values at one timestep. Values that do not move are in the buffer already.
//
// - interpolate: one thread per moving unit: bisects for its two keypoints, dequantises, interpolates, activates
// - normalize_quats: one thread per Gaussian: normalises rotations whose components have times of their own
// - hide: one thread per Gaussian: sets the opacity to 0 outside its life
//
// A unit is UNIT components that share their keypoint times: all components of an attribute, or one. The host puts the
// constants UNIT, ACTIVATION and MOVES before this source. ACTIVATION is that of the interpolated values: EXP, SIGMOID
// or NORMALIZE.

struct FrameUniform {
    eye: vec3<f32>,
    // Relative to the first timestep of the cohort, like keypoint times and lives.
    timestep: u32,
}

struct TrackUniform {
    // Units that move; for normalize_quats and hide, Gaussians.
    count: u32,
    // Index of the attribute's first value in values.
    base: u32,
    // Offsets of times and codes in keypoints, in words of 16 bits.
    times_at: u32,
    codes_at: u32,
}

@group(0) @binding(0) var<uniform> frame: FrameUniform;
@group(0) @binding(1) var<uniform> tracks: TrackUniform;
// [units]: index of the unit's first value within the attribute, index of its first quantizer.
// For hide, [N]: first and last timestep of its life, 16 bits each, and its opacity, or MOVES.
@group(0) @binding(2) var<storage, read> units: array<vec2<u32>>;
// step, offset
@group(0) @binding(3) var<storage, read> quantizers: array<vec2<f32>>;
// starts [units + 1] | times [keypoints], 16 bits | codes [keypoints, UNIT], 16 bits
@group(0) @binding(4) var<storage, read> keypoints: array<u32>;
@group(0) @binding(5) var<storage, read_write> values: array<f32>;
// [N, 4] interpolated quaternions of any length
@group(0) @binding(6) var<storage, read_write> raw_quats: array<vec4<f32>>;

fn time_of(keypoint: u32) -> u32 {
    let at = tracks.times_at + keypoint;
    return extractBits(keypoints[at / 2u], 16u * (at % 2u), 16u);
}

fn code_of(keypoint: u32, component: u32) -> f32 {
    let at = tracks.codes_at + keypoint * UNIT + component;
    return f32(extractBits(bitcast<i32>(keypoints[at / 2u]), 16u * (at % 2u), 16u));
}

fn activated(value: f32) -> f32 {
    switch ACTIVATION {
        case EXP: { return exp(value); }
        case SIGMOID: { return 1.0 / (1.0 + exp(-value)); }
        default: { return value; }
    }
}

@compute @workgroup_size(WORKGROUP)
fn interpolate(@builtin(workgroup_id) group: vec3<u32>, @builtin(local_invocation_index) lane: u32) {
    let i = (group.y * MAX_GROUPS_X + group.x) * WORKGROUP + lane;
    if i >= tracks.count {
        return;
    }
    // The last keypoint that is not after the timestep; none if the Gaussian does not live in the segment.
    var before = keypoints[i];
    var end = keypoints[i + 1u];
    if before == end {
        return;
    }
    while end - before > 1u {
        let middle = (before + end) / 2u;
        if time_of(middle) <= frame.timestep {
            before = middle;
        } else {
            end = middle;
        }
    }
    let last = keypoints[i + 1u] - 1u;
    let after = min(before + 1u, last);
    let start = time_of(before);
    var fraction = 0.0;
    if after > before && start < frame.timestep {
        fraction = f32(frame.timestep - start) / f32(time_of(after) - start);
    }
    let unit = units[i];
    var value: array<f32, UNIT>;
    for (var c = 0u; c < UNIT; c++) {
        let quantizer = quantizers[unit.y + c];
        let a = code_of(before, c) * quantizer.x + quantizer.y;
        let b = code_of(after, c) * quantizer.x + quantizer.y;
        value[c] = a + (b - a) * fraction;
    }
    if ACTIVATION == NORMALIZE {
        var squares = 0.0;
        for (var c = 0u; c < UNIT; c++) {
            squares += value[c] * value[c];
        }
        let scale = inverseSqrt(max(squares, 1e-37));
        for (var c = 0u; c < UNIT; c++) {
            // A quaternion of length 0 becomes the identity rotation.
            value[c] = select(select(0.0, 1.0, c == 0u), value[c] * scale, squares > 1e-37);
        }
    }
    for (var c = 0u; c < UNIT; c++) {
        values[tracks.base + unit.x + c] = activated(value[c]);
    }
}

@compute @workgroup_size(WORKGROUP)
fn normalize_quats(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= tracks.count {
        return;
    }
    let quat = raw_quats[id.x];
    let squares = dot(quat, quat);
    let unit = select(vec4<f32>(1.0, 0.0, 0.0, 0.0), quat * inverseSqrt(max(squares, 1e-37)), squares > 1e-37);
    let at = tracks.base + 4u * id.x;
    for (var c = 0u; c < 4u; c++) {
        values[at + c] = unit[c];
    }
}

@compute @workgroup_size(WORKGROUP)
fn hide(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    if i >= tracks.count {
        return;
    }
    let unit = units[i];
    let lives = frame.timestep >= extractBits(unit.x, 0u, 16u) && frame.timestep <= extractBits(unit.x, 16u, 16u);
    if !lives {
        values[tracks.base + i] = 0.0;
    } else if unit.y != MOVES {
        values[tracks.base + i] = bitcast<f32>(unit.y);
    }
}
