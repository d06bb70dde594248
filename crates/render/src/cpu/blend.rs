//! One splat in a run of pixels, as long as the processor's vectors: its alphas, and blending.

use fearless_simd::prelude::*;

use super::tiles::Splat;
use crate::settings::{MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE};

/// `2^−x` for `0 <= x <= 32`, to 2e-7 relative: a power of two by exponent bits and a degree-6 polynomial.
#[inline(always)]
fn exp2_neg<S: Simd>(simd: S, x: S::f32s) -> S::f32s {
    /// Adding this leaves an integer in the low mantissa bits.
    const MAGIC: f32 = 12_582_912.0;
    /// Largest `x`: an opacity of 1 becomes far less than [`MIN_ALPHA`]. Products of smaller powers with gradients
    /// would be subnormal numbers, which take some processors a hundred times as long.
    const MOST: f32 = 32.0;
    let x = x.min(MOST);
    let magic = S::f32s::splat(simd, MAGIC);
    let shifted = magic - x;
    let f = (magic - shifted) - x;
    let p = f.mul_add(1.540_353e-4, 1.333_355_8e-3);
    let p = p.mul_add(f, 9.618_129e-3);
    let p = p.mul_add(f, 5.550_411e-2);
    let p = p.mul_add(f, 2.402_265e-1);
    let p = p.mul_add(f, std::f32::consts::LN_2);
    let p = p.mul_add(f, 1.0);
    S::f32s::from_bits(p.to_bits() + (shifted.to_bits() << 23))
}

/// The terms of a splat's exponent of 2 in one row of pixels: `(aa * dx + b_dy) * dx + cc_dy2`.
#[derive(Clone, Copy)]
pub(super) struct RowTerms {
    aa: f32,
    b_dy: f32,
    cc_dy2: f32,
    opacity: f32,
}

impl RowTerms {
    #[inline(always)]
    pub fn new(splat: &Splat, dy: f32) -> Self {
        const LOG2_E: f32 = std::f32::consts::LOG2_E;
        let [a, b, c] = splat.conic;
        Self { aa: 0.5 * LOG2_E * a, b_dy: LOG2_E * b * dy, cc_dy2: 0.5 * LOG2_E * c * dy * dy, opacity: splat.opacity }
    }
}

/// Alphas of a splat in a run of pixels, before they are clamped.
///
/// - `dx`: from the splat's centre to each pixel
#[inline(always)]
pub(super) fn raw_alphas<S: Simd>(simd: S, terms: RowTerms, dx: S::f32s) -> S::f32s {
    let along = dx.mul_add(terms.aa, terms.b_dy);
    let exponent = along.mul_add(dx, terms.cc_dy2).max(0.0);
    exp2_neg(simd, exponent) * terms.opacity
}

/// Effect of one splat on a run of pixels.
pub(super) struct Blend<S: Simd> {
    pub alpha: S::f32s,
    /// `alpha * transmittance`; 0 where the splat is skipped.
    pub blend_weight: S::f32s,
    /// Whether alpha was clamped.
    pub clamped: S::mask32s,
    /// Transmittance behind the splat; negative where the pixel is finished.
    pub transmittance: S::f32s,
}

/// Blends a splat into a run of pixels.
///
/// - `raw`: from [`raw_alphas`]
#[inline(always)]
pub(super) fn blend<S: Simd>(simd: S, raw: S::f32s, before: S::f32s) -> Blend<S> {
    let (zero, most) = (S::f32s::splat(simd, 0.0), S::f32s::splat(simd, MAX_ALPHA as f32));
    let clamped = raw.simd_gt(most);
    let alpha = clamped.select(most, raw);
    let weight = alpha * before;
    // Rounded once on all processors: `before - weight` would lose digits where alpha is near 1.
    let after = (-alpha).mul_add_precise(before, before);
    let reached = alpha.simd_ge(MIN_ALPHA as f32) & before.simd_gt(zero);
    let blended = reached & after.simd_ge(MIN_TRANSMITTANCE as f32);
    let skipped = reached.select(-before, before);
    Blend { alpha, blend_weight: blended.select(weight, zero), clamped, transmittance: blended.select(after, skipped) }
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;

    /// [`exp2_neg`] by the vectors of this processor, and by those that every processor has.
    fn exp2_negs(x: f32) -> [f32; 2] {
        [Level::new(), Level::baseline()].map(|level| dispatch!(level, simd => one_exp2_neg(simd, x)))
    }

    #[inline(always)]
    fn one_exp2_neg<S: Simd>(simd: S, x: f32) -> f32 {
        exp2_neg(simd, S::f32s::splat(simd, x)).as_slice()[0]
    }

    #[test]
    fn exp2_neg_follows_exp2() {
        for i in 0..32_000 {
            let x = i as f32 * 1e-3;
            let expected = (-f64::from(x)).exp2();
            for found in exp2_negs(x).map(f64::from) {
                assert!((found / expected - 1.0).abs() < 4e-7, "{x}: {found} against {expected}");
            }
        }
    }

    #[test]
    fn far_from_a_splat_products_stay_normal() {
        // A gradient of the image is a weight divided by the number of values.
        let gradient = 1e-9_f32;
        for x in [32.0, 1e3, f32::MAX] {
            for least in exp2_negs(x) {
                assert!((least * MIN_TRANSMITTANCE as f32 * gradient).is_normal() && least < 0.1 * MIN_ALPHA as f32);
            }
        }
    }
}
