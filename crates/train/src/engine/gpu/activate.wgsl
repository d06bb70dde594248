
// From stored values to what is drawn, and back.
//
// N Gaussians are in the state, D are drawn; the state's are the first of these. C = 5 with segmentation (foreground
// and background after the colours), else 3.
//
// - params, grads: columns of the stored form, then mask logits; column X begins at X_AT times N, see packing.rs
// - activated [(11 + C) D], v_activated [(11 + C) N]: means, unit quats, scales, opacities, colors [N, C]; column X
//   begins at X_AT times D or N, see activated.rs of tcgs-render
// - flags [N]: bit 0 is foreground
// - quantizer_groups [words, N]: bytes are groups of the quantised columns; that of column X is X_BYTE
// - group_starts [256]: a group's first quantizer, which is that of its first component
// - quantizers [Q]: step, offset, lowest code, highest code
// - mask_partials [groups, 2]: sums of sigmoid(mask logit) and of |mask logit - previous one|
// - v_means2d_ndc [N, 3]: x, y, visible
// - statistic [2 N]: sums of norms, then counts
//
// One thread per Gaussian where the components of a row interact, and one per value elsewhere, so that neighbouring
// threads write neighbouring values.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> params: array<f32>;
@group(0) @binding(2) var<storage, read> flags: array<u32>;
@group(0) @binding(3) var<storage, read> quantizer_groups: array<u32>;
@group(0) @binding(4) var<storage, read> group_starts: array<u32>;
@group(0) @binding(5) var<storage, read> quantizers: array<vec4<f32>>;
@group(0) @binding(6) var<storage, read_write> activated: array<f32>;
@group(0) @binding(7) var<storage, read> v_activated: array<f32>;
@group(0) @binding(8) var<storage, read> previous_mask_logits: array<f32>;
@group(0) @binding(9) var<storage, read_write> grads: array<f32>;
@group(0) @binding(10) var<storage, read_write> mask_partials: array<vec2<f32>>;
@group(0) @binding(11) var<storage, read> v_means2d_ndc: array<f32>;
@group(0) @binding(12) var<storage, read_write> statistic: array<f32>;
@group(0) @binding(13) var<storage, read> status: array<u32>;

var<workgroup> quats: array<vec4<f32>, 256>;
var<workgroup> masks: array<f32, 256>;
var<workgroup> v_log_scales: array<f32, 768>;
var<workgroup> sums: array<vec2<f32>, 256>;

fn has(flag: u32) -> bool {
    return (step.flags & flag) != 0u;
}

// A stored value of Gaussian `n`, quantised if that is on.
fn stored(index: u32, n: u32, byte: u32, component: u32) -> f32 {
    let x = params[index];
    if (!has(QUANTIZED)) {
        return x;
    }
    let word = quantizer_groups[(byte / GROUPS_A_WORD) * step.num_gaussians + n];
    let group = (word >> (8u * (byte % GROUPS_A_WORD))) & 255u;
    return fake_quant(x, quantizers[group_starts[group] + component]);
}

fn stored_quat(n: u32) -> vec4<f32> {
    let first = QUAT_AT * step.num_gaussians + 4u * n;
    return vec4(
        stored(first, n, QUAT_BYTE, 0u),
        stored(first + 1u, n, QUAT_BYTE, 1u),
        stored(first + 2u, n, QUAT_BYTE, 2u),
        stored(first + 3u, n, QUAT_BYTE, 3u),
    );
}

// Beyond 80 the result is 0 or 1 to the last bit, and exp would leave its range.
fn sigmoid(x: f32) -> f32 {
    return 1.0 / (1.0 + exp(-clamp(x, -80.0, 80.0)));
}

