// Selection of Gaussians and tiles by a list; whole.wgsl has the same functions for all of them.
//
// lists, from view.lists_at on, has three parts:
// - [L] Gaussians, in the order in which equal depths are drawn
// - [grid] the slot of each tile; at least T if the tile is not drawn
// - [T] the tile of each slot

const LISTED: bool = true;

@group(0) @binding(13) var<storage, read> lists: array<u32>;

fn gaussian_at(place: u32) -> u32 {
    return lists[view.lists_at + place];
}

fn slot_of(tile: vec2<u32>) -> u32 {
    return lists[view.lists_at + view.num_listed + tile.y * view.grid.x + tile.x];
}

fn tile_of(slot: u32) -> vec2<u32> {
    let tile = lists[view.lists_at + view.num_listed + view.grid.x * view.grid.y + slot];
    return vec2<u32>(tile % view.grid.x, tile / view.grid.x);
}

fn num_slots(columns: vec2<u32>, rows: vec2<u32>) -> u32 {
    var num = 0u;
    for (var row = rows.x; row < rows.y; row++) {
        for (var column = columns.x; column < columns.y; column++) {
            num += u32(slot_of(vec2<u32>(column, row)) < view.num_tiles);
        }
    }
    return num;
}
