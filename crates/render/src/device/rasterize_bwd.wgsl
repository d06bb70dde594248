// Backward of blending. One workgroup per bucket, one thread per splat. Pixels pass from thread to thread, so each
// pixel meets the bucket's splats front to back, and every thread sums its splat's gradients in registers.
// - reads splats, activated (colors), pair_gaussian, pair_values, tiles, image, v_image [C, H, W], checkpoints
// - writes v_pairs [pairs, PAIR_GRADS + C]: gradients to mean2d, conic, opacity, the statistic's mean2d, colors; skips
//   buckets without an active Gaussian
//
// The colour behind a splat is the finished image minus the colour blended up to the splat.

@group(0) @binding(1) var<storage, read> splats: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> activated: array<f32>;
@group(0) @binding(3) var<storage, read> pair_gaussian: array<u32>;
@group(0) @binding(4) var<storage, read> pair_values: array<u32>;
@group(0) @binding(5) var<storage, read> tiles: array<u32>;
@group(0) @binding(6) var<storage, read> image: array<f32>;
@group(0) @binding(7) var<storage, read> v_image: array<f32>;
@group(0) @binding(8) var<storage, read> checkpoints: array<f32>;
@group(0) @binding(9) var<storage, read_write> v_pairs: array<f32>;

var<workgroup> transmittances: array<f32, PIXELS>;
// Sum over channels of image * v_image behind the splats met so far: for all channels, and for the statistic's alone.
var<workgroup> behinds: array<vec2<f32>, PIXELS>;
var<workgroup> v_pixels: array<f32, PIXELS * CHANNELS>;
var<workgroup> num_active: atomic<u32>;
var<workgroup> any_active: u32;

@compute @workgroup_size(BUCKET)
fn rasterize_bwd(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let bucket = group.y * MAX_GROUPS_X + group.x;
    let count = view.num_tiles;
    if bucket >= tiles[2u * count + 1u] {
        return;
    }
    let marked = tiles[2u * (count + 1u) + bucket];
    let slot = marked & ~DEAD;
    let place = tiles[slot] + (bucket - tiles[count + 1u + slot]) * BUCKET + lane;
    let is_splat = place < tiles[slot + 1u];
    var pair = 0u;
    if is_splat {
        pair = pair_values[place];
    }
    let row = pair * (PAIR_GRADS + CHANNELS);
    if (marked & DEAD) != 0u {
        if is_splat {
            for (var i = 0u; i < PAIR_GRADS + CHANNELS; i++) {
                v_pairs[row + i] = 0.0;
            }
        }
        return;
    }

    var gaussian = 0u;
    if is_splat {
        gaussian = pair_gaussian[pair];
    }
    if LISTED {
        if lane == 0u {
            atomicStore(&num_active, 0u);
        }
        workgroupBarrier();
        if is_splat && gaussian < view.num_active {
            atomicAdd(&num_active, 1u);
        }
        workgroupBarrier();
        if lane == 0u {
            any_active = atomicLoad(&num_active);
        }
        if workgroupUniformLoad(&any_active) == 0u {
            return;
        }
    }

    let origin = tile_of(slot) * TILE;
    let plane = view.size.x * view.size.y;
    for (var p = lane; p < PIXELS; p += BUCKET) {
        let pixel = origin + vec2<u32>(p % TILE, p / TILE);
        let kept = bucket * (1u + CHANNELS) * PIXELS + p;
        transmittances[p] = checkpoints[kept];
        var behind = vec2<f32>();
        if all(pixel < view.size) {
            let at = pixel.y * view.size.x + pixel.x;
            for (var c = 0u; c < CHANNELS; c++) {
                let v = v_image[c * plane + at];
                let rest = (image[c * plane + at] - checkpoints[kept + (1u + c) * PIXELS]) * v;
                v_pixels[c * PIXELS + p] = v;
                behind += vec2<f32>(rest, select(0.0, rest, c < view.statistic_channels));
            }
        }
        behinds[p] = behind;
    }

    var mean2d = vec2<f32>();
    var conic = vec3<f32>();
    var opacity = 0.0;
    var color: array<f32, CHANNELS>;
    var v_color: array<f32, CHANNELS>;
    for (var c = 0u; c < CHANNELS; c++) {
        color[c] = 0.0;
        v_color[c] = 0.0;
    }
    if is_splat {
        let shape = bitcast<vec4<f32>>(splats[2u * gaussian]);
        let rest = bitcast<vec2<f32>>(splats[2u * gaussian + 1u].xy);
        mean2d = shape.xy;
        conic = vec3<f32>(shape.zw, rest.x);
        opacity = rest.y;
        let at = COLORS_AT * view.num_gaussians + CHANNELS * gaussian;
        for (var c = 0u; c < CHANNELS; c++) {
            color[c] = activated[at + c];
        }
    }
    // Moments of g = -dL/d(exponent) about the splat's centre.
    var g_sum = 0.0;
    var g_first = vec2<f32>();
    var g_second = vec3<f32>();
    var s_first = vec2<f32>();
    workgroupBarrier();
    for (var step = 0u; step < PIXELS + BUCKET - 1u; step++) {
        let p = step - lane; // wraps before the first pixel has come
        if p < PIXELS && is_splat && transmittances[p] > 0.0 {
            let before = transmittances[p];
            let d = vec2<f32>(origin + vec2<u32>(p % TILE, p / TILE)) + 0.5 - mean2d;
            let exponent = (0.5 * conic.x * d.x + conic.y * d.y) * d.x + 0.5 * conic.z * d.y * d.y;
            let raw = opacity * exp(-max(exponent, 0.0));
            let alpha = min(raw, MAX_ALPHA);
            if alpha >= MIN_ALPHA {
                let after = before * (1.0 - alpha);
                if after < MIN_TRANSMITTANCE {
                    transmittances[p] = -before;
                } else {
                    let blend_weight = alpha * before;
                    var own = vec2<f32>();
                    for (var c = 0u; c < CHANNELS; c++) {
                        let v = v_pixels[c * PIXELS + p];
                        let share = color[c] * v;
                        own += vec2<f32>(share, select(0.0, share, c < view.statistic_channels));
                        v_color[c] += blend_weight * v;
                    }
                    let behind = behinds[p] - blend_weight * own;
                    behinds[p] = behind;
                    transmittances[p] = after;
                    if raw <= MAX_ALPHA {
                        let g = blend_weight * own - behind * (alpha / (1.0 - alpha));
                        g_sum += g.x;
                        g_first += g.x * d;
                        g_second += g.x * vec3<f32>(d.x * d.x, d.x * d.y, d.y * d.y);
                        s_first += g.y * d;
                    }
                }
            }
        }
        workgroupBarrier();
    }
    if !is_splat {
        return;
    }
    v_pairs[row] = dot(conic.xy, g_first);
    v_pairs[row + 1u] = dot(conic.yz, g_first);
    v_pairs[row + 2u] = -0.5 * g_second.x;
    v_pairs[row + 3u] = -g_second.y;
    v_pairs[row + 4u] = -0.5 * g_second.z;
    v_pairs[row + 5u] = g_sum / opacity;
    v_pairs[row + 6u] = dot(conic.xy, s_first);
    v_pairs[row + 7u] = dot(conic.yz, s_first);
    for (var c = 0u; c < CHANNELS; c++) {
        v_pairs[row + PAIR_GRADS + c] = v_color[c];
    }
}
