// The tiles that a splat reaches: all except those in which every pixel's alpha is below MIN_ALPHA.

// alpha >= MIN_ALPHA  <=>  exponent <= this.
fn reach(opacity: f32) -> f32 {
    return max(log(opacity / MIN_ALPHA), 0.0);
}

fn exponent(d: vec2<f32>, conic: vec3<f32>) -> f32 {
    return 0.5 * (conic.x * d.x * d.x + conic.z * d.y * d.y) + conic.y * d.x * d.y;
}

// Compares the exponent's least value over the rectangle of a tile's pixel centres with the limit.
//
// The rectangle is convex and the exponent grows along every ray from the splat's centre. So the least value lies on an
// edge that faces the centre. For an edge that does not, a point inside the rectangle is used.
fn reaches_tile(mean2d: vec2<f32>, conic: vec3<f32>, limit: f32, tile: vec2<u32>) -> bool {
    let low = vec2<f32>(tile * TILE) + 0.5 - mean2d;
    let high = vec2<f32>(min((tile + 1u) * TILE, view.size)) - 0.5 - mean2d;
    let near = clamp(vec2<f32>(), low, high);
    let on_column = vec2<f32>(near.x, clamp(-conic.y * near.x / conic.z, low.y, high.y));
    let on_row = vec2<f32>(clamp(-conic.y * near.y / conic.x, low.x, high.x), near.y);
    let least = min(exponent(on_column, conic), exponent(on_row, conic));
    // Tolerance for rounding: of the limit, and of terms that cancel.
    let rounding = 1e-3 * limit + 1e-2 + 1e-6 * (conic.x * near.x * near.x + conic.z * near.y * near.y);
    return least <= limit + rounding;
}
