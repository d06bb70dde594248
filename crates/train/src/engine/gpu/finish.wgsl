
// The end of an iteration: sums of losses, and Adam of the few values that are not the Gaussians'.
//
// image_partials [C, blocks]: sums of 1 - SSIM, |x - y|, v_gain, v_offset
// mask_partials [groups]: sums of sigmoid(mask logit), |mask logit - previous one|
// prior_partials [rows, 2]: raw sums rigid, rot, iso, floor; background, soft_color, 0, 0
// quantizer_partials [rows]: sums of v_step, v_offset; quantizer_rows [Q + 1]: first row of each quantizer, and the end
// quantizers [Q]: step, offset, lowest code, highest code
// quantizer_state [6, Q]: initial steps, gradient scales, moments (step first, second, offset first, second)
// cameras [3, 2, K, 3]: values, first, second moments; each gains, then offsets
// losses [slots, LOSS_VALUES]: image, segmentation, rigid, rot, iso, floor, background, soft_color, mask,
//     mask_consistency, status, 0 ...
//
// Workgroup 0: image losses and cameras. 1: masks. 2: motion. 3 + q: quantizer q. Every sum has one order.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> image_partials: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> mask_partials: array<vec2<f32>>;
@group(0) @binding(3) var<storage, read> prior_partials: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read> quantizer_partials: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read> quantizer_rows: array<u32>;
@group(0) @binding(6) var<storage, read_write> quantizers: array<vec4<f32>>;
@group(0) @binding(7) var<storage, read_write> quantizer_state: array<f32>;
@group(0) @binding(8) var<storage, read_write> cameras: array<f32>;
@group(0) @binding(9) var<storage, read_write> losses: array<f32>;
@group(0) @binding(10) var<storage, read> status: array<u32>;

const GAINS: u32 = 6u;
const STEPS: u32 = 8u;
const OFFSETS: u32 = 9u;

var<workgroup> sums: array<vec4<f32>, 256>;

fn has(flag: u32) -> bool {
    return (step.flags & flag) != 0u;
}

fn write_loss(position: u32, value: f32) {
    losses[LOSS_VALUES * step.slot + position] = value;
}

// Rows beyond the end are zero. Loops take four at once, so that four reads are under way.
fn image_row(i: u32, end: u32) -> vec4<f32> {
    if (i < end) {
        return image_partials[i];
    }
    return vec4(0.0);
}

fn mask_row(i: u32, end: u32) -> vec4<f32> {
    if (i < end) {
        return vec4(mask_partials[i], 0.0, 0.0);
    }
    return vec4(0.0);
}

fn prior_row(half: u32, i: u32, end: u32) -> vec4<f32> {
    if (i < end) {
        return prior_partials[2u * i + half];
    }
    return vec4(0.0);
}

fn quantizer_row(i: u32, end: u32) -> vec4<f32> {
    if (i < end) {
        return vec4(quantizer_partials[i], 0.0, 0.0);
    }
    return vec4(0.0);
}

// The sum of every thread's value, told to all.
fn total(value: vec4<f32>, local: u32) -> vec4<f32> {
    sums[local] = value;
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (local < half) {
            sums[local] += sums[local + half];
        }
        workgroupBarrier();
    }
    let sum = sums[0];
    workgroupBarrier();
    return sum;
}

fn images_and_cameras(local: u32) {
    let blocks = ((step.width + SIDE - 1u) / SIDE) * ((step.height + SIDE - 1u) / SIDE);
    let channels = select(3u, 5u, has(SEGMENTED));
    var image = vec2(0.0);
    var segmentation = vec2(0.0);
    var v_gain = vec3(0.0);
    var v_offset = vec3(0.0);
    for (var channel = 0u; channel < channels; channel += 1u) {
        let end = (channel + 1u) * blocks;
        var own = vec4(0.0);
        for (var i = channel * blocks + local; i < end; i += 1024u) {
            own += (image_row(i, end) + image_row(i + 256u, end)) + (image_row(i + 512u, end) + image_row(i + 768u, end));
        }
        let sum = total(own, local);
        if (channel < 3u) {
            image += sum.xy;
            v_gain[channel] = sum.z;
            v_offset[channel] = sum.w;
        } else {
            segmentation += sum.xy;
        }
    }
    if (local == 0u) {
        let counted = COUNTED_CHANNELS * f32(step.width * step.height);
        let shares = vec2(1.0 - L1_SHARE, L1_SHARE) / counted;
        write_loss(0u, dot(shares, image));
        write_loss(1u, dot(shares, segmentation));
        write_loss(10u, f32(status[0]));
        for (var i = 11u; i < LOSS_VALUES; i += 1u) {
            write_loss(i, 0.0);
        }
    }
    if (status[0] != 0u) {
        return;
    }
    // The other cameras have a gradient of zero rather than none.
    let num = 3u * step.num_cameras;
    for (var i = local; i < 2u * num; i += 256u) {
        let kind = i / num;
        let rates = step.adam[GAINS + kind].xy;
        var v = 0.0;
        if (i % num / 3u == step.camera) {
            v = select(v_gain, v_offset, kind == 1u)[i % 3u];
        }
        if (rates.x != 0.0) {
            let moved = adam_moved(vec3(cameras[i], cameras[2u * num + i], cameras[4u * num + i]), v, rates);
            cameras[i] = moved.x;
            cameras[2u * num + i] = moved.y;
            cameras[4u * num + i] = moved.z;
        }
    }
}

