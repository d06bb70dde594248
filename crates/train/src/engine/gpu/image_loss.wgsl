
// 0.8 L1 + 0.2 (1 - SSIM) of the rendered image against a target, forward and backward.
//
// - rendered, v_image [C, H, W]
// - targets: bytes red, green, blue, foreground, each / 255
// - cameras [2, K, 3]: logarithms of gains, then offsets; the camera's image is exp(gain) * rendered + offset
// - maps [C, 3, H, W]: derivatives of the SSIM map to mean_x, square_x and product (see ssim.rs of tcgs-metrics)
// - partials [C, blocks, 4]: sums over a block of 1 - SSIM, |x - y|, v_gain and v_offset
//
// A workgroup handles a block of 16x16 pixels of one channel, which is a tile of the renderer. image_whole.wgsl or
// image_listed.wgsl defines the blocks and the positions of their pixels. The window is 11x11 and separable: the pixels
// under the windows of a block are loaded once, filtered along rows, then down columns.

@group(0) @binding(0) var<uniform> step: Step;
@group(0) @binding(1) var<storage, read> rendered: array<f32>;
@group(0) @binding(2) var<storage, read> targets: array<u32>;
@group(0) @binding(3) var<storage, read> cameras: array<f32>;
@group(0) @binding(4) var<storage, read_write> maps: array<f32>;
@group(0) @binding(5) var<storage, read_write> partials: array<f32>;
@group(0) @binding(6) var<storage, read_write> v_image: array<f32>;

// Pixels on each side of the window's centre: `blend` has a tap for each. WINDOW0 to WINDOW5 are the window's weights,
// the centre's and those of one side.
const RADIUS: u32 = 5u;
// Side of the square of pixels that a block's windows cover.
const SEEN: u32 = SIDE + 2u * RADIUS;

// Rendered and target.
var<workgroup> seen: array<vec2<f32>, SEEN * SEEN>;
// [5, SEEN, SIDE] filtered along rows: x, y, x², y², xy.
var<workgroup> rows: array<f32, 5u * SEEN * SIDE>;
// The three derivatives.
var<workgroup> seen_maps: array<f32, 3u * SEEN * SEEN>;
// [3, SEEN, SIDE] the same, filtered along rows.
var<workgroup> map_rows: array<f32, 3u * SEEN * SIDE>;
var<workgroup> sums: array<vec2<f32>, 256>;

// (gain's factor, offset) of a channel.
fn correction(channel: u32) -> vec2<f32> {
    if (channel >= 3u) {
        return vec2(1.0, 0.0);
    }
    let at = 3u * step.camera + channel;
    return vec2(exp(cameras[at]), cameras[3u * step.num_cameras + at]);
}

// The value of a word of the targets in one channel.
fn target_value(word: u32, channel: u32) -> f32 {
    let values = unpack4x8unorm(word);
    if (channel == 4u) {
        return 1.0 - values.w;
    }
    return values[channel];
}

fn weight(channel: u32) -> f32 {
    return select(step.segmentation_weight, step.image_weight, channel < 3u);
}

// The pixel at place `i` of a block's SEEN x SEEN.
fn seen_pixel(block: vec2<u32>, i: u32) -> vec2<i32> {
    return vec2<i32>(block * SIDE + vec2(i % SEEN, i / SEEN)) - i32(RADIUS);
}

fn is_inside(pixel: vec2<i32>) -> bool {
    return all(pixel >= vec2(0)) && all(pixel < vec2<i32>(vec2(step.width, step.height)));
}

// The row that a thread filters, in turns of 16. Half a warp filters a row, the other half the eighth row after it, so
// that both read different banks of workgroup memory.
fn filtered_row(turn: u32, local: u32) -> u32 {
    return turn * 16u + local / 32u + 8u * ((local / 16u) & 1u);
}

fn blend(centre: f32, one: f32, two: f32, three: f32, four: f32, five: f32) -> f32 {
    return (WINDOW0 * centre + WINDOW1 * one) + ((WINDOW2 * two + WINDOW3 * three) + (WINDOW4 * four + WINDOW5 * five));
}

