//! One `.ksplat` file of `GaussianSplats3D`, version 0.1: one timestep. `table` reads where its parts are. All numbers
//! are little-endian.
//!
//! Sections follow the table. A section has three parts: the lengths of its partial buckets in 32 bits, the middles of
//! all its buckets as three floats, and a row for each Gaussian. The rows go bucket by bucket, the full ones first.
//!
//! | part of a row | level 0 | levels 1 and 2 | here |
//! |---|---|---|---|
//! | position | floats | `p`, 16 bits each | `means`: `(p - range) block / (2 range)` + the middle of the bucket |
//! | scales, not their logarithms | floats | half floats | `log_scales` |
//! | rotation | floats | half floats | `quats`, `w, x, y, z` |
//! | colour | `byte / 255` | the same | `colors` |
//! | opacity, activated | `byte / 255` | the same | `logit_opacities` |
//! | harmonics | floats | half floats, or bytes at level 2 | `sh1`, `sh2` |
//!
//! Harmonics are sorted by degree, then by colour. A byte is a share of the range that the header gives. Axes are those
//! of PLY files. The first bytes are a version of small numbers, so the ending of the name alone tells the kind.

mod table;

use std::io::Read;
use std::iter::repeat_n;
use std::path::Path;

use tcgs_core::Gaussians;

use self::table::{Section, Table};
use crate::axes::Axes;
use crate::stored::{Head, logit_of_byte};
use crate::{InterchangeError, ReadSettings};

/// Reads the Gaussians of one `.ksplat` file, in stored form. Numbers need not be finite.
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::File`] if it is not a complete `.ksplat`
/// file of version 0.1, or has no Gaussian; [`InterchangeError::Limit`] if it takes more memory than the settings
/// allow.
pub(crate) fn read_ksplat(path: &Path, settings: ReadSettings) -> Result<Gaussians, InterchangeError> {
    let (table, mut file) = Table::open(path, settings)?;
    let mut gaussians = Gaussians::zeros_of(&table.head.layout, table.head.num_gaussians);
    let mut first = 0;
    for section in &table.sections {
        let mut bytes = Vec::new();
        let read = file.by_ref().take(section.bytes).read_to_end(&mut bytes);
        read.map_err(|error| InterchangeError::Read { path: path.into(), error })?;
        if bytes.len() as u64 != section.bytes {
            return Err(table::ends_early(path));
        }
        read_section(&table, section, &bytes, first, &mut gaussians)
            .map_err(|problem| InterchangeError::File { path: path.into(), problem })?;
        first += section.num_gaussians;
    }
    settings.axes.unwrap_or(Axes::RDF).turn(&mut gaussians);
    Ok(gaussians)
}

/// Reads the table of a `.ksplat` file.
///
/// # Errors
/// As [`read_ksplat`], but for errors that only the sections show.
pub(crate) fn read_head(path: &Path, settings: ReadSettings) -> Result<Head, InterchangeError> {
    Ok(Table::open(path, settings)?.0.head)
}

/// Reads the Gaussians of a section, or says what is wrong with it.
///
/// - `bytes`: of the section, all of them
/// - `first`: index of its first Gaussian
fn read_section(
    table: &Table,
    section: &Section,
    bytes: &[u8],
    first: usize,
    gaussians: &mut Gaussians,
) -> Result<(), String> {
    let level = table.level;
    let (lengths, rest) = bytes.split_at(4 * section.num_partial);
    let (middles, rows) = rest.split_at(section.middles_bytes);
    let rows = rows.chunks_exact(section.row_bytes).take(section.num_gaussians);
    let base = gaussians.views_mut();
    let means = base.means.iter_mut().skip(first).zip(rows.clone());
    if level.is_whole() {
        means.for_each(|(mean, row)| *mean = [0, 1, 2].map(|c| float(row, 4 * c)));
    } else {
        let partial = lengths.as_chunks::<4>().0.iter().map(|&length| u32::from_le_bytes(length) as usize);
        let lengths = repeat_n(section.bucket_size, section.num_full).chain(partial);
        let (found, expected) = (lengths.clone().map(|length| length as u64).sum::<u64>(), section.num_gaussians);
        if found < expected as u64 {
            return Err(format!("has a section with buckets of {found} Gaussians, expected {expected}"));
        }
        let middles = middles.as_chunks::<12>().0;
        let middles = lengths.zip(middles).flat_map(|(length, middle)| repeat_n(middle, length));
        let step = section.block / 2.0 / section.range;
        for ((mean, row), middle) in means.zip(middles) {
            *mean = [0, 1, 2].map(|c| {
                let offset = f64::from(short(row, 2 * c)) - section.range;
                (offset * step + f64::from(float(middle, 4 * c))) as f32
            });
        }
    }
    let [scales_at, quats_at, color_at, harmonics_at] = level.places();
    for (i, row) in (first..).zip(rows.clone()) {
        base.log_scales[i] = [0, 1, 2].map(|c| level.number(&row[scales_at..], c).ln());
        base.quats[i] = [0, 1, 2, 3].map(|c| level.number(&row[quats_at..], c));
        base.colors[i] = [0, 1, 2].map(|c| f32::from(row[color_at + c]) / 255.0);
        base.logit_opacities[i] = logit_of_byte(row[color_at + 3]);
    }
    let bands = gaussians.layout().harmonics();
    for (l, band) in (1..=section.sh_degree).zip(bands) {
        let (before, orders) = (3 * (l * l - 1), 2 * l + 1);
        let values = gaussians.values_mut(band).chunks_exact_mut(3 * orders).skip(first);
        for (values, row) in values.zip(rows.clone()) {
            for (k, value) in values.iter_mut().enumerate() {
                *value = table.coefficient(&row[harmonics_at..], before + k % 3 * orders + k / 3);
            }
        }
    }
    Ok(())
}

/// How numbers are rounded: the compression level of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Level {
    Floats,
    Halves,
    /// As [`Self::Halves`], but for harmonics.
    Bytes,
}

impl Level {
    fn of(number: u16) -> Option<Self> {
        [Self::Floats, Self::Halves, Self::Bytes].get(usize::from(number)).copied()
    }

    /// Whether numbers are 32-bit floats.
    fn is_whole(self) -> bool {
        self == Self::Floats
    }

    /// Where a row has scales, rotation, colour, and harmonics.
    fn places(self) -> [usize; 4] {
        if self.is_whole() { [12, 24, 40, 44] } else { [6, 12, 20, 24] }
    }

    /// Bytes of a coefficient of harmonics.
    fn coefficient_bytes(self) -> usize {
        match self {
            Self::Floats => 4,
            Self::Halves => 2,
            Self::Bytes => 1,
        }
    }

    /// A number of an array of scales or rotations.
    fn number(self, array: &[u8], index: usize) -> f32 {
        if self.is_whole() { float(array, 4 * index) } else { half(array, 2 * index) }
    }
}

fn float(bytes: &[u8], at: usize) -> f32 {
    f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn short(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes([bytes[at], bytes[at + 1]])
}

/// A binary16 of IEEE 754.
fn half(bytes: &[u8], at: usize) -> f32 {
    let bits = short(bytes, at);
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f32::from(bits & 1023));
    let size = match exponent {
        0 => fraction * 2.0_f32.powi(-24),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1024.0 + fraction) * 2.0_f32.powi(exponent - 25),
    };
    if bits >> 15 == 1 { -size } else { size }
}

#[cfg(test)]
mod tests;
