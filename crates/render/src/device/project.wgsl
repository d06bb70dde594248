// Projection of Gaussians to splats, and its vector-Jacobian product.
//
// project_fwd: one thread per listed Gaussian; keys and values are at its place in the list.
// - reads activated [(11 + C) N]: means, unit quats (w, x, y, z), scales, opacities, colors
// - writes splats [2 N]: (mean2d, conic xx, xy), (conic yy, opacity, tile columns, tile rows); ranges are first | end
//   << 16
// - writes keys [L]: bits of the depth, NO_DEPTH if no tile is reached; values [L]: the Gaussian's index
// - writes tile_counts [N]: number of drawn tiles reached, and VISIBLE if the splat's bounds hold a pixel
//
// project_bwd: one thread per row of gradients (R rows, of the first Gaussians); adds up its pairs and takes the sums
// back through the projection.
// - reads activated; tile_counts; pair_first [N]; v_pairs [pairs, PAIR_GRADS + C]
// - writes v_activated [(11 + C) R]; v_means2d_ndc [3 R]: the statistic's x, y, and 1 where visible

@group(0) @binding(1) var<storage, read> activated: array<f32>;
@group(0) @binding(2) var<storage, read_write> splats: array<vec4<u32>>;
@group(0) @binding(3) var<storage, read_write> keys: array<u32>;
@group(0) @binding(4) var<storage, read_write> values: array<u32>;
@group(0) @binding(5) var<storage, read_write> tile_counts: array<u32>;
@group(0) @binding(6) var<storage, read> pair_first: array<u32>;
@group(0) @binding(7) var<storage, read> v_pairs: array<f32>;
@group(0) @binding(8) var<storage, read_write> v_activated: array<f32>;
@group(0) @binding(9) var<storage, read_write> v_means2d_ndc: array<f32>;

const NO_DEPTH: u32 = 0xffffffffu;

fn load3(at: u32) -> vec3<f32> {
    return vec3<f32>(activated[at], activated[at + 1u], activated[at + 2u]);
}

fn load_quat(i: u32) -> vec4<f32> {
    let at = QUATS_AT * view.num_gaussians + 4u * i;
    return vec4<f32>(activated[at], activated[at + 1u], activated[at + 2u], activated[at + 3u]);
}

