// From splats in depth order to each tile's list of splats; each list is cut into buckets. One (tile, splat)
// combination is a pair.
//
// - bin_count: one thread per place in the order: block_sums [blocks] = pairs of its workgroup
// - bin_scan: one workgroup: block_sums become offsets; their total decides whether the iteration can continue
// - bin_emit: one thread per place in the order: writes its pairs (tile, number of the pair), splat by splat in depth
//   order (a stable sort by tile then keeps that order within a tile)
// - bin_ranges: one thread per drawn tile: offset of its pairs, after the sort
// - bin_buckets: one workgroup: offset of its buckets
//
// Drawn tiles have slots, 0 to T; keys of pairs and tables use slots.
// - tiles [2 (T + 1) + buckets]: first pair of each slot | first bucket of each slot | slot of each bucket, DEAD if
//   forward ended before it
// - status: (halted, most pairs needed when too many, pairs needed last, 0)
// - arguments: of dispatches, three each: sort, buckets

@group(0) @binding(1) var<storage, read> splats: array<vec4<u32>>;
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> tile_counts: array<u32>;
@group(0) @binding(4) var<storage, read_write> block_sums: array<u32>;
@group(0) @binding(5) var<storage, read_write> pair_keys: array<u32>;
@group(0) @binding(6) var<storage, read_write> pair_values: array<u32>;
@group(0) @binding(7) var<storage, read_write> pair_gaussian: array<u32>;
@group(0) @binding(8) var<storage, read_write> pair_first: array<u32>;
@group(0) @binding(9) var<storage, read_write> status: array<u32>;
@group(0) @binding(10) var<storage, read_write> num_pairs: array<u32>;
@group(0) @binding(11) var<storage, read_write> arguments: array<u32>;
@group(0) @binding(12) var<storage, read_write> tiles: array<u32>;

var<workgroup> sums: array<u32, WORKGROUP>;

// Saturates, so that an overflowing number of pairs still exceeds the capacity.
fn saturating_add(a: u32, b: u32) -> u32 {
    return a + min(b, ~a);
}

// Exclusive sum over the workgroup; the last of sums holds the total. A saturated total makes the other sums
// meaningless.
fn scan(lane: u32, value: u32) -> u32 {
    workgroupBarrier();
    sums[lane] = value;
    workgroupBarrier();
    for (var distance = 1u; distance < WORKGROUP; distance *= 2u) {
        var before = 0u;
        if lane >= distance {
            before = sums[lane - distance];
        }
        workgroupBarrier();
        sums[lane] = saturating_add(sums[lane], before);
        workgroupBarrier();
    }
    return sums[lane] - value;
}

fn count_at(place: u32) -> u32 {
    if place >= view.num_listed {
        return 0u;
    }
    return tile_counts[order[place]] & ~VISIBLE;
}

@compute @workgroup_size(WORKGROUP)
fn bin_count(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
) {
    scan(lane, count_at(id.x));
    if lane == WORKGROUP - 1u {
        block_sums[group.x] = sums[WORKGROUP - 1u];
    }
}

@compute @workgroup_size(WORKGROUP)
fn bin_scan(@builtin(local_invocation_index) lane: u32) {
    let blocks = (view.num_listed + WORKGROUP - 1u) / WORKGROUP;
    var total = 0u;
    for (var first = 0u; first < blocks; first += WORKGROUP) {
        let block = first + lane;
        var value = 0u;
        if block < blocks {
            value = block_sums[block];
        }
        let before = scan(lane, value);
        if block < blocks {
            block_sums[block] = total + before;
        }
        total = saturating_add(total, sums[WORKGROUP - 1u]);
    }
    if lane == 0u {
        status[2] = total;
        if total > view.pair_capacity {
            status[0] = 1u;
            status[1] = max(status[1], total);
        }
        if status[0] != 0u {
            total = 0u;
        }
        num_pairs[0] = total;
        arguments[0] = (total + SORT_BLOCK - 1u) / SORT_BLOCK;
        arguments[1] = 1u;
        arguments[2] = 1u;
    }
}

@compute @workgroup_size(WORKGROUP)
fn bin_emit(
    @builtin(global_invocation_id) id: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
    @builtin(workgroup_id) group: vec3<u32>,
) {
    let count = count_at(id.x);
    let first = block_sums[group.x] + scan(lane, count);
    if count == 0u {
        return;
    }
    let i = order[id.x];
    pair_first[i] = first;
    if first > view.pair_capacity || count > view.pair_capacity - first {
        return;
    }
    let shape = bitcast<vec4<f32>>(splats[2u * i]);
    let rest = splats[2u * i + 1u];
    let conic = vec3<f32>(shape.zw, bitcast<f32>(rest.x));
    let limit = reach(bitcast<f32>(rest.y));
    // Emits exactly the counted number of pairs, even if two compilations of reaches_tile round differently. The last
    // tiles make up for missing pairs, and the splat is invisible there.
    var pair = first;
    let end = first + count;
    var left = num_slots(vec2<u32>(rest.z & 0xffffu, rest.z >> 16u), vec2<u32>(rest.w & 0xffffu, rest.w >> 16u));
    for (var row = rest.w & 0xffffu; row < (rest.w >> 16u); row++) {
        for (var column = rest.z & 0xffffu; column < (rest.z >> 16u); column++) {
            let tile = vec2<u32>(column, row);
            let slot = slot_of(tile);
            if slot >= view.num_tiles {
                continue;
            }
            let is_needed = left <= end - pair;
            left--;
            if pair < end && (is_needed || reaches_tile(shape.xy, conic, limit, tile)) {
                pair_keys[pair] = slot;
                pair_values[pair] = pair;
                pair_gaussian[pair] = i;
                pair++;
            }
        }
    }
}

@compute @workgroup_size(WORKGROUP)
fn bin_ranges(@builtin(global_invocation_id) id: vec3<u32>) {
    let slot = id.x;
    if slot > view.num_tiles {
        return;
    }
    // First pair whose slot is at least this one.
    var low = 0u;
    var high = num_pairs[0];
    while low < high {
        let middle = (low + high) / 2u;
        if pair_keys[middle] < slot {
            low = middle + 1u;
        } else {
            high = middle;
        }
    }
    tiles[slot] = low;
}

@compute @workgroup_size(WORKGROUP)
fn bin_buckets(@builtin(local_invocation_index) lane: u32) {
    let count = view.num_tiles;
    var total = 0u;
    for (var first = 0u; first < count; first += WORKGROUP) {
        let slot = first + lane;
        var value = 0u;
        if slot < count {
            value = (tiles[slot + 1u] - tiles[slot] + BUCKET - 1u) / BUCKET;
        }
        let before = scan(lane, value);
        if slot < count {
            tiles[count + 1u + slot] = total + before;
        }
        total += sums[WORKGROUP - 1u];
    }
    if lane == 0u {
        tiles[2u * count + 1u] = total;
        arguments[3] = min(total, MAX_GROUPS_X);
        arguments[4] = (total + MAX_GROUPS_X - 1u) / MAX_GROUPS_X;
        arguments[5] = 1u;
    }
}
