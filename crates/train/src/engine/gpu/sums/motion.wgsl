// Means of the losses on motion.

fn prior_row(half: u32, i: u32, end: u32) -> vec4<f32> {
    if (i < end) {
        return prior_partials[2u * i + half];
    }
    return vec4(0.0);
}

// A mean over `count`, or 0 if the loss is off or has no members.
fn mean(sum: f32, count: u32, is_on: bool) -> f32 {
    return select(0.0, sum / f32(max(count, 1u)), is_on && count > 0u);
}

fn motion(local: u32) {
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
        write_loss(LOSS_RIGID, mean(low.x, num_edges, among_neighbors));
        write_loss(LOSS_ROT, mean(low.y, num_edges, among_neighbors));
        write_loss(LOSS_ISO, mean(low.z, num_edges, among_neighbors));
        write_loss(LOSS_FLOOR, mean(low.w, step.num_foreground, step.floor_weight != 0.0));
        write_loss(LOSS_BACKGROUND, mean(high.x, step.num_background, step.background_weight != 0.0));
        write_loss(LOSS_STILLNESS, mean(high.z, step.num_gaussians, step.stillness_weight != 0.0));
        write_loss(LOSS_SOFT_COLOR, mean(high.y, step.num_gaussians, step.soft_color_weight != 0.0));
    }
}
