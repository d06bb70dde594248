//! Writes a compressed PLY file. Its layout is the table of `compressed`.

use std::f64::consts::SQRT_2;
use std::io::{self, Write};

use tcgs_core::{Gaussians, normalize, sigmoid};

use super::compressed::{CHUNK, COLOR_RANGES, PACKED, RANGES};
use super::vertex::{PROPERTIES, REQUIRED};
use super::{comments, num_rest, rest_of_band};
use crate::stored::smallest_three;

/// Largest log scale that is written, and the negative of the smallest: standard deviations of 2e-9 and 5e8 scene
/// units. Scales beyond would widen the ranges of all 256 Gaussians of a chunk.
const MAX_LOG_SCALE: f32 = 20.0;

/// Writes the Gaussians of one timestep as a compressed PLY file for viewers such as `SuperSplat`: 16 bytes a Gaussian,
/// and a byte for each coefficient of its harmonics. It has a comment if they are drawn with antialiasing. Further
/// columns are left out. Equal Gaussians give equal bytes.
///
/// 256 consecutive Gaussians share their ranges: positions err by at most `1 / 2046` of the range along y, and by at
/// most `1 / 4094` along x and z; log scales err likewise. Neighbours in space should therefore be neighbours in the
/// file ([`space_order`](crate::space_order)); the writer keeps the order. Opacities and colours err by at most `1 /
/// 510` (of the range), harmonics from -4 to 4 by at most 3/128. Log scales beyond ±20 become ±20.
///
/// - `writer`: should be buffered
/// - `gaussians`: `[N]`, stored form
///
/// ```
/// use tcgs_core::Gaussians;
/// use tcgs_interchange::{ReadSettings, read_ply, write_compressed_ply_to};
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("a.compressed.ply");
/// let mut gaussians = Gaussians::zeros(5);
/// gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
/// gaussians.means_mut()[3] = [1.0, 2.0, 3.0];
/// write_compressed_ply_to(std::fs::File::create(&path)?, &gaussians)?;
/// assert_eq!(read_ply(&path, ReadSettings::default())?.means(), gaussians.means());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The errors of `writer`.
pub fn write_compressed_ply_to(mut writer: impl Write, gaussians: &Gaussians) -> io::Result<()> {
    let n = gaussians.num_gaussians();
    let clamped: Vec<[f32; 3]> =
        gaussians.log_scales().iter().map(|scales| scales.map(|s| s.clamp(-MAX_LOG_SCALE, MAX_LOG_SCALE))).collect();
    let (means, colors) = (gaussians.means(), gaussians.colors());
    writer.write_all(header(gaussians).as_bytes())?;
    let mut rows = Vec::with_capacity(16 * n);
    for start in (0..n).step_by(CHUNK) {
        let chunk = start..(start + CHUNK).min(n);
        let [of_means, of_scales, of_colors] =
            [means, &clamped[..], colors].map(|values| Range::of(&values[chunk.clone()]));
        for Range { low, high } in [of_means, of_scales, of_colors] {
            for x in [low, high].concat() {
                writer.write_all(&x.to_le_bytes())?;
            }
        }
        for i in chunk {
            let [red, green, blue] = of_colors.share(colors[i]).map(|share| unorm(share, 8) as u8);
            let opacity = unorm(sigmoid(f64::from(gaussians.logit_opacities()[i])), 8) as u8;
            let packed = [
                point(of_means.share(means[i])),
                rotation(gaussians.quats()[i]),
                point(of_scales.share(clamped[i])),
                u32::from_be_bytes([red, green, blue, opacity]),
            ];
            rows.extend(packed.into_iter().flat_map(u32::to_le_bytes));
        }
    }
    writer.write_all(&rows)?;
    let bands = gaussians.layout().harmonics();
    let mut row = vec![0; num_rest(bands.len())];
    for i in 0..n {
        for (l, &band) in (1..).zip(&bands) {
            let values = &gaussians.values(band)[i * band.components()..];
            for (place, &value) in rest_of_band(bands.len(), l).zip(values) {
                row[place] = coefficient(value);
            }
        }
        writer.write_all(&row)?;
    }
    Ok(())
}

fn header(gaussians: &Gaussians) -> String {
    let (n, sh_degree) = (gaussians.num_gaussians(), gaussians.layout().sh_degree());
    let comments = comments(gaussians.layout());
    let element = |name: &str, count: usize, kind: &str, properties: &[&str]| {
        let lines: String = properties.iter().map(|property| format!("property {kind} {property}\n")).collect();
        format!("element {name} {count}\n{lines}")
    };
    let chunk = element("chunk", n.div_ceil(CHUNK), "float", &[&RANGES[..], &COLOR_RANGES].concat());
    let vertex = element("vertex", n, "uint", &PACKED);
    let sh = match num_rest(sh_degree) {
        0 => String::new(),
        count => element("sh", n, "uchar", &PROPERTIES[REQUIRED..][..count]),
    };
    format!("ply\nformat binary_little_endian 1.0\n{comments}{chunk}{vertex}{sh}end_header\n")
}

/// The range of a chunk's values.
#[derive(Clone, Copy)]
struct Range {
    low: [f32; 3],
    high: [f32; 3],
}

impl Range {
    fn of(values: &[[f32; 3]]) -> Self {
        let mut range = Self { low: [f32::INFINITY; 3], high: [f32::NEG_INFINITY; 3] };
        for value in values {
            for c in 0..3 {
                (range.low[c], range.high[c]) = (range.low[c].min(value[c]), range.high[c].max(value[c]));
            }
        }
        range
    }

    /// Where in the range a value lies, from 0 to 1.
    fn share(&self, value: [f32; 3]) -> [f64; 3] {
        std::array::from_fn(|c| {
            let (low, high) = (f64::from(self.low[c]), f64::from(self.high[c]));
            if high > low { (f64::from(value[c]) - low) / (high - low) } else { 0.0 }
        })
    }
}

/// The nearest integer of some bits to a share of the largest one.
fn unorm(share: f64, bits: u32) -> u32 {
    (share.clamp(0.0, 1.0) * f64::from((1_u32 << bits) - 1)).round() as u32
}

fn point([x, y, z]: [f64; 3]) -> u32 {
    unorm(x, 11) << 21 | unorm(y, 10) << 11 | unorm(z, 11)
}

/// The identity of a rotation without a direction.
fn rotation(quat: [f32; 4]) -> u32 {
    let (which, others) = smallest_three(normalize(quat.map(f64::from)));
    others.iter().fold(which as u32, |packed, x| packed << 10 | unorm(x / SQRT_2 + 0.5, 10))
}

/// The byte whose value is nearest: `8 (n - ½)` with `n = (byte + ½) / 256`, but -4 of 0 and 4 of 255.
fn coefficient(value: f32) -> u8 {
    // Between -4 and the value of byte 1 lie one and a half steps.
    let nearest_end = 4.0 - 3.0 / 128.0;
    match f64::from(value) {
        value if value < -nearest_end => 0,
        value if value > nearest_end => 255,
        value => ((value / 8.0 + 0.5) * 256.0).floor().clamp(1.0, 254.0) as u8,
    }
}

#[cfg(test)]
mod tests;