fn masks(local: u32) {
    let end = (step.num_gaussians + 255u) / 256u;
    var own = vec4(0.0);
    for (var i = local; i < end; i += 1024u) {
        own += (mask_row(i, end) + mask_row(i + 256u, end)) + (mask_row(i + 512u, end) + mask_row(i + 768u, end));
    }
    let means = total(own, local).xy / f32(max(step.num_gaussians, 1u));
    if (local == 0u) {
        write_loss(8u, select(0.0, means.x, has(MASKED)));
        write_loss(9u, select(0.0, means.y, has(MASKED) && has(COMPARES_MASKS)));
    }
}

// A mean over `count`, or 0 if the loss is off or about nothing.
fn mean(sum: f32, count: u32, is_on: bool) -> f32 {
    return select(0.0, sum / f32(max(count, 1u)), is_on && count > 0u);
}

fn prior(local: u32) {
    let rows = (step.num_foreground + 255u) / 256u + (step.num_gaussians + 255u) / 256u;
    let end = select(0u, rows, has(HAS_PRIOR));
    var own_low = vec4(0.0);
    var own_high = vec4(0.0);
    for (var i = local; i < end; i += 1024u) {
        own_low += (prior_row(0u, i, end) + prior_row(0u, i + 256u, end))
            + (prior_row(0u, i + 512u, end) + prior_row(0u, i + 768u, end));
        own_high += (prior_row(1u, i, end) + prior_row(1u, i + 256u, end))
            + (prior_row(1u, i + 512u, end) + prior_row(1u, i + 768u, end));
    }
    let low = total(own_low, local);
    let high = total(own_high, local);
    if (local == 0u) {
        // The three losses among neighbours are on together.
        let among_neighbors = step.rigid_weight != 0.0 || step.rot_weight != 0.0 || step.iso_weight != 0.0;
        let num_edges = step.num_foreground * step.per_node;
        write_loss(2u, mean(low.x, num_edges, among_neighbors));
        write_loss(3u, mean(low.y, num_edges, among_neighbors));
        write_loss(4u, mean(low.z, num_edges, among_neighbors));
        write_loss(5u, mean(low.w, step.num_foreground, step.floor_weight != 0.0));
        write_loss(6u, mean(high.x, step.num_background, step.background_weight != 0.0));
        write_loss(7u, mean(high.y, step.num_gaussians, step.soft_color_weight != 0.0));
    }
}

fn move_quantizer(q: u32, local: u32) {
    let end = quantizer_rows[q + 1u];
    var own = vec4(0.0);
    for (var i = quantizer_rows[q] + local; i < end; i += 1024u) {
        own += (quantizer_row(i, end) + quantizer_row(i + 256u, end))
            + (quantizer_row(i + 512u, end) + quantizer_row(i + 768u, end));
    }
    let sum = total(own, local);
    if (local != 0u) {
        return;
    }
    let num = step.num_quantizers;
    let initial = quantizer_state[q];
    let v = sum.xy * quantizer_state[num + q];
    // Adam's update does not depend on the gradient's scale, so relative values give relative rates.
    var rates = step.adam[STEPS].xy;
    if (rates.x != 0.0) {
        let at = 2u * num + q;
        let state = vec3(quantizers[q].x / initial, quantizer_state[at], quantizer_state[at + num]);
        let moved = adam_moved(state, v.x, rates);
        quantizers[q].x = max(moved.x, step.step_min_share) * initial;
        quantizer_state[at] = moved.y;
        quantizer_state[at + num] = moved.z;
    }
    rates = step.adam[OFFSETS].xy;
    if (rates.x != 0.0 && has(LEARNED_OFFSET)) {
        let at = 4u * num + q;
        let state = vec3(quantizers[q].y / initial, quantizer_state[at], quantizer_state[at + num]);
        let moved = adam_moved(state, v.y, rates);
        quantizers[q].y = moved.x * initial;
        quantizer_state[at] = moved.y;
        quantizer_state[at + num] = moved.z;
    }
}

// Overwrites one slot of `losses`; moves cameras and quantizers, unless the iteration is to be repeated.
@compute @workgroup_size(256)
fn finish(@builtin(workgroup_id) block: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    if (block.x == 0u) {
        images_and_cameras(local);
    } else if (block.x == 1u) {
        masks(local);
    } else if (block.x == 2u) {
        prior(local);
    } else if (has(QUANTIZED) && block.x < 3u + step.num_quantizers && status[0] == 0u) {
        move_quantizer(block.x - 3u, local);
    }
}