// Rows of the rotation matrix of a unit quaternion.
fn rotmat_from_quat(q: vec4<f32>) -> array<vec3<f32>, 3> {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    return array<vec3<f32>, 3>(
        vec3<f32>(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        vec3<f32>(2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        vec3<f32>(2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
}

// Values that forward and backward share; see `ProjectionChain` in project.rs.
struct Chain {
    ok: bool,
    point: vec3<f32>,
    slope: vec2<f32>,
    clamped: vec2<bool>,
    rotmat: array<vec3<f32>, 3>,
    factor: array<vec3<f32>, 3>,
    u: vec3<f32>,
    v: vec3<f32>,
    covariance: vec3<f32>,
    conic: vec3<f32>,
}

fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn project(mean: vec3<f32>, quat: vec4<f32>, scale: vec3<f32>) -> Chain {
    var c: Chain;
    c.ok = false;
    c.point = vec3<f32>(
        dot(view.rows[0].xyz, mean) + view.rows[0].w,
        dot(view.rows[1].xyz, mean) + view.rows[1].w,
        dot(view.rows[2].xyz, mean) + view.rows[2].w,
    );
    let depth = c.point.z;
    if !(depth > NEAR) || !is_finite(depth) {
        return c;
    }
    c.rotmat = rotmat_from_quat(quat);
    for (var i = 0u; i < 3u; i++) {
        let w = view.rows[i].xyz;
        c.factor[i] = (w.x * c.rotmat[0] + w.y * c.rotmat[1] + w.z * c.rotmat[2]) * scale;
    }
    let raw = c.point.xy / depth;
    c.slope = clamp(raw, view.slope_min, view.slope_max);
    c.clamped = c.slope != raw;
    let per_depth = view.focal / depth;
    c.u = per_depth.x * (c.factor[0] - c.slope.x * c.factor[2]);
    c.v = per_depth.y * (c.factor[1] - c.slope.y * c.factor[2]);
    c.covariance = vec3<f32>(dot(c.u, c.u) + BLUR_VARIANCE, dot(c.u, c.v), dot(c.v, c.v) + BLUR_VARIANCE);
    let determinant = c.covariance.x * c.covariance.z - c.covariance.y * c.covariance.y;
    c.conic = vec3<f32>(c.covariance.z, -c.covariance.y, c.covariance.x) / determinant;
    c.ok = determinant > 0.0 && is_finite(determinant);
    return c;
}

// Half-open range of pixels whose centre lies within center +- extent, inside 0..size.
fn pixel_range(center: f32, extent: f32, size: u32) -> vec2<u32> {
    let first = clamp(ceil(center - extent - 0.5), 0.0, f32(size));
    let end = clamp(floor(center + extent - 0.5) + 1.0, 0.0, f32(size));
    return vec2<u32>(u32(first), u32(end));
}

// Share of its opacity that a splat keeps; see project.rs.
fn kept_opacity(c: Chain) -> f32 {
    if view.antialiased == 0u {
        return 1.0;
    }
    let normal = cross(c.u, c.v);
    let determinant = c.covariance.x * c.covariance.z - c.covariance.y * c.covariance.y;
    return sqrt(min(dot(normal, normal) / determinant, 1.0));
}

@compute @workgroup_size(WORKGROUP)
fn project_fwd(@builtin(global_invocation_id) id: vec3<u32>) {
    let place = id.x;
    let n = view.num_gaussians;
    if place >= view.num_listed {
        return;
    }
    let i = gaussian_at(place);
    keys[place] = NO_DEPTH;
    values[place] = i;
    tile_counts[i] = 0u;
    let full_opacity = activated[OPACITIES_AT * n + i];
    if !(full_opacity >= MIN_ALPHA) || !is_finite(full_opacity) {
        return;
    }
    let c = project(load3(3u * i), load_quat(i), load3(SCALES_AT * n + 3u * i));
    if !c.ok {
        return;
    }
    let opacity = full_opacity * kept_opacity(c);
    if opacity < MIN_ALPHA {
        return;
    }
    let mean2d = view.focal * c.point.xy / c.point.z + view.principal;
    if !is_finite(mean2d.x) || !is_finite(mean2d.y) {
        return;
    }
    let limit = reach(opacity);
    let extent = sqrt(2.0 * limit * c.covariance.xz) * EXTENT_FACTOR + EXTENT_MARGIN_PX;
    let columns = pixel_range(mean2d.x, extent.x, view.size.x);
    let rows = pixel_range(mean2d.y, extent.y, view.size.y);
    if columns.x >= columns.y || rows.x >= rows.y {
        return;
    }
    let tile_columns = vec2<u32>(columns.x / TILE, (columns.y + TILE - 1u) / TILE);
    let tile_rows = vec2<u32>(rows.x / TILE, (rows.y + TILE - 1u) / TILE);
    var count = 0u;
    for (var row = tile_rows.x; row < tile_rows.y; row++) {
        for (var column = tile_columns.x; column < tile_columns.y; column++) {
            let tile = vec2<u32>(column, row);
            count += u32(slot_of(tile) < view.num_tiles && reaches_tile(mean2d, c.conic, limit, tile));
        }
    }
    splats[2u * i] = bitcast<vec4<u32>>(vec4<f32>(mean2d, c.conic.xy));
    splats[2u * i + 1u] = vec4<u32>(
        bitcast<u32>(c.conic.z),
        bitcast<u32>(opacity),
        tile_columns.x | (tile_columns.y << 16u),
        tile_rows.x | (tile_rows.y << 16u),
    );
    tile_counts[i] = count | VISIBLE;
    if count > 0u {
        keys[place] = bitcast<u32>(c.point.z);
    }
}

@compute @workgroup_size(WORKGROUP)
fn project_bwd(@builtin(global_invocation_id) id: vec3<u32>) {
    let i = id.x;
    let n = view.num_gaussians;
    if i >= view.num_rows {
        return;
    }
    let visible = (tile_counts[i] & VISIBLE) != 0u;
    var count = tile_counts[i] & ~VISIBLE;
    var first = 0u;
    if i >= view.num_active {
        count = 0u; // a row that is held
    }
    if count > 0u {
        first = pair_first[i];
        if first > view.pair_capacity || count > view.pair_capacity - first {
            count = 0u; // an iteration that is to be repeated
        }
    }
    var v_mean2d = vec2<f32>();
    var v_conic = vec3<f32>();
    var v_opacity = 0.0;
    var statistic = vec2<f32>();
    var v_color: array<f32, CHANNELS>;
    for (var c = 0u; c < CHANNELS; c++) {
        v_color[c] = 0.0;
    }
    for (var pair = first; pair < first + count; pair++) {
        let at = pair * (PAIR_GRADS + CHANNELS);
        v_mean2d += vec2<f32>(v_pairs[at], v_pairs[at + 1u]);
        v_conic += vec3<f32>(v_pairs[at + 2u], v_pairs[at + 3u], v_pairs[at + 4u]);
        v_opacity += v_pairs[at + 5u];
        statistic += vec2<f32>(v_pairs[at + 6u], v_pairs[at + 7u]);
        for (var c = 0u; c < CHANNELS; c++) {
            v_color[c] += v_pairs[at + PAIR_GRADS + c];
        }
    }

    var v_mean = vec3<f32>();
    var v_quat = vec4<f32>();
    var v_scale = vec3<f32>();
    if count > 0u {
        let quat = load_quat(i);
        let scale = load3(SCALES_AT * n + 3u * i);
        let k = project(load3(3u * i), quat, scale);
        if k.ok {
            if view.antialiased != 0u {
                let kept = kept_opacity(k);
                if kept > 0.0 {
                    let v = v_opacity * activated[OPACITIES_AT * n + i] / (2.0 * kept) * BLUR_VARIANCE;
                    v_conic += v * vec3<f32>(
                        BLUR_VARIANCE * k.conic.z - 1.0,
                        -2.0 * BLUR_VARIANCE * k.conic.y,
                        BLUR_VARIANCE * k.conic.x - 1.0,
                    );
                }
                v_opacity *= kept;
            }
            // The covariance: its inverse differentiated, incoming gradient as a symmetric matrix.
            let a = k.conic.x;
            let b = k.conic.y;
            let c = k.conic.z;
            let p = v_conic.x;
            let q = 0.5 * v_conic.y;
            let r = v_conic.z;
            let ap = a * p + b * q;
            let aq = a * q + b * r;
            let bp = b * p + c * q;
            let bq = b * q + c * r;
            let v_cov = vec3<f32>(-(ap * a + aq * b), -(ap * b + aq * c), -(bp * b + bq * c));
            let v_u = 2.0 * (v_cov.x * k.u + v_cov.y * k.v);
            let v_v = 2.0 * (v_cov.y * k.u + v_cov.z * k.v);

            let depth = k.point.z;
            let per_depth = view.focal / depth;
            var v_factor = array<vec3<f32>, 3>(
                per_depth.x * v_u,
                per_depth.y * v_v,
                -per_depth.x * k.slope.x * v_u - per_depth.y * k.slope.y * v_v,
            );
            var v_point = vec3<f32>(0.0, 0.0, -(dot(v_u, k.u) + dot(v_v, k.v)) / depth);
            if !k.clamped.x {
                let v_slope = -per_depth.x * dot(v_u, k.factor[2]);
                v_point.x += v_slope / depth;
                v_point.z -= v_slope * k.slope.x / depth;
            }
            if !k.clamped.y {
                let v_slope = -per_depth.y * dot(v_v, k.factor[2]);
                v_point.y += v_slope / depth;
                v_point.z -= v_slope * k.slope.y / depth;
            }
            v_point.x += per_depth.x * v_mean2d.x;
            v_point.y += per_depth.y * v_mean2d.y;
            v_point.z -= dot(per_depth * v_mean2d, k.point.xy) / depth;

            // factor = W R S.
            var v_rotmat: array<vec3<f32>, 3>;
            for (var row = 0u; row < 3u; row++) {
                let v_rs = view.rows[0][row] * v_factor[0] + view.rows[1][row] * v_factor[1]
                    + view.rows[2][row] * v_factor[2];
                v_rotmat[row] = v_rs * scale;
                v_scale += v_rs * k.rotmat[row];
            }
            v_quat = rotmat_from_quat_vjp(quat, v_rotmat);
            v_mean = v_point.x * view.rows[0].xyz + v_point.y * view.rows[1].xyz + v_point.z * view.rows[2].xyz;
        }
    }

    let rows = view.num_rows;
    for (var d = 0u; d < 3u; d++) {
        v_activated[3u * i + d] = v_mean[d];
        v_activated[SCALES_AT * rows + 3u * i + d] = v_scale[d];
    }
    for (var d = 0u; d < 4u; d++) {
        v_activated[QUATS_AT * rows + 4u * i + d] = v_quat[d];
    }
    v_activated[OPACITIES_AT * rows + i] = v_opacity;
    for (var c = 0u; c < CHANNELS; c++) {
        v_activated[COLORS_AT * rows + CHANNELS * i + c] = v_color[c];
    }
    let ndc = statistic * 0.5 * vec2<f32>(view.size);
    v_means2d_ndc[3u * i] = ndc.x;
    v_means2d_ndc[3u * i + 1u] = ndc.y;
    v_means2d_ndc[3u * i + 2u] = f32(visible);
}

// Without the constraint of unit length, as `rotmat_from_unit_quat_vjp`.
fn rotmat_from_quat_vjp(quat: vec4<f32>, v: array<vec3<f32>, 3>) -> vec4<f32> {
    let w = quat.x;
    let x = quat.y;
    let y = quat.z;
    let z = quat.w;
    return 2.0 * vec4<f32>(
        x * (v[2].y - v[1].z) + y * (v[0].z - v[2].x) + z * (v[1].x - v[0].y),
        -2.0 * x * (v[1].y + v[2].z) + y * (v[0].y + v[1].x) + z * (v[0].z + v[2].x) + w * (v[2].y - v[1].z),
        x * (v[0].y + v[1].x) - 2.0 * y * (v[0].x + v[2].z) + z * (v[1].z + v[2].y) + w * (v[0].z - v[2].x),
        x * (v[0].z + v[2].x) + y * (v[1].z + v[2].y) - 2.0 * z * (v[0].x + v[1].y) + w * (v[1].x - v[0].y),
    );
}
