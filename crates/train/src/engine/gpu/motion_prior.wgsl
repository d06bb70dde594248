// Losses that keep motion plausible, value and gradient. N Gaussians, F foreground ones (nodes, in the order
// of `nodes`), B background ones.
//
// - prior_begin, once a timestep: reads the poses of the timestep before; writes the reference of the losses.
// - prior_gaussians, one thread per Gaussian: floor, background, soft_color, stillness; packs the nodes' poses for
//   prior_edges.
// - prior_edges, one thread per node: rigid, rot, iso along every edge that leaves or arrives.
//
// The last two accumulate into grads and write partials [ceil(F / 256) + ceil(N / 256), 8]: rigid, rot, iso, floor,
// background, soft_color, stillness, 0. These are sums before any share or weight; rows of prior_edges come first.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> params: array<f32>; // [values * N], see packing.rs
@group(0) @binding(2) var<storage, read_write> grads: array<f32>; // [values * N], see packing.rs
@group(0) @binding(3) var<storage, read_write> partials: array<vec4<f32>>; // [rows, 2]
@group(0) @binding(4) var<storage, read> places: array<u32>; // [N] node, or BACKGROUND + position among them
@group(0) @binding(5) var<storage, read> first: array<vec4<f32>>; // [B, 2] mean and 0; unit rotation
@group(0) @binding(6) var<storage, read> previous_means: array<vec4<f32>>; // [F] mean and 0
@group(0) @binding(7) var<storage, read> previous_inverse_quats: array<vec4<f32>>; // [F] unit
@group(0) @binding(8) var<storage, read> before: array<f32>; // [11 N] means 3N, quats 4N, colours 3N, stillness N
@group(0) @binding(9) var<storage, read> moving: array<vec4<f32>>; // [F, 2] mean and 1 / |quat|; relative rotation
@group(0) @binding(10) var<storage, read> nodes: array<vec4<u32>>; // [F] Gaussian, first link, number of links, 0
@group(0) @binding(11) var<storage, read> links: array<u32>; // see neighbor_lists.rs

// The same buffers for writing: separate bindings let readers cache them as constant.
@group(0) @binding(16) var<storage, read_write> previous_means_out: array<vec4<f32>>;
@group(0) @binding(17) var<storage, read_write> previous_inverse_quats_out: array<vec4<f32>>;
@group(0) @binding(18) var<storage, read_write> moving_out: array<vec4<f32>>;

// Bits of an entry that name its node.
const NODE: u32 = ~(LEAVES | ARRIVES);

// Unit rotations that differ by less differ in their rounding only.
const ROUNDING: f32 = 5e-7;

var<workgroup> sums: array<vec4<f32>, 256>;

// The sum of `value` over the workgroup, in the thread `local` = 0. Every thread must call it.
fn workgroup_sum(local: u32, value: vec4<f32>) -> vec4<f32> {
    sums[local] = value;
    for (var half = 128u; half > 0u; half = half / 2u) {
        workgroupBarrier();
        if (local < half) {
            sums[local] = sums[local] + sums[local + half];
        }
    }
    return sums[local];
}

// Quaternions are w, x, y, z, in this order, in x, y, z, w of a vector.
fn quat_mul(a: vec4<f32>, b: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(a.x * b.x - dot(a.yzw, b.yzw), a.x * b.yzw + b.x * a.yzw + cross(a.yzw, b.yzw));
}

fn quat_conjugate(q: vec4<f32>) -> vec4<f32> {
    return vec4<f32>(q.x, -q.yzw);
}

// `v` turned by a unit quaternion.
fn rotate(q: vec4<f32>, v: vec3<f32>) -> vec3<f32> {
    return v + 2.0 * cross(q.yzw, cross(q.yzw, v) + q.x * v);
}

// 1 / |v|, or 0 for length 0, so that products with it equal the CPU's normalize and its VJP.
fn inverse_length(v: vec4<f32>) -> f32 {
    let length = sqrt(dot(v, v));
    if (length > 0.0) {
        return 1.0 / length;
    }
    return 0.0;
}

fn mean_of(gaussian: u32) -> vec3<f32> {
    let at = MEAN_AT * step.num_gaussians + 3u * gaussian;
    return vec3<f32>(params[at], params[at + 1u], params[at + 2u]);
}

fn quat_of(gaussian: u32) -> vec4<f32> {
    let at = QUAT_AT * step.num_gaussians + 4u * gaussian;
    return vec4<f32>(params[at], params[at + 1u], params[at + 2u], params[at + 3u]);
}

// At the timestep before.
fn mean_before(gaussian: u32) -> vec3<f32> {
    let at = 3u * gaussian;
    return vec3<f32>(before[at], before[at + 1u], before[at + 2u]);
}

