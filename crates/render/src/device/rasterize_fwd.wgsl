// Blending of each tile's splats, front to back. One workgroup per drawn tile, one thread per pixel.
// - reads splats, activated (colors), pair_gaussian [pairs], pair_values [pairs] (numbers of pairs, sorted by tile,
//   then depth)
// - writes image [C + 1, H, W]: colours, then transmittance; only in drawn tiles
// - writes, with KEEPS, checkpoints [buckets, 1 + C, PIXELS] before each bucket with an active Gaussian: transmittance
//   (not above 0 if the pixel was finished) and blended colour
// - writes, with KEEPS, tiles: the slot of each bucket

@group(0) @binding(1) var<storage, read> splats: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> activated: array<f32>;
@group(0) @binding(3) var<storage, read> pair_gaussian: array<u32>;
@group(0) @binding(4) var<storage, read> pair_values: array<u32>;
@group(0) @binding(5) var<storage, read_write> tiles: array<u32>;
@group(0) @binding(6) var<storage, read_write> image: array<f32>;
@group(0) @binding(7) var<storage, read_write> checkpoints: array<f32>;

var<workgroup> shapes: array<vec4<f32>, PIXELS>;   // mean2d, conic xx, xy
var<workgroup> rests: array<vec2<f32>, PIXELS>;    // conic yy, opacity
var<workgroup> colors: array<f32, PIXELS * CHANNELS>;
var<workgroup> bounds: vec3<u32>;               // first pair, end, first bucket
var<workgroup> live: atomic<u32>;
var<workgroup> any_live: u32;
var<workgroup> active_buckets: atomic<u32>;     // of a batch: a bit each

@compute @workgroup_size(PIXELS)
fn rasterize_fwd(@builtin(local_invocation_index) lane: u32, @builtin(workgroup_id) group: vec3<u32>) {
    let slot = group.y * MAX_GROUPS_X + group.x;
    if slot >= view.num_tiles {
        return;
    }
    let pixel = tile_of(slot) * TILE + vec2<u32>(lane % TILE, lane / TILE);
    let inside = all(pixel < view.size);
    let center = vec2<f32>(pixel) + 0.5;
    if lane == 0u {
        bounds = vec3<u32>(tiles[slot], tiles[slot + 1u], tiles[view.num_tiles + 1u + slot]);
    }
    let range = workgroupUniformLoad(&bounds);

    var transmittance = select(-1.0, 1.0, inside); // not above 0: finished
    var blended: array<f32, CHANNELS>;
    for (var c = 0u; c < CHANNELS; c++) {
        blended[c] = 0.0;
    }
    var first = range.x;
    for (; first < range.y; first += PIXELS) {
        if lane == 0u {
            atomicStore(&live, 0u);
            if KEEPS && LISTED {
                atomicStore(&active_buckets, 0u);
            }
        }
        workgroupBarrier();
        if transmittance > 0.0 {
            atomicOr(&live, 1u);
        }
        workgroupBarrier();
        if lane == 0u {
            any_live = atomicLoad(&live);
        }
        if workgroupUniformLoad(&any_live) == 0u {
            break;
        }
        if first + lane < range.y {
            let gaussian = pair_gaussian[pair_values[first + lane]];
            let rest = splats[2u * gaussian + 1u];
            shapes[lane] = bitcast<vec4<f32>>(splats[2u * gaussian]);
            rests[lane] = bitcast<vec2<f32>>(rest.xy);
            let at = COLORS_AT * view.num_gaussians + CHANNELS * gaussian;
            for (var c = 0u; c < CHANNELS; c++) {
                colors[CHANNELS * lane + c] = activated[at + c];
            }
            if KEEPS && LISTED && gaussian < view.num_active {
                atomicOr(&active_buckets, 1u << (lane / BUCKET));
            }
        }
        workgroupBarrier();
        let count = min(range.y - first, PIXELS);
        var kept_buckets = 0xffffffffu;
        if KEEPS && LISTED {
            kept_buckets = atomicLoad(&active_buckets);
        }
        for (var j = 0u; j < count; j++) {
            if KEEPS && j % BUCKET == 0u && ((kept_buckets >> (j / BUCKET)) & 1u) != 0u {
                let bucket = range.z + (first - range.x + j) / BUCKET;
                let at = bucket * (1u + CHANNELS) * PIXELS + lane;
                checkpoints[at] = transmittance;
                for (var c = 0u; c < CHANNELS; c++) {
                    checkpoints[at + (1u + c) * PIXELS] = blended[c];
                }
            }
            if transmittance <= 0.0 {
                continue;
            }
            let shape = shapes[j];
            let d = center - shape.xy;
            let exponent = (0.5 * shape.z * d.x + shape.w * d.y) * d.x + 0.5 * rests[j].x * d.y * d.y;
            let alpha = min(rests[j].y * exp(-max(exponent, 0.0)), MAX_ALPHA);
            if alpha < MIN_ALPHA {
                continue;
            }
            let after = transmittance * (1.0 - alpha);
            if after < MIN_TRANSMITTANCE {
                transmittance = -transmittance;
                continue;
            }
            let blend_weight = alpha * transmittance;
            for (var c = 0u; c < CHANNELS; c++) {
                blended[c] += blend_weight * colors[CHANNELS * j + c];
            }
            transmittance = after;
        }
        workgroupBarrier();
    }

    if inside {
        let at = pixel.y * view.size.x + pixel.x;
        let plane = view.size.x * view.size.y;
        let passed = abs(transmittance);
        for (var c = 0u; c < CHANNELS; c++) {
            image[c * plane + at] = blended[c] + passed * view.background[c / 4u][c % 4u];
        }
        image[CHANNELS * plane + at] = passed;
    }
    if KEEPS {
        let buckets = (range.y - range.x + BUCKET - 1u) / BUCKET;
        let reached = min((first - range.x) / BUCKET, buckets);
        for (var b = lane; b < buckets; b += PIXELS) {
            tiles[2u * (view.num_tiles + 1u) + range.z + b] = select(slot, slot | DEAD, b >= reached);
        }
    }
}
