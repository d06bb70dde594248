// Selection of all Gaussians and tiles; listed.wgsl has the same functions for those of a list.

const LISTED: bool = false;

// The Gaussian at a place of the list.
fn gaussian_at(place: u32) -> u32 {
    return place;
}

// The slot of a tile; at least view.num_tiles if the tile is not drawn.
fn slot_of(tile: vec2<u32>) -> u32 {
    return tile.y * view.grid.x + tile.x;
}

fn tile_of(slot: u32) -> vec2<u32> {
    return vec2<u32>(slot % view.grid.x, slot / view.grid.x);
}

// Number of drawn tiles of a rectangle; ranges are first and end.
fn num_slots(columns: vec2<u32>, rows: vec2<u32>) -> u32 {
    return (columns.y - columns.x) * (rows.y - rows.x);
}
