//! Writes an SPZ file of version 3 or 4. Its bytes are those of the tables of `spz` and `unpack`.

use std::f64::consts::SQRT_2;
use std::io::{self, ErrorKind, Write};

use flate2::Compression;
use flate2::write::GzEncoder;
use ruzstd::encoding::{CompressionLevel, compress_to_vec};
use tcgs_core::{Gaussians, normalize, sigmoid};

use super::{COORDINATE_SYSTEM, HEADER_4, axes_number};
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

/// Versions of SPZ that [`write_spz_to`] writes. They hold the same numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SpzVersion {
    /// Packed by gzip. More programs read this version, and its files are a quarter smaller than those of version 4.
    #[default]
    V3,
    /// Each attribute packed by Zstandard.
    V4,
}

/// Writes the Gaussians of one timestep as an SPZ file, with the harmonics of their layout, its flag of antialiasing,
/// and the extension that declares the axes. Further columns are left out. Equal Gaussians give equal bytes.
///
/// Positions err by at most `1 / 8192`, by less in scenes smaller than 16 units, and by more in scenes larger than 2048
/// units. Log scales from -10 to 5.9 err by at most `1 / 32`, opacities by `1 / 510`, colours from -0.44 to 1.44 by
/// 0.0037, harmonics from -1 to 0.99 by `1 / 256`. Values beyond these ranges become their nearest ends.
///
/// - `writer`: should be buffered
/// - `gaussians`: `[N]`, stored form, in the axes of PLY files
/// - `axes`: of the file. The format's README says [`Axes::RUB`]. Programs that ignore the extension take the file for
///   [`Axes::RDF`]: splat-transform 3, and Niantic's own in version 3
/// - `version`: of the format
///
/// ```
/// use tcgs_core::Gaussians;
/// use tcgs_interchange::{Axes, ReadSettings, SpzVersion, read_gaussians, write_spz_to};
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("a.spz");
/// let mut gaussians = Gaussians::zeros(5);
/// gaussians.means_mut()[3] = [1.0, 2.0, 3.0];
/// write_spz_to(std::fs::File::create(&path)?, &gaussians, Axes::RUB, SpzVersion::V3)?;
/// assert_eq!(read_gaussians(&path, ReadSettings::default())?.means(), gaussians.means());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// The errors of `writer`; [`io::ErrorKind::InvalidInput`] if a coordinate is beyond 8388607, which is the largest that
/// such a file holds, or if there are more than `u32::MAX` Gaussians.
pub fn write_spz_to(mut writer: impl Write, gaussians: &Gaussians, axes: Axes, version: SpzVersion) -> io::Result<()> {
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
    let arrays = arrays(&turned, fractional_bits);
    let header = |version: u8, num_streams: u8| {
        let start = [b"NGSP".as_slice(), &[version, 0, 0, 0], &num_gaussians.to_le_bytes()].concat();
        [start.as_slice(), &[sh_degree, fractional_bits as u8, flags, num_streams]].concat()
    };
    match version {
        SpzVersion::V3 => {
            let mut stream = GzEncoder::new(&mut writer, Compression::best());
            stream.write_all(&header(3, 0))?;
            arrays.iter().try_for_each(|array| stream.write_all(array))?;
            stream.write_all(&extension)?;
            stream.finish()?;
        }
        SpzVersion::V4 => {
            let arrays: Vec<&[u8]> = arrays.iter().map(Vec::as_slice).filter(|array| !array.is_empty()).collect();
            // The one level of the library that compresses.
            let frames = arrays.iter().map(|&array| compress_to_vec(array, CompressionLevel::Fastest));
            let frames: Vec<Vec<u8>> = frames.collect();
            let mut start = header(4, frames.len() as u8);
            start.extend(((HEADER_4 + extension.len()) as u32).to_le_bytes());
            start.resize(HEADER_4, 0);
            start.extend(extension);
            for (frame, array) in frames.iter().zip(arrays) {
                start.extend([frame.len() as u64, array.len() as u64].map(u64::to_le_bytes).concat());
            }
            writer.write_all(&start)?;
            frames.iter().try_for_each(|frame| writer.write_all(frame))?;
        }
    }
    writer.flush()
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
