// Means of the losses on masks.

fn mask_row(i: u32, end: u32) -> vec4<f32> {
    if (i < end) {
        return vec4(mask_partials[i], 0.0, 0.0);
    }
    return vec4(0.0);
}

fn masks(local: u32) {
    let end = (step.num_gaussians + 255u) / 256u;
    var own = vec4(0.0);
    for (var i = local; i < end; i += 1024u) {
        own += (mask_row(i, end) + mask_row(i + 256u, end)) + (mask_row(i + 512u, end) + mask_row(i + 768u, end));
    }
    let means = total(own, local).xy / f32(max(step.num_gaussians, 1u));
    if (local == 0u) {
        write_loss(LOSS_MASK, select(0.0, means.x, has(MASKED)));
        write_loss(LOSS_MASK_CONSISTENCY, select(0.0, means.y, has(MASKED) && has(COMPARES_MASKS)));
    }
}