fn hash(x: u32) -> u32 {
    let state = x * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

// The factor of a Gaussian's opacity; twin of `Dropout::factor`.
fn dropout(n: u32) -> f32 {
    let unit = f32(hash(n + hash(step.drop_draw)) >> 8u) / 16777216.0;
    return select(1.0 / (1.0 - step.drop_share), 0.0, unit < step.drop_share);
}

fn num_channels() -> u32 {
    return select(3u, 5u, has(SEGMENTED));
}

// Overwrites `activated`.
@compute @workgroup_size(256)
fn activate_fwd(@builtin(workgroup_id) block: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let num = step.num_gaussians;
    let drawn = step.num_drawn;
    let first = block.x * 256u;
    let n = first + local;
    if (n < num) {
        let quat = stored_quat(n);
        let length = sqrt(dot(quat, quat));
        quats[local] = select(quat, quat / length, length > 0.0);
        var mask = 1.0;
        if (has(MASKED)) {
            mask = select(0.0, 1.0, sigmoid(params[MASK_AT * num + n]) > step.mask_threshold);
        }
        masks[local] = mask;
        let opacity = sigmoid(stored(LOGIT_OPACITY_AT * num + n, n, LOGIT_OPACITY_BYTE, 0u));
        activated[OPACITIES_AT * drawn + n] = dropout(n) * mask * opacity;
    }
    workgroupBarrier();
    for (var j = local; j < 768u; j += 256u) {
        let i = 3u * first + j;
        let row = j / 3u;
        if (i < 3u * num) {
            activated[MEANS_AT * drawn + i] = params[MEAN_AT * num + i];
            let log_scale = stored(LOG_SCALE_AT * num + i, first + row, LOG_SCALE_BYTE, j % 3u);
            activated[SCALES_AT * drawn + i] = masks[row] * exp(log_scale);
        }
    }
    for (var j = local; j < 1024u; j += 256u) {
        let i = 4u * first + j;
        if (i < 4u * num) {
            activated[QUATS_AT * drawn + i] = quats[j / 4u][j % 4u];
        }
    }
    let channels = num_channels();
    for (var j = local; j < 256u * channels; j += 256u) {
        let i = channels * first + j;
        if (i < channels * num) {
            let row = first + j / channels;
            let channel = j % channels;
            var value = 0.0;
            if (channel < 3u) {
                value = stored(COLOR_AT * num + 3u * row + channel, row, COLOR_BYTE, channel);
            } else {
                value = select(0.0, 1.0, (flags[row] & 1u) == 4u - channel);
            }
            activated[COLORS_AT * drawn + i] = value;
        }
    }
}

// Gradient to a mask's logit of the losses on masks alone, and their values. Paper Eq. 4 and 5, as means.
fn mask_losses(logit: f32, mask: f32, n: u32, values: ptr<function, vec2<f32>>) -> f32 {
    let share = 1.0 / f32(step.num_gaussians);
    (*values).x = mask;
    var v = step.mask_weight * share * mask * (1.0 - mask);
    if (has(COMPARES_MASKS)) {
        let difference = logit - previous_mask_logits[n];
        (*values).y = abs(difference);
        v += step.mask_consistency_weight * share * sign(difference);
    }
    return v;
}

// Overwrites `grads` with gradients to the quantised stored values, and `mask_partials`.
@compute @workgroup_size(256)
fn activate_bwd(@builtin(workgroup_id) block: vec3<u32>, @builtin(local_invocation_index) local: u32) {
    let num = step.num_gaussians;
    let first = block.x * 256u;
    let n = first + local;
    var losses = vec2(0.0);
    if (n < num) {
        let quat = stored_quat(n);
        let at = QUATS_AT * num + 4u * n;
        let v_unit = vec4(v_activated[at], v_activated[at + 1u], v_activated[at + 2u], v_activated[at + 3u]);
        let length = sqrt(dot(quat, quat));
        let unit = quat / length;
        quats[local] = select(vec4(0.0), (v_unit - unit * dot(unit, v_unit)) / length, length > 0.0);

        // Scale and opacity as they were before the mask, and without dropout.
        let opacity = sigmoid(stored(LOGIT_OPACITY_AT * num + n, n, LOGIT_OPACITY_BYTE, 0u));
        let v_opacity = dropout(n) * v_activated[OPACITIES_AT * num + n];
        let row = LOG_SCALE_AT * num + 3u * n;
        let v_row = SCALES_AT * num + 3u * n;
        let v_log_scale = vec3(
            exp(stored(row, n, LOG_SCALE_BYTE, 0u)) * v_activated[v_row],
            exp(stored(row + 1u, n, LOG_SCALE_BYTE, 1u)) * v_activated[v_row + 1u],
            exp(stored(row + 2u, n, LOG_SCALE_BYTE, 2u)) * v_activated[v_row + 2u],
        );
        var drawn = 1.0;
        var v_mask_logit = 0.0;
        if (has(MASKED)) {
            let logit = params[MASK_AT * num + n];
            let mask = sigmoid(logit);
            drawn = select(0.0, 1.0, mask > step.mask_threshold);
            // Straight through the threshold: the gradient is the sigmoid's.
            let v_mask = v_log_scale.x + v_log_scale.y + v_log_scale.z + opacity * v_opacity;
            v_mask_logit = v_mask * mask * (1.0 - mask) + mask_losses(logit, mask, n, &losses);
        }
        grads[MASK_AT * num + n] = v_mask_logit;
        grads[LOGIT_OPACITY_AT * num + n] = drawn * v_opacity * opacity * (1.0 - opacity);
        v_log_scales[3u * local] = drawn * v_log_scale.x;
        v_log_scales[3u * local + 1u] = drawn * v_log_scale.y;
        v_log_scales[3u * local + 2u] = drawn * v_log_scale.z;
    }
    sums[local] = losses;
    workgroupBarrier();
    let channels = num_channels();
    for (var j = local; j < 768u; j += 256u) {
        let i = 3u * first + j;
        if (i < 3u * num) {
            grads[MEAN_AT * num + i] = v_activated[MEANS_AT * num + i];
            grads[LOG_SCALE_AT * num + i] = v_log_scales[j];
            grads[COLOR_AT * num + i] = v_activated[COLORS_AT * num + channels * (first + j / 3u) + j % 3u];
        }
    }
    for (var j = local; j < 1024u; j += 256u) {
        let i = 4u * first + j;
        if (i < 4u * num) {
            grads[QUAT_AT * num + i] = quats[j / 4u][j % 4u];
        }
    }
    // Nothing draws the further columns; losses may add to their gradients later.
    for (var j = local; j < 256u * FURTHER_VALUES; j += 256u) {
        let i = FURTHER_VALUES * first + j;
        if (i < FURTHER_VALUES * num) {
            grads[FURTHER_AT * num + i] = 0.0;
        }
    }
    for (var half = 128u; half > 0u; half /= 2u) {
        if (local < half) {
            sums[local] += sums[local + half];
        }
        workgroupBarrier();
    }
    if (local == 0u) {
        mask_partials[block.x] = sums[0];
    }
}

// Accumulates `statistic`, unless the iteration is to be repeated.
@compute @workgroup_size(256)
fn count_gradients(@builtin(global_invocation_id) id: vec3<u32>) {
    let n = id.x;
    let num = step.num_gaussians;
    if (n >= num || !has(COUNTS) || status[0] != 0u || v_means2d_ndc[3u * n + 2u] == 0.0) {
        return;
    }
    statistic[n] += length(vec2(v_means2d_ndc[3u * n], v_means2d_ndc[3u * n + 1u]));
    statistic[num + n] += 1.0;
}
