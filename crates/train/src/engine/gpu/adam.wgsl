
// Adam of all values of the active Gaussians, the first ones, in place.
//
// params, first_moments, second_moments, grads: columns of COMPONENTS values per Gaussian, the last one mask logits;
// see packing.rs.
//
// One thread updates four values, one workgroup BLOCK neighbouring values of one attribute. Neighbouring threads
// therefore access neighbouring values, and a group whose step size is 0 returns at once.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read_write> params: array<f32>;
@group(0) @binding(2) var<storage, read> grads: array<f32>;
@group(0) @binding(3) var<storage, read_write> first_moments: array<f32>;
@group(0) @binding(4) var<storage, read_write> second_moments: array<f32>;
@group(0) @binding(5) var<storage, read> status: array<u32>;

var<workgroup> squares: array<f32, 256>;

@compute @workgroup_size(256)
fn adam(@builtin(workgroup_id) id: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    var which = 0u;
    var before = 0u;
    var block = id.y * MAX_GROUPS_X + id.x;
    var len = COMPONENTS[0] * step.num_active;
    while (which < ADAM_MASK && block >= (len + BLOCK - 1u) / BLOCK) {
        block -= (len + BLOCK - 1u) / BLOCK;
        before += COMPONENTS[which] * step.num_gaussians;
        which += 1u;
        len = COMPONENTS[which] * step.num_active;
    }
    let rates = step.adam[which].xyz;
    let needed = select(MOVES, MOVES | MASKED, which == ADAM_MASK);
    let moves = (step.flags & needed) == needed && rates.x != 0.0;
    // Codes are those of unit quaternions.
    let normalizes = which == ADAM_QUAT && (step.flags & QUANTIZED) != 0u;
    if (status[0] != 0u || !(moves || normalizes)) {
        return;
    }
    for (var turn = 0u; turn < BLOCK / 256u; turn += 1u) {
        let j = block * BLOCK + turn * 256u + local;
        let i = before + j;
        var x = 0.0;
        if (j < len) {
            x = params[i];
            if (moves) {
                let moved = adam_moved(vec3(x, first_moments[i], second_moments[i]), grads[i], rates);
                x = moved.x;
                first_moments[i] = moved.y;
                second_moments[i] = moved.z;
            }
        }
        if (normalizes) {
            squares[local] = x * x;
            workgroupBarrier();
            let row = local / 4u * 4u;
            let length = sqrt(squares[row] + squares[row + 1u] + squares[row + 2u] + squares[row + 3u]);
            x = select(x, x / length, length > 0.0);
            workgroupBarrier();
        }
        if (j < len) {
            params[i] = x;
        }
    }
}
