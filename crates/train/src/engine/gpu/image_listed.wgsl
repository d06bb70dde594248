// The pixels of an image of which some tiles are drawn, with the functions of image_whole.wgsl. Blocks are the drawn
// tiles, then the ring around them, whose pixels are constant.
//
// - lists, from step.slots_at on: the slot of each tile, NO_SLOT outside of drawn tiles and ring; then the tile of each
//   slot. Slots from step.num_tiles on are of the ring.
// - targets [slots, SIDE, SIDE]
// - pictures [slots of the ring, C, SIDE, SIDE], before the camera's correction

@group(0) @binding(7) var<storage, read> lists: array<u32>;
@group(0) @binding(8) var<storage, read> pictures: array<f32>;

fn grid() -> vec2<u32> {
    return (vec2(step.width, step.height) + SIDE - 1u) / SIDE;
}

fn block_at(number: u32) -> vec2<u32> {
    let columns = grid().x;
    let tile = lists[step.slots_at + columns * grid().y + number];
    return vec2(tile % columns, tile / columns);
}

fn slot_of(pixel: vec2<u32>) -> u32 {
    let tile = pixel / SIDE;
    return lists[step.slots_at + tile.y * grid().x + tile.x];
}

fn raw_and_target(pixel: vec2<u32>, channel: u32) -> vec2<f32> {
    let slot = slot_of(pixel);
    if (slot == NO_SLOT) {
        // Only pixels that are not compared see it.
        return vec2(0.0);
    }
    let within = pixel.y % SIDE * SIDE + pixel.x % SIDE;
    var raw = 0.0;
    if (slot < step.num_tiles) {
        raw = rendered[channel * step.width * step.height + pixel.y * step.width + pixel.x];
    } else {
        let channels = select(3u, 5u, (step.flags & SEGMENTED) != 0u);
        raw = pictures[step.pictures_at + ((slot - step.num_tiles) * channels + channel) * SIDE * SIDE + within];
    }
    return vec2(raw, target_value(targets[step.target_offset + slot * SIDE * SIDE + within], channel));
}

// A window covers only the tiles of its corners, since it is smaller than a tile.
fn is_compared(pixel: vec2<u32>) -> bool {
    let low = max(pixel, vec2(RADIUS)) - RADIUS;
    let high = min(pixel + RADIUS, vec2(step.width, step.height) - 1u);
    let first = min(slot_of(low), slot_of(vec2(high.x, low.y)));
    return min(first, min(slot_of(vec2(low.x, high.y)), slot_of(high))) < step.num_tiles;
}
