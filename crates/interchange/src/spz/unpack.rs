//! Decodes the bytes of an SPZ file. Harmonics lie as in the columns: red, green and blue of a coefficient together.
//!
//! | array | bytes a Gaussian | value |
//! |---|---|---|
//! | positions | 9 | three integers of 24 bits, little-endian, over 2 to the fractional bits |
//! | opacities | 1 | activated: `byte / 255` |
//! | colours | 3 | coefficient of degree 0: `(byte / 255 - 0.5) / 0.15` |
//! | scales | 3 | natural logarithm: `byte / 16 - 10` |
//! | rotations, version 2 | 3 | `x, y, z`: `byte / 127.5 - 1`; `w` follows, not negative |
//! | rotations, from version 3 on | 4 | integer, from its highest bits: 2, which of `x, y, z, w` is largest; then of the others 1 of sign and 9 of `value · 511 · √2`; the largest follows, positive |
//! | harmonics | 9, 24, 45 or 72 | `(byte - 128) / 128` |

use std::f64::consts::FRAC_1_SQRT_2;
use std::sync::Arc;

use tcgs_core::{Gaussians, Layout};

use crate::stored::{color_from_sh0, logit_of_byte};

/// Positions, opacities, colours, scales, rotations, harmonics.
pub type Arrays = Vec<Vec<u8>>;

/// Fields of the header that determine the encoding.
#[derive(Clone, Copy)]
pub struct Encoding {
    pub version: u32,
    pub fractional_bits: u8,
}

/// The Gaussians in the axes of the file.
///
/// - `arrays`: of `num_gaussians`, with harmonics of at least the layout's degree
pub fn unpack(arrays: &[Vec<u8>], encoding: Encoding, num_gaussians: usize, layout: &Arc<Layout>) -> Gaussians {
    let [positions, opacities, colors, scales, rotations, harmonics] = arrays else {
        unreachable!("readers give six arrays, found {}", arrays.len());
    };
    let mut gaussians = Gaussians::zeros_of(layout, num_gaussians);
    let step = 1.0 / f64::from(1_u32 << encoding.fractional_bits);
    let base = gaussians.views_mut();
    let means = base.means.as_flattened_mut().iter_mut();
    for (mean, &[low, middle, high]) in means.zip(positions.as_chunks().0) {
        // The sign is that of the highest of four bytes.
        *mean = (f64::from(i32::from_le_bytes([0, low, middle, high]) >> 8) * step) as f32;
    }
    for (logit, &byte) in base.logit_opacities.iter_mut().zip(opacities) {
        *logit = logit_of_byte(byte);
    }
    for (color, &byte) in base.colors.as_flattened_mut().iter_mut().zip(colors) {
        *color = color_from_sh0(((f64::from(byte) / 255.0 - 0.5) / 0.15) as f32);
    }
    for (scale, &byte) in base.log_scales.as_flattened_mut().iter_mut().zip(scales) {
        *scale = f32::from(byte) / 16.0 - 10.0;
    }
    if encoding.version == 2 {
        for (quat, &bytes) in base.quats.iter_mut().zip(rotations.as_chunks().0) {
            *quat = first_three(bytes);
        }
    } else {
        for (quat, &bytes) in base.quats.iter_mut().zip(rotations.as_chunks().0) {
            *quat = smallest_three(u32::from_le_bytes(bytes));
        }
    }
    let row = harmonics.len() / num_gaussians.max(1);
    for (l, band) in (1..).zip(layout.harmonics()) {
        let values = gaussians.values_mut(band).chunks_exact_mut(band.components());
        for (to, from) in values.zip(harmonics.chunks_exact(row.max(1))) {
            for (to, &byte) in to.iter_mut().zip(&from[3 * (l * l - 1)..]) {
                *to = (f32::from(byte) - 128.0) / 128.0;
            }
        }
    }
    gaussians
}

/// `w, x, y, z` of version 2.
fn first_three(bytes: [u8; 3]) -> [f32; 4] {
    let [x, y, z] = bytes.map(|byte| f64::from(byte) / 127.5 - 1.0);
    let w = (1.0 - x * x - y * y - z * z).max(0.0).sqrt();
    [w, x, y, z].map(|x| x as f32)
}

/// `w, x, y, z` from version 3 on.
fn smallest_three(packed: u32) -> [f32; 4] {
    let which = (packed >> 30) as usize;
    let mut shift = 30;
    let mut others = 0.0;
    let mut xyzw = [0.0; 4];
    for (_, value) in xyzw.iter_mut().enumerate().filter(|(c, _)| *c != which) {
        shift -= 10;
        let size = f64::from(packed >> shift & 511) * (FRAC_1_SQRT_2 / 511.0);
        *value = if packed >> shift & 512 == 0 { size } else { -size };
        others += size * size;
    }
    xyzw[which] = (1.0_f64 - others).max(0.0).sqrt();
    let [x, y, z, w] = xyzw;
    [w, x, y, z].map(|x| x as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rotations_are_unit_and_as_their_bits_say() {
        // The largest is w, then x is +1/√2, y and z are 0.
        let [w, x, y, z] = smallest_three(3 << 30 | 511 << 20);
        assert!((w - 0.5_f32.sqrt()).abs() < 1e-6 && (x - 0.5_f32.sqrt()).abs() < 1e-6 && (y, z) == (0.0, 0.0));
        // The largest is x; y is negative.
        let [w, x, y, z] = smallest_three((512 | 100) << 20 | 200 << 10);
        let step = 0.5_f32.sqrt() / 511.0;
        assert!((y + 100.0 * step).abs() < 1e-6 && (z - 200.0 * step).abs() < 1e-6 && w == 0.0 && x > 0.9);
        let [w, x, y, z] = first_three([255, 0, 127]);
        assert!((x, y) == (1.0, -1.0) && z < 0.0 && w == 0.0);
    }
}