fn column(quantity: u32, local: u32) -> f32 {
    let at = quantity * SEEN * SIDE + local;
    return blend(
        rows[at + 5u * SIDE],
        rows[at + 4u * SIDE] + rows[at + 6u * SIDE],
        rows[at + 3u * SIDE] + rows[at + 7u * SIDE],
        rows[at + 2u * SIDE] + rows[at + 8u * SIDE],
        rows[at + SIDE] + rows[at + 9u * SIDE],
        rows[at] + rows[at + 10u * SIDE],
    );
}

fn map_column(quantity: u32, local: u32) -> f32 {
    let at = quantity * SEEN * SIDE + local;
    return blend(
        map_rows[at + 5u * SIDE],
        map_rows[at + 4u * SIDE] + map_rows[at + 6u * SIDE],
        map_rows[at + 3u * SIDE] + map_rows[at + 7u * SIDE],
        map_rows[at + 2u * SIDE] + map_rows[at + 8u * SIDE],
        map_rows[at + SIDE] + map_rows[at + 9u * SIDE],
        map_rows[at] + map_rows[at + 10u * SIDE],
    );
}

// Squares and product of two places at one distance from the centre, and the places themselves.
struct Taps {
    xy: vec2<f32>,
    squares: vec2<f32>,
    product: f32,
}

fn taps(a: vec2<f32>, b: vec2<f32>) -> Taps {
    return Taps(a + b, a * a + b * b, a.x * a.y + b.x * b.y);
}

fn filter_row(row: u32, first: u32, out: u32) {
    let centre = seen[first + 5u];
    let one = taps(seen[first + 4u], seen[first + 6u]);
    let two = taps(seen[first + 3u], seen[first + 7u]);
    let three = taps(seen[first + 2u], seen[first + 8u]);
    let four = taps(seen[first + 1u], seen[first + 9u]);
    let five = taps(seen[first], seen[first + 10u]);
    let x = blend(centre.x, one.xy.x, two.xy.x, three.xy.x, four.xy.x, five.xy.x);
    let y = blend(centre.y, one.xy.y, two.xy.y, three.xy.y, four.xy.y, five.xy.y);
    let s = centre * centre;
    let square_x = blend(s.x, one.squares.x, two.squares.x, three.squares.x, four.squares.x, five.squares.x);
    let square_y = blend(s.y, one.squares.y, two.squares.y, three.squares.y, four.squares.y, five.squares.y);
    let p = centre.x * centre.y;
    let product = blend(p, one.product, two.product, three.product, four.product, five.product);
    rows[out] = x;
    rows[out + SEEN * SIDE] = y;
    rows[out + 2u * SEEN * SIDE] = square_x;
    rows[out + 3u * SEEN * SIDE] = square_y;
    rows[out + 4u * SEEN * SIDE] = product;
}

// Adds up `sums` and writes them to one pair of the block's partials.
fn write_sums(at: u32, local: u32) {
    workgroupBarrier();
    for (var half = 128u; half > 0u; half /= 2u) {
        if (local < half) {
            sums[local] += sums[local + half];
        }
        workgroupBarrier();
    }
    if (local == 0u) {
        partials[at] = sums[0].x;
        partials[at + 1u] = sums[0].y;
    }
}

fn partial_index(channel: u32, block: u32) -> u32 {
    return 4u * (channel * step.num_blocks + block);
}