// At the timestep before.
fn unit_quat_before(gaussian: u32, num_gaussians: u32) -> vec4<f32> {
    let at = 3u * num_gaussians + 4u * gaussian;
    let quat = vec4<f32>(before[at], before[at + 1u], before[at + 2u], before[at + 3u]);
    return quat * inverse_length(quat);
}

// The sum of absolute differences of two poses. Adds `share` times its gradient.
fn pose_l1(gaussian: u32, moved: vec3<f32>, unit: vec4<f32>, other: vec4<f32>, inverse: f32, share: f32) -> f32 {
    let turned = unit - other;
    add_to_mean(gaussian, share * sign(moved));
    let v_unit = select(vec4<f32>(0.0), share * sign(turned), abs(turned) > vec4<f32>(ROUNDING));
    add_to_quat(gaussian, (v_unit - unit * dot(unit, v_unit)) * inverse);
    return dot(abs(moved), vec3<f32>(1.0)) + dot(abs(turned), vec4<f32>(1.0));
}

fn add_to_mean(gaussian: u32, v: vec3<f32>) {
    let at = MEAN_AT * step.num_gaussians + 3u * gaussian;
    grads[at] = grads[at] + v.x;
    grads[at + 1u] = grads[at + 1u] + v.y;
    grads[at + 2u] = grads[at + 2u] + v.z;
}

fn add_to_quat(gaussian: u32, v: vec4<f32>) {
    let at = QUAT_AT * step.num_gaussians + 4u * gaussian;
    grads[at] = grads[at] + v.x;
    grads[at + 1u] = grads[at + 1u] + v.y;
    grads[at + 2u] = grads[at + 2u] + v.z;
    grads[at + 3u] = grads[at + 3u] + v.w;
}

@compute @workgroup_size(256)
fn prior_begin(@builtin(global_invocation_id) id: vec3<u32>) {
    let gaussian = id.x;
    let num_gaussians = arrayLength(&before) / 11u;
    if (gaussian >= num_gaussians) {
        return;
    }
    let place = places[gaussian];
    if ((place & BACKGROUND) == 0u) {
        previous_means_out[place] = vec4<f32>(mean_before(gaussian), 0.0);
        previous_inverse_quats_out[place] = quat_conjugate(unit_quat_before(gaussian, num_gaussians));
    }
}

@compute @workgroup_size(256)
fn prior_gaussians(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let gaussian = id.x;
    var losses = vec4<f32>(0.0); // floor, background, soft_color, stillness
    if (gaussian < step.num_gaussians) {
        let place = places[gaussian];
        let mean = mean_of(gaussian);
        let quat = quat_of(gaussian);
        let inverse = inverse_length(quat);
        let unit = quat * inverse;
        if ((place & BACKGROUND) == 0u) {
            // Normalised again below: the product has unit length up to rounding, and only a unit rotation keeps
            // lengths of offsets.
            let relative = quat_mul(unit, previous_inverse_quats[place]);
            moving_out[2u * place] = vec4<f32>(mean, inverse);
            moving_out[2u * place + 1u] = relative * inverse_length(relative);
            if (step.floor_weight != 0.0 && mean.y > 0.0) {
                losses.x = mean.y;
                let at = MEAN_AT * step.num_gaussians + 3u * gaussian + 1u;
                grads[at] = grads[at] + step.floor_weight / f32(step.num_foreground);
            }
        } else if (step.background_weight != 0.0) {
            let position = place & ~BACKGROUND;
            let share = step.background_weight / f32(step.num_background);
            let moved = mean - first[2u * position].xyz;
            losses.y = pose_l1(gaussian, moved, unit, first[2u * position + 1u], inverse, share);
        }
        if (step.stillness_weight != 0.0) {
            let stillness = before[10u * step.num_gaussians + gaussian];
            let share = stillness * step.stillness_weight / f32(step.num_gaussians);
            let moved = mean - mean_before(gaussian);
            let other = unit_quat_before(gaussian, step.num_gaussians);
            losses.w = stillness * pose_l1(gaussian, moved, unit, other, inverse, share);
        }
        if (step.soft_color_weight != 0.0) {
            let share = step.soft_color_weight / f32(step.num_gaussians);
            for (var channel = 0u; channel < 3u; channel++) {
                let at = 3u * gaussian + channel;
                let stored = COLOR_AT * step.num_gaussians + at;
                let changed = params[stored] - before[7u * step.num_gaussians + at];
                losses.z += abs(changed);
                grads[stored] = grads[stored] + share * sign(changed);
            }
        }
    }
    let total = workgroup_sum(local, losses);
    if (local == 0u) {
        let row = (step.num_foreground + 255u) / 256u + group.x;
        partials[2u * row] = vec4<f32>(0.0, 0.0, 0.0, total.x);
        partials[2u * row + 1u] = vec4<f32>(total.yzw, 0.0);
    }
}

