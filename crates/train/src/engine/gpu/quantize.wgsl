
// Quantizers, in the form (step, offset, lowest code, highest code).

// `x`, hidden from the compiler: compilers may reorder sums of floats, and `reaches` relies on rounding errors. The
// last value of a rate is always 0, so that the XOR changes nothing.
fn opaque(x: f32) -> f32 {
    return bitcast<f32>(bitcast<u32>(x) ^ bitcast<u32>(step.adam[0].w));
}

// Whether `a - b >= half * width`, where the two sides are nearly equal and floats alone would guess.
// Difference and product are each taken as a sum of two floats (Knuth 1997, 4.2.2; Dekker 1971).
//
// - `a - b`: positive
// - `half`: a positive integer and a half, below 2^17
fn reaches(a: f32, b: f32, half: f32, width: f32) -> bool {
    let difference = opaque(a - b);
    let taken = opaque(difference - a);
    let difference_rest = opaque(a - opaque(difference - taken)) - opaque(b + taken);

    let product = opaque(half * width);
    let half_high = floor(half / 256.0) * 256.0;
    let half_low = half - half_high;
    let width_high = bitcast<f32>(bitcast<u32>(width) & 0xfffff000u);
    let width_low = opaque(width - width_high);
    var product_rest = opaque(half_high * width_high - product);
    product_rest = opaque(product_rest + half_low * width_high);
    product_rest = opaque(product_rest + half_high * width_low);
    product_rest = opaque(product_rest + half_low * width_low);
    return opaque(difference - product) + (difference_rest - product_rest) >= 0.0;
}

// Nearest code, as `Quantizer::quantize` on the CPU finds it in f64: halves go away from zero.
fn quantize(x: f32, quantizer: vec4<f32>) -> f32 {
    let scaled = (x - quantizer.y) / quantizer.x;
    let magnitude = min(abs(scaled), 65536.0);
    let below = floor(magnitude);
    let excess = magnitude - below - 0.5;
    var code = select(below, below + 1.0, excess >= 0.0);
    // A subtraction and a division are off by four units in the last place; this is twice that.
    if (abs(excess) < 1e-6 * magnitude) {
        let side = sign(scaled);
        code = select(below, below + 1.0, reaches(side * x, side * quantizer.y, below + 0.5, quantizer.x));
    }
    return clamp(sign(scaled) * code, quantizer.z, quantizer.w);
}

// The value that a decoder reads for `x`.
fn fake_quant(x: f32, quantizer: vec4<f32>) -> f32 {
    return fma(quantize(x, quantizer), quantizer.x, quantizer.y);
}
