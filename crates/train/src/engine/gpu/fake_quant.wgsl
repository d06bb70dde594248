// Backward of fake quantisation; straight-through, learned steps and offsets (fake_quant_vjp on the CPU).
//
// fake_quant_bwd: one workgroup per chunk of up to 1024 members of a group (one attribute, one width). It reads params
// and overwrites grads: gradients to quantised values become gradients to the values themselves. For every component it
// writes one row of quantizer_partials: the sums of (v_step, v_offset), not yet scaled. Q quantizers; N Gaussians.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> params: array<f32>; // [values * N], see packing.rs
@group(0) @binding(2) var<storage, read_write> grads: array<f32>; // [values * N], see packing.rs
@group(0) @binding(3) var<storage, read> members: array<u32>; // Gaussians, group by group, ascending
// [chunks, 2]: first word of the attribute, components, first member, number of members;
// first quantizer, first row, rows from one component to the next, 0
@group(0) @binding(4) var<storage, read> chunks: array<vec4<u32>>;
@group(0) @binding(5) var<storage, read> quantizers: array<vec4<f32>>; // [Q] step, offset, lowest and highest code
@group(0) @binding(6) var<storage, read_write> quantizer_partials: array<vec2<f32>>; // [rows]

var<workgroup> sums: array<vec2<f32>, 256>;

// Half away from zero, as on the CPU; WGSL's round goes to even.
fn round_away(x: f32) -> f32 {
    let size = abs(x);
    let whole = floor(size);
    return sign(x) * (whole + select(0.0, 1.0, size - whole >= 0.5));
}

// (v_x, v_step, v_offset)
fn fake_quant_vjp(x: f32, quantizer: vec4<f32>, v_y: f32) -> vec3<f32> {
    let scaled = (x - quantizer.y) / quantizer.x;
    let low = quantizer.z;
    let high = quantizer.w;
    if (scaled <= low) {
        return vec3<f32>(select(v_y, 0.0, scaled < low), v_y * low, v_y);
    }
    if (scaled >= high) {
        return vec3<f32>(select(v_y, 0.0, scaled > high), v_y * high, v_y);
    }
    return vec3<f32>(v_y, v_y * (round_away(scaled) - scaled), 0.0);
}

@compute @workgroup_size(256)
fn fake_quant_bwd(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    if ((step.flags & QUANTIZED) == 0u) {
        return;
    }
    let values = chunks[2u * group.x];
    let target_rows = chunks[2u * group.x + 1u];
    let components = values.y;
    // A thread keeps to one component; adjacent threads take the components of one member.
    let members_at_once = 256u / components;
    let member = local / components;
    let component = local % components;
    var sum = vec2<f32>(0.0);
    if (member < members_at_once) {
        let quantizer = quantizers[target_rows.x + component];
        for (var i = member; i < values.w; i += members_at_once) {
            let at = values.x + components * members[values.z + i] + component;
            let v = fake_quant_vjp(params[at], quantizer, grads[at]);
            grads[at] = v.x;
            sum += v.yz;
        }
    }
    sums[local] = sum;
    // A tree over members: the upper part of the remaining ones is added to the lower.
    for (var left = members_at_once; left > 1u; left = (left + 1u) / 2u) {
        workgroupBarrier();
        let kept = (left + 1u) / 2u;
        if (member < left - kept) {
            sums[local] = sums[local] + sums[local + kept * components];
        }
    }
    if (local < components) {
        quantizer_partials[target_rows.y + local * target_rows.z] = sums[local];
    }
}
