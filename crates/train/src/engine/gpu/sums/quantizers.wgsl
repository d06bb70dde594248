// Adam of one quantizer's step and offset.

fn quantizer_row(i: u32, end: u32) -> vec4<f32> {
    if (i < end) {
        return vec4(quantizer_partials[i], 0.0, 0.0);
    }
    return vec4(0.0);
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
    var rates = step.adam[ADAM_STEPS].xyz;
    if (rates.x != 0.0) {
        let at = 2u * num + q;
        let state = vec3(quantizers[q].x / initial, quantizer_state[at], quantizer_state[at + num]);
        let moved = adam_moved(state, v.x, rates);
        quantizers[q].x = max(moved.x, step.step_min_share) * initial;
        quantizer_state[at] = moved.y;
        quantizer_state[at + num] = moved.z;
    }
    rates = step.adam[ADAM_QUANTIZER_OFFSETS].xyz;
    if (rates.x != 0.0 && has(LEARNED_OFFSET)) {
        let at = 4u * num + q;
        let state = vec3(quantizers[q].y / initial, quantizer_state[at], quantizer_state[at + num]);
        let moved = adam_moved(state, v.y, rates);
        quantizers[q].y = moved.x * initial;
        quantizer_state[at] = moved.y;
        quantizer_state[at + num] = moved.z;
    }
}