// Along the edges of node i; returns sums of rigid, rot, iso over those that leave it.
//
// o is the offset of a neighbour, P its offset at the timestep before, R the relative rotation. The residual of rigid
// is taken as o - R P instead of Rᵀo - P, which has the same length. R turns by a small rotation vector d to R + [d]R,
// so the derivative of the residual by the angle is a cross product: -d · (R P × residual).
fn node_edges(i: u32) -> vec4<f32> {
    let node = nodes[i];
    let num_edges = f32(step.num_foreground * step.per_node);
    let rigid_share = step.rigid_weight / num_edges;
    let rot_share = step.rot_weight / num_edges;
    let iso_share = step.iso_weight / num_edges;
    let here = moving[2u * i];
    let relative = moving[2u * i + 1u];
    let previous_mean = previous_means[i].xyz;
    let rotmat = mat3x3<f32>(
        rotate(relative, vec3<f32>(1.0, 0.0, 0.0)),
        rotate(relative, vec3<f32>(0.0, 1.0, 0.0)),
        rotate(relative, vec3<f32>(0.0, 0.0, 1.0)),
    );

    var losses = vec4<f32>(0.0);
    var v_mean = vec3<f32>(0.0);
    var v_angle = vec3<f32>(0.0);
    var v_relative = vec4<f32>(0.0);
    for (var position = 0u; position < node.z; position++) {
        let at = node.y + position * LINK_STRIDE;
        let link = links[at];
        let weight = bitcast<f32>(links[at + SLICE]);
        let distance_before = bitcast<f32>(links[at + 2u * SLICE]);
        let neighbor = link & NODE;
        let leaves = select(0.0, 1.0, (link & LEAVES) != 0u);
        let arrives = select(0.0, 1.0, (link & ARRIVES) != 0u);
        let offset = moving[2u * neighbor].xyz - here.xyz;
        let neighbor_relative = moving[2u * neighbor + 1u];
        let previous_offset = previous_means[neighbor].xyz - previous_mean;

        // rigid, the edge that leaves: the neighbour turned with i; it moves i and turns it.
        let carried = rotmat * previous_offset;
        let residual = offset - carried;
        let square = weight * dot(residual, residual) + ROOT_EPSILON;
        let inverse_root = inverseSqrt(square);
        let v_residual = (leaves * rigid_share * weight * inverse_root) * residual;
        v_angle += cross(v_residual, carried);
        losses.x += leaves * square * inverse_root;

        // rigid, the edge that arrives: i turned with the neighbour. Both ends of it see o and P with the
        // other sign, so the residual as well; it only moves i.
        let back_residual = offset - rotate(neighbor_relative, previous_offset);
        let back_inverse_root = inverseSqrt(weight * dot(back_residual, back_residual) + ROOT_EPSILON);
        v_mean -= v_residual + (arrives * rigid_share * weight * back_inverse_root) * back_residual;

        // rot and iso look the same from both ends.
        let both = leaves + arrives;
        let turn = neighbor_relative - relative;
        let turn_square = weight * dot(turn, turn) + ROOT_EPSILON;
        let turn_inverse_root = inverseSqrt(turn_square);
        v_relative -= (both * rot_share * weight * turn_inverse_root) * turn;
        losses.y += leaves * turn_square * turn_inverse_root;

        let length_square = dot(offset, offset) + ROOT_EPSILON;
        let inverse_distance = inverseSqrt(length_square);
        let stretch = length_square * inverse_distance - distance_before;
        let stretch_square = weight * stretch * stretch + ROOT_EPSILON;
        let stretch_inverse_root = inverseSqrt(stretch_square);
        v_mean -= (both * iso_share * weight * stretch * stretch_inverse_root * inverse_distance) * offset;
        losses.z += leaves * stretch_square * stretch_inverse_root;
    }

    // The tangent of q at the angle d is (0, d) q / 2, so the gradient along that tangent is 2 (0, v_angle) q.
    v_relative += 2.0 * quat_mul(vec4<f32>(0.0, v_angle), relative);
    // normalize_vjp; the product with a unit quaternion changes no angle, so it may as well come after.
    let v_across = v_relative - relative * dot(relative, v_relative);
    add_to_mean(node.x, v_mean);
    add_to_quat(node.x, quat_mul(v_across, quat_conjugate(previous_inverse_quats[i])) * here.w);
    return losses;
}

@compute @workgroup_size(256)
fn prior_edges(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let is_on = step.rigid_weight != 0.0 || step.rot_weight != 0.0 || step.iso_weight != 0.0;
    var losses = vec4<f32>(0.0);
    if (is_on && id.x < step.num_foreground) {
        losses = node_edges(id.x);
    }
    let total = workgroup_sum(local, losses);
    if (local == 0u) {
        partials[2u * group.x] = vec4<f32>(total.xyz, 0.0);
        partials[2u * group.x + 1u] = vec4<f32>(0.0);
    }
}
