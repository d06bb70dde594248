//! A row: an activated Gaussian in three texels of four words, as `web/quad.vert.glsl` reads it.
//!
//! Means, rotations and scales keep their 32 bits. Colours and opacities are halves, of 11 significant bits: in [0, 1]
//! they err by at most a sixteenth of a step of 8 bits.

use bytemuck::{Pod, Zeroable};
use tcgs_core::dot;
use tcgs_render::settings::MIN_ALPHA;

/// Words of a row.
pub const ROW_WORDS: usize = 12;

/// Rows in a line of the texture. Three texels each, they fit into the 2048 that every browser grants.
pub const LINE: usize = 512;

/// The largest half.
const MAX_HALF: f32 = 65504.0;

/// A row.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(super) struct Row {
    mean: [f32; 3],
    red_green: u32,
    quat: [f32; 4],
    scale: [f32; 3],
    blue_opacity: u32,
}

impl Row {
    #[inline(always)]
    pub(super) fn mean(&self) -> [f32; 3] {
        self.mean
    }

    pub(super) fn set_mean(&mut self, mean: [f32; 3]) {
        self.mean = mean;
    }

    pub(super) fn set_quat(&mut self, quat: [f32; 4]) {
        self.quat = quat;
    }

    pub(super) fn set_scale(&mut self, scale: [f32; 3]) {
        self.scale = scale;
    }

    pub(super) fn set_opacity(&mut self, opacity: f32) {
        self.blue_opacity = self.blue_opacity & 0xffff | half(opacity) << 16;
    }

    pub(super) fn set_color(&mut self, [red, green, blue]: [f32; 3]) {
        self.red_green = half(red) | half(green) << 16;
        self.blue_opacity = self.blue_opacity & 0xffff_0000 | half(blue);
    }
}

/// The largest standard deviation of a Gaussian; negative if it is never drawn. The vertex shader compares the exact
/// opacity with the cutoff, so half a step of a half's is let through.
pub(super) fn reach(row: &Row) -> f32 {
    let opacity = row.blue_opacity >> 16;
    let least = half(MIN_ALPHA as f32) - 1;
    let most = row.scale[0].max(row.scale[1]).max(row.scale[2]);
    if (least..half(2.0)).contains(&opacity) && most.is_finite() { most } else { -1.0 }
}

/// Height below which few Gaussians lie.
///
/// - `rows`: as [`Arranger::rows`](crate::Arranger::rows) gives them
/// - `up`: unit direction in the world
/// - returns: along `up`, scene units from the origin; `None` without Gaussians
///
/// ```
/// let none = [0; tcgs_play::ROW_WORDS];
/// assert_eq!(tcgs_play::ground(&none, [0.0, 1.0, 0.0]), None);
/// ```
pub fn ground(rows: &[u32], up: [f64; 3]) -> Option<f64> {
    /// Least opacity of what counts.
    const LEAST: f32 = 0.1;
    /// Share of the Gaussians below: those that err.
    const BELOW: f64 = 0.02;
    let counted = bytemuck::cast_slice::<u32, Row>(rows).iter().filter(|row| row.blue_opacity >> 16 >= half(LEAST));
    let mut heights: Vec<f64> = counted.map(|row| dot(up, row.mean.map(f64::from))).collect();
    let index = (BELOW * heights.len() as f64) as usize;
    (!heights.is_empty()).then(|| *heights.select_nth_unstable_by(index, f64::total_cmp).1)
}

/// The nearest half, ties to even; what is larger than all halves becomes the largest.
pub(super) fn half(x: f32) -> u32 {
    /// `2^-14`, the least half whose mantissa has all its bits.
    const LEAST_NORMAL: f32 = 1.0 / 16384.0;
    /// Distance of the halves below it, inverted.
    const PER_SUBNORMAL: f32 = 16_777_216.0;
    let bits = x.to_bits();
    let sign = bits >> 16 & 0x8000;
    let magnitude = f32::from_bits(bits & 0x7fff_ffff).min(MAX_HALF);
    if magnitude < LEAST_NORMAL {
        return sign | (magnitude * PER_SUBNORMAL).round_ties_even() as u32;
    }
    let bits = magnitude.to_bits();
    // The exponent's bias is 127 in a float and 15 in a half.
    sign | (((bits + 0xfff + (bits >> 13 & 1)) >> 13) - (112 << 10))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A half by its definition.
    fn value(half: u32) -> f64 {
        let (exponent, mantissa) = ((half >> 10 & 31) as i32, f64::from(half & 1023));
        let magnitude = if exponent == 0 {
            mantissa * 2.0_f64.powi(-24)
        } else {
            (1.0 + mantissa / 1024.0) * 2.0_f64.powi(exponent - 15)
        };
        if half & 0x8000 != 0 { -magnitude } else { magnitude }
    }

    #[test]
    fn every_half_stays_and_all_else_goes_to_the_nearest() {
        for of in (0..0x7c00).chain(0x8000..0xfc00) {
            assert_eq!(half(value(of) as f32), of);
        }
        for below in 0..0x7bff_u32 {
            let (a, b) = (value(below), value(below + 1));
            let middle = 0.5 * (a + b);
            assert_eq!(half(middle as f32), below + (below & 1), "a tie");
            assert_eq!(half((a + 0.4 * (b - a)) as f32), below);
            assert_eq!(half((a + 0.6 * (b - a)) as f32), below + 1);
        }
        assert_eq!(half(1e9), 0x7bff);
        assert_eq!(half(-1e9), 0xfbff);
        assert_eq!(half(f32::NAN), 0x7bff);
    }

    #[test]
    fn the_ground_lies_below_all_but_a_few() {
        let row = |height: f32, opacity: f32| {
            let mut row = Row::default();
            row.set_mean([3.0, -height, 5.0]);
            row.set_opacity(opacity);
            row
        };
        let mut rows: Vec<Row> = (0..200).map(|i| row(1.0 + 0.01 * ((7 * i) % 200) as f32, 0.5)).collect();
        rows.extend([row(-9.0, 0.9), row(-8.0, 0.9), row(-99.0, 0.05), Row::default()]);
        let found = ground(bytemuck::cast_slice(&rows), [0.0, -1.0, 0.0]).unwrap();
        assert!((found - 1.02).abs() < 1e-6, "{found}");
        assert_eq!(ground(&[0; ROW_WORDS], [0.0, -1.0, 0.0]), None);
    }

    #[test]
    fn a_row_holds_what_is_set() {
        let mut row = Row::default();
        row.set_color([0.25, -1.0, 0.5]);
        row.set_opacity(0.75);
        row.set_color([0.25, -1.0, 2.0]);
        let words: [u32; ROW_WORDS] = bytemuck::cast(row);
        let parts = [words[3] & 0xffff, words[3] >> 16, words[11] & 0xffff, words[11] >> 16].map(value);
        assert_eq!(parts, [0.25, -1.0, 2.0, 0.75]);
        row.set_scale([0.1, 0.3, 0.2]);
        assert_eq!(reach(&row), 0.3);
        row.set_opacity(1.0 / 260.0);
        assert_eq!(reach(&row), -1.0);
        row.set_opacity(f32::NAN);
        assert_eq!(reach(&row), -1.0);
    }
}