// Overwrites `maps` and the first pair of `partials`.
@compute @workgroup_size(256)
fn image_loss_fwd(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let number = group.y * MAX_GROUPS_X + group.x;
    if (number >= step.num_blocks) {
        return;
    }
    let block = block_at(number);
    let channel = group.z;
    let pixels = step.width * step.height;
    let corrected = correction(channel);
    for (var i = local; i < SEEN * SEEN; i += 256u) {
        let pixel = seen_pixel(block, i);
        var pair = vec2(0.0);
        if (is_inside(pixel)) {
            let values = raw_and_target(vec2<u32>(pixel), channel);
            pair = vec2(corrected.x * values.x + corrected.y, values.y);
        }
        seen[i] = pair;
    }
    workgroupBarrier();
    for (var turn = 0u; turn < 2u; turn += 1u) {
        let row = filtered_row(turn, local);
        if (row < SEEN) {
            filter_row(row, row * SEEN + local % SIDE, row * SIDE + local % SIDE);
        }
    }
    workgroupBarrier();

    let x_pixel = block.x * SIDE + local % SIDE;
    let y_pixel = block.y * SIDE + local / SIDE;
    var losses = vec2(0.0);
    if (x_pixel < step.width && y_pixel < step.height && is_compared(vec2(x_pixel, y_pixel))) {
        let x = column(0u, local);
        let y = column(1u, local);
        let covariance = column(4u, local) - x * y;
        let variances = (column(2u, local) - x * x) + (column(3u, local) - y * y);
        let a1 = 2.0 * x * y + C1;
        let a2 = 2.0 * covariance + C2;
        let inverse_b1 = 1.0 / (x * x + y * y + C1);
        let inverse_b2 = 1.0 / (variances + C2);
        let inverse = inverse_b1 * inverse_b2;
        let ssim = a1 * a2 * inverse;
        let out = 3u * channel * pixels + y_pixel * step.width + x_pixel;
        // With the squares and the product held fixed, the mean acts on the variance and covariance too.
        maps[out] = 2.0 * (y * (a2 - a1) * inverse - x * ssim * (inverse_b1 - inverse_b2));
        maps[out + pixels] = -ssim * inverse_b2;
        maps[out + 2u * pixels] = 2.0 * a1 * inverse;
        let pair = seen[(local / SIDE + RADIUS) * SEEN + local % SIDE + RADIUS];
        losses = vec2(1.0 - ssim, abs(pair.x - pair.y));
    }
    sums[local] = losses;
    write_sums(partial_index(channel, number), local);
}

// Overwrites `v_image`, the gradient to the rendered image before the camera's correction, and the second
// pair of `partials`.
@compute @workgroup_size(256)
fn image_loss_bwd(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let number = group.y * MAX_GROUPS_X + group.x;
    if (number >= step.num_tiles) {
        return;
    }
    let block = block_at(number);
    let channel = group.z;
    let pixels = step.width * step.height;
    for (var i = local; i < SEEN * SEEN; i += 256u) {
        let pixel = seen_pixel(block, i);
        for (var quantity = 0u; quantity < 3u; quantity += 1u) {
            var value = 0.0;
            if (is_inside(pixel)) {
                value = maps[(3u * channel + quantity) * pixels + u32(pixel.y) * step.width + u32(pixel.x)];
            }
            seen_maps[quantity * SEEN * SEEN + i] = value;
        }
    }
    workgroupBarrier();
    for (var turn = 0u; turn < 2u; turn += 1u) {
        let row = filtered_row(turn, local);
        if (row < SEEN) {
            for (var quantity = 0u; quantity < 3u; quantity += 1u) {
                let at = (quantity * SEEN + row) * SEEN + local % SIDE;
                map_rows[(quantity * SEEN + row) * SIDE + local % SIDE] = blend(
                    seen_maps[at + 5u],
                    seen_maps[at + 4u] + seen_maps[at + 6u],
                    seen_maps[at + 3u] + seen_maps[at + 7u],
                    seen_maps[at + 2u] + seen_maps[at + 8u],
                    seen_maps[at + 1u] + seen_maps[at + 9u],
                    seen_maps[at] + seen_maps[at + 10u],
                );
            }
        }
    }
    workgroupBarrier();

    let x_pixel = block.x * SIDE + local % SIDE;
    let y_pixel = block.y * SIDE + local / SIDE;
    var v_correction = vec2(0.0);
    if (x_pixel < step.width && y_pixel < step.height) {
        let pixel = y_pixel * step.width + x_pixel;
        let at = channel * pixels + pixel;
        let corrected = correction(channel);
        let values = raw_and_target(vec2(x_pixel, y_pixel), channel);
        let raw = values.x;
        let x = corrected.x * raw + corrected.y;
        let y = values.y;
        let v_map = -(1.0 - L1_SHARE) * weight(channel) / COUNTED_CHANNELS / f32(pixels);
        let slope = L1_SHARE * weight(channel) / (COUNTED_CHANNELS * f32(pixels));
        let v = v_map * (map_column(0u, local) + 2.0 * x * map_column(1u, local) + y * map_column(2u, local))
            + slope * sign(x - y);
        v_image[at] = corrected.x * v;
        v_correction = vec2(corrected.x * v * raw, v);
    }
    sums[local] = v_correction;
    write_sums(partial_index(channel, number) + 2u, local);
}
