//! Writes an SPZ file of version 3. More programs read it than version 4, and it is smaller. Its bytes are those of the
//! tables of `spz` and `unpack`.

use std::f64::consts::SQRT_2;
use std::io::{self, ErrorKind, Write};

use flate2::Compression;
use flate2::write::GzEncoder;
use tcgs_core::{Gaussians, normalize, sigmoid};

use super::{COORDINATE_SYSTEM, axes_number};
use crate::axes::Axes;
use crate::stored::{harmonics_in_rows, sh0_from_color, smallest_three};

/// Fractional bits of positions that other programs write.
const USUAL_BITS: u32 = 12;
/// Significant bits of the largest coordinate that a file has at least; a small scene has more than [`USUAL_BITS`].
const LEAST_SIGNIFICANT_BITS: i32 = 16;
/// Most fractional bits that readers take.
const MAX_BITS: u32 = 24;
/// The largest integer of a position.
const MAX_POSITION: f64 = ((1 << 23) - 1) as f64;

/// Writes the Gaussians of one timestep as an SPZ file of version 3, with the harmonics of their layout, its flag of
/// antialiasing, and the extension that declares the axes. Further columns are left out. Equal Gaussians give equal
/// bytes.
///
/// Positions err by at most `1 / 8192`, by less in scenes smaller than 16 units, and by more in scenes larger than 2048
/// units. Log scales from -10 to 5.9 err by at most `1 / 32`, opacities by `1 / 510`, colours from -0.44 to 1.44 by
/// 0.0037, harmonics from -1 to 0.99 by `1 / 256`. Values beyond these ranges become their nearest ends.
///
/// - `writer`: should be buffered
/// - `gaussians`: `[N]`, stored form, in the axes of PLY files
/// - `axes`: of the file. The format's README says [`Axes::RUB`]. Programs that ignore the extension, such as
///   splat-transform 3, take the file for [`Axes::RDF`]
///
/// ```
/// use tcgs_core::Gaussians;
/// use tcgs_interchange::{Axes, ReadSettings, read_gaussians, write_spz_to};
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("a.spz");
/// let mut gaussians = Gaussians::zeros(5);
/// gaussians.means_mut()[3] = [1.0, 2.0, 3.0];
/// write_spz_to(std::fs::File::create(&path)?, &gaussians, Axes::RUB)?;
/// assert_eq!(read_gaussians(&path, ReadSettings::default())?.means(), gaussians.means());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The errors of `writer`; [`io::ErrorKind::InvalidInput`] if a coordinate is beyond 8388607, which is the largest that
/// such a file holds, or if there are more than `u32::MAX` Gaussians.
pub fn write_spz_to(writer: impl Write, gaussians: &Gaussians, axes: Axes) -> io::Result<()> {
    let invalid = |problem| io::Error::new(ErrorKind::InvalidInput, problem);
    let num_gaussians = u32::try_from(gaussians.num_gaussians())
        .map_err(|_| invalid("an SPZ file holds at most 4294967295 Gaussians"))?;
    let fractional_bits = fractional_bits(gaussians.means())
        .ok_or_else(|| invalid("an SPZ file holds coordinates up to 8388607 units"))?;
    let mut turned = gaussians.clone();
    axes.turn(&mut turned);
    let extension = [COORDINATE_SYSTEM, 4, axes_number(axes)].map(u32::to_le_bytes).concat();
    let flags = 2 | u8::from(gaussians.layout().is_antialiased());
    let sh_degree = gaussians.layout().sh_degree() as u8;
    let mut stream = GzEncoder::new(writer, Compression::best());
    stream.write_all(b"NGSP\x03\0\0\0")?;
    stream.write_all(&num_gaussians.to_le_bytes())?;
    stream.write_all(&[sh_degree, fractional_bits as u8, flags, 0])?;
    arrays(&turned, fractional_bits).iter().try_for_each(|array| stream.write_all(array))?;
    stream.write_all(&extension)?;
    stream.finish()?.flush()
}

/// None if no number of them holds all positions.
fn fractional_bits(means: &[[f32; 3]]) -> Option<u32> {
    let largest = means.as_flattened().iter().fold(0.0, |largest, x| f64::max(largest, x.abs().into()));
    let fits = |bits: u32| (largest * f64::from(1_u32 << bits)).round() <= MAX_POSITION;
    let of_largest = if largest > 0.0 { largest.log2().ceil() as i32 } else { 0 };
    let wanted = (LEAST_SIGNIFICANT_BITS - of_largest).clamp(USUAL_BITS as i32, MAX_BITS as i32) as u32;
    (0..=wanted).rev().find(|&bits| fits(bits))
}

/// Positions, opacities, colours, scales, rotations, harmonics. The last may be empty.
fn arrays(gaussians: &Gaussians, fractional_bits: u32) -> [Vec<u8>; 6] {
    let byte = |x: f64| x.round().clamp(0.0, 255.0) as u8;
    let one = f64::from(1_u32 << fractional_bits);
    let position = |&x: &f32| {
        let [low, middle, high, _] = ((f64::from(x) * one).round() as i32).to_le_bytes();
        [low, middle, high]
    };
    let color = |&color: &f32| byte((0.15 * f64::from(sh0_from_color(color)) + 0.5) * 255.0);
    let harmonics = harmonics_in_rows(gaussians).into_iter().map(|x| byte(f64::from(x) * 128.0 + 128.0));
    [
        gaussians.means().as_flattened().iter().flat_map(position).collect(),
        gaussians.logit_opacities().iter().map(|&o| byte(sigmoid(f64::from(o)) * 255.0)).collect(),
        gaussians.colors().as_flattened().iter().map(color).collect(),
        gaussians.log_scales().as_flattened().iter().map(|&s| byte((f64::from(s) + 10.0) * 16.0)).collect(),
        gaussians.quats().iter().flat_map(|&quat| rotation(quat).to_le_bytes()).collect(),
        harmonics.collect(),
    ]
}

/// The identity of a rotation without a direction.
fn rotation(quat: [f32; 4]) -> u32 {
    let [w, x, y, z] = match normalize(quat.map(f64::from)) {
        [0.0, 0.0, 0.0, 0.0] => [1.0, 0.0, 0.0, 0.0],
        unit => unit,
    };
    let (which, others) = smallest_three([x, y, z, w]);
    others.iter().fold(which as u32, |packed, x| {
        let size = (x.abs() * 511.0 * SQRT_2).round().min(511.0) as u32;
        packed << 10 | u32::from(*x < 0.0) << 9 | size
    })
}

#[cfg(test)]
mod tests;
