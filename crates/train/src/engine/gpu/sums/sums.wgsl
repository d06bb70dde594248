
// The last sums of an iteration: the values of its losses, and Adam of cameras and quantizers.
//
// - image_partials [C, blocks]: sums of 1 - SSIM, |x - y|, v_gain, v_offset
// - mask_partials [groups]: sums of sigmoid(mask logit), |mask logit - previous one|
// - prior_partials [rows, 2]: raw sums rigid, rot, iso, floor; background, soft_color, stillness, 0
// - quantizer_partials [rows]: sums of v_step, v_offset
// - quantizer_rows [Q + 1]: first row of each quantizer, and the end
// - quantizers [Q]: step, offset, lowest code, highest code
// - quantizer_state [6, Q]: initial steps, gradient scales, moments (step first, second, offset first, second)
// - cameras [3, 2, K, 3]: values, first, second moments; each gains, then offsets
// - losses [slots, LOSS_VALUES]: value of loss X at LOSS_X; LOSS_STATUS: whether to repeat the iteration; 0 ...
//
// Workgroup 0: image losses and cameras. 1: masks. 2: motion. 3 + q: quantizer q. Each is in a file of its own; one
// dispatch runs all, since none depends on another. Every sum has a fixed order. Functions X_row give rows of partial
// sums, 0 beyond the end. Loops take four rows at once, so that four reads are under way.

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

var<workgroup> sums: array<vec4<f32>, 256>;

fn has(flag: u32) -> bool {
    return (step.flags & flag) != 0u;
}

fn write_loss(position: u32, value: f32) {
    losses[LOSS_VALUES * step.slot + position] = value;
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

// Overwrites one slot of `losses`; moves cameras and quantizers, unless the iteration is to be repeated.
@compute @workgroup_size(256)
fn sums_and_small_adam(@builtin(workgroup_id) block: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    if (block.x == 0u) {
        images_and_cameras(local);
    } else if (block.x == 1u) {
        masks(local);
    } else if (block.x == 2u) {
        motion(local);
    } else if (has(QUANTIZED) && block.x < 3u + step.num_quantizers && status[0] == 0u) {
        move_quantizer(block.x - 3u, local);
    }
}
