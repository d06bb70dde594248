//! One SPZ file of Niantic, versions 2 to 4: one timestep. Versions 3 and 4 are written, too (`write`).
//! What does not live here: what the bytes of the arrays mean (`unpack`).
//!
//! A header of 16 bytes, little-endian, in versions 2 and 3 the start of a gzip stream, in version 4 plain and followed
//! by 16 more:
//!
//! | bytes | field | here |
//! |---|---|---|
//! | 0–3 | `NGSP` | |
//! | 4–7 | version | 2, 3 or 4 |
//! | 8–11 | number of Gaussians | at least 1 |
//! | 12 | degree of the harmonics | 0 to 3; version 4 allows 4 |
//! | 13 | fractional bits of positions | at most 24 |
//! | 14 | flags | 1: drawn with antialiasing ([`Layout::is_antialiased`]); 2: has extensions |
//! | 15 | version 4: number of streams | 6, or 5 without harmonics |
//! | 16–19 | version 4: place of the streams' table | at least 32 |
//! | 20–31 | version 4: reserved | not read |
//!
//! Six arrays follow, one Gaussian after another in each: positions, opacities, colours, scales, rotations, harmonics.
//! In versions 2 and 3 they lie behind the header. In version 4 each is a Zstandard frame of its own; the table has the
//! compressed and the plain length of each in 64 bits, and the frames lie behind the table.
//!
//! Extensions are records of a type, a length and so many bytes. They lie between header and table in version 4, behind
//! the arrays in versions 2 and 3. The one of type 0xADBE0003 declares the axes of the file. Others do not change the
//! numbers and are ignored.
//!
//! Without that extension, or if it says 0 (unspecified), the axes are assumed to be RDF, those of PLY files. The
//! README of the format says RUB, and its library converts if a program asks for it. But the format's own `ply_to_spz`
//! does not ask for it, and splat-transform 3, gsply, `GaussForge` and spz-js do not convert. splat-transform 2.7 did.
//!
//! Facts: README, `load-spz.cc` and `extensions/` of the format's library (MIT), release 3.0.

mod unpack;
mod write;

use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;
use std::sync::Arc;

use flate2::read::GzDecoder;
use ruzstd::decoding::StreamingDecoder;
use tcgs_core::{Gaussians, Layout, MAX_SH_DEGREE};

use self::unpack::{Arrays, Encoding};
pub use self::write::{SpzVersion, write_spz_to};
use crate::axes::Axes;
use crate::stored::Head;
use crate::{HigherHarmonics, InterchangeError, ReadSettings, input};

/// Length of the header of versions 2 and 3.
const HEADER: usize = 16;
/// Length of the header of version 4.
const HEADER_4: usize = 32;
/// Beyond this a file's extensions are no extensions.
const MAX_EXTENSIONS: u64 = 1 << 20;
/// Axes of a file that declares none.
pub(crate) const ASSUMED_AXES: Axes = Axes::RDF;
/// The extension that says in which axes a file is.
const COORDINATE_SYSTEM: u32 = 0xADBE_0003;
/// Bytes that a byte of gzip can stand for: 258 for two bits.
const MAX_RATIO_GZIP: u64 = 1032;
/// Bytes that a byte of Zstandard can stand for: blocks of 128 KiB for four bytes.
const MAX_RATIO_ZSTANDARD: u64 = (128 << 10) / 4;

/// The header of a file.
struct Header {
    version: u32,
    num_gaussians: usize,
    sh_degree: usize,
    fractional_bits: u8,
    is_antialiased: bool,
    has_extensions: bool,
    /// Of version 4.
    num_streams: u8,
}

impl Header {
    /// Layout of the Gaussians that are read.
    fn layout(&self, settings: ReadSettings) -> Arc<Layout> {
        let sh_degree = if settings.higher_harmonics == HigherHarmonics::Keep { self.sh_degree } else { 0 };
        Layout::with_harmonics(sh_degree).antialiased(self.is_antialiased)
    }
}

/// Reads the Gaussians of one SPZ file, in stored form and in the axes of PLY files. Every number is finite.
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::File`] if the file is not a complete SPZ
/// file of a version from 2 to 4, is in axes that are turned by a quarter, or has no Gaussian;
/// [`InterchangeError::Limit`] if its header claims more than the settings allow.
pub(crate) fn read_spz(path: &Path, settings: ReadSettings) -> Result<Gaussians, InterchangeError> {
    let problem = |problem| InterchangeError::File { path: path.into(), problem };
    let header = open(path, settings)?;
    let (arrays, extensions) = read_arrays(path, &header)?;
    let encoding = Encoding { version: header.version, fractional_bits: header.fractional_bits };
    let mut gaussians = unpack::unpack(&arrays, encoding, header.num_gaussians, &header.layout(settings));
    let axes = match settings.axes {
        Some(axes) => axes,
        None => declared_axes(&extensions).map_err(problem)?.unwrap_or(ASSUMED_AXES),
    };
    axes.turn(&mut gaussians);
    Ok(gaussians)
}

/// Reads the header of an SPZ file.
///
/// # Errors
/// As [`read_spz`], but for what only the rest of the file shows.
pub(crate) fn read_head(path: &Path, settings: ReadSettings) -> Result<Head, InterchangeError> {
    let header = open(path, settings)?;
    Ok(Head { num_gaussians: header.num_gaussians, layout: header.layout(settings) })
}

/// The axes that a file declares; none if it declares none. Without extensions its header suffices; else the whole file
/// is read.
///
/// # Errors
/// As [`read_spz`].
pub(crate) fn read_axes(path: &Path, settings: ReadSettings) -> Result<Option<Axes>, InterchangeError> {
    let header = open(path, settings)?;
    if !header.has_extensions {
        return Ok(None);
    }
    let (_, extensions) = read_arrays(path, &header)?;
    declared_axes(&extensions).map_err(|problem| InterchangeError::File { path: path.into(), problem })
}

/// The arrays and the extensions of a file.
fn read_arrays(path: &Path, header: &Header) -> Result<(Arrays, Vec<u8>), InterchangeError> {
    let problem = |problem| InterchangeError::File { path: path.into(), problem };
    if header.version >= 4 {
        let bytes = std::fs::read(path).map_err(|error| InterchangeError::Read { path: path.into(), error })?;
        streams(&bytes, header).map_err(problem)
    } else {
        one_stream(BufReader::new(input::open(path)?.0), header).map_err(problem)
    }
}

/// Reads and checks the header.
fn open(path: &Path, settings: ReadSettings) -> Result<Header, InterchangeError> {
    let failed = |error| InterchangeError::Read { path: path.into(), error };
    let invalid = |problem: String| InterchangeError::File { path: path.into(), problem };
    let (file, length) = input::open(path)?;
    let mut file = BufReader::new(file);
    let mut bytes = Vec::new();
    file.by_ref().take(HEADER_4 as u64).read_to_end(&mut bytes).map_err(failed)?;
    let is_gzip = bytes.starts_with(&[0x1F, 0x8B]);
    if is_gzip {
        let again = BufReader::new(input::open(path)?.0);
        bytes.clear();
        GzDecoder::new(again).take(HEADER as u64).read_to_end(&mut bytes).map_err(|error| invalid(damaged(&error)))?;
    }
    let Some(fields) = bytes.first_chunk::<HEADER>() else { return Err(invalid(ends_early())) };
    if !fields.starts_with(b"NGSP") {
        return Err(invalid("does not begin with NGSP, expected an SPZ file".into()));
    }
    let number = |at: usize| u32::from_le_bytes([fields[at], fields[at + 1], fields[at + 2], fields[at + 3]]);
    let header = Header {
        version: number(4),
        num_gaussians: number(8) as usize,
        sh_degree: usize::from(fields[12]),
        fractional_bits: fields[13],
        is_antialiased: fields[14] & 1 != 0,
        has_extensions: fields[14] & 2 != 0,
        num_streams: fields[15],
    };
    let (version, max_ratio) = (header.version, if is_gzip { MAX_RATIO_GZIP } else { MAX_RATIO_ZSTANDARD });
    if !matches!((is_gzip, version), (true, 2 | 3) | (false, 4)) {
        let packed = if is_gzip { "packed by gzip" } else { "not packed by gzip" };
        return Err(invalid(format!("is SPZ of version {version}, {packed}, expected version 2 or 3 of gzip, or 4")));
    }
    if header.num_gaussians == 0 {
        return Err(invalid("holds no Gaussian, expected at least one".into()));
    }
    if header.fractional_bits > 24 {
        let bits = header.fractional_bits;
        return Err(invalid(format!("has {bits} fractional bits of positions, expected at most 24")));
    }
    if header.sh_degree > 4 || (header.sh_degree > MAX_SH_DEGREE && settings.higher_harmonics == HigherHarmonics::Keep)
    {
        let degree = header.sh_degree;
        return Err(invalid(format!("has spherical harmonics of degree {degree}, expected 0 to {MAX_SH_DEGREE}")));
    }
    let plain: u64 = sizes(&header).iter().sum();
    if plain > length.saturating_mul(max_ratio) {
        return Err(invalid(ends_early()));
    }
    settings.limits.check_bytes(path, length, held(&header, length, settings))?;
    Ok(header)
}

/// Bytes that reading holds at once: the file, its arrays, the window of a Zstandard frame, and the Gaussians.
fn held(header: &Header, file_bytes: u64, settings: ReadSettings) -> u64 {
    let sizes = sizes(header);
    let (packed, window) = if header.version >= 4 { (file_bytes, sizes.into_iter().max()) } else { (0, None) };
    let floats = header.layout(settings).raw_bytes(header.num_gaussians, 1);
    packed + sizes.iter().sum::<u64>() + window.unwrap_or(0) + floats
}

/// Lengths of the six arrays, in the order of the file.
fn sizes(header: &Header) -> [u64; 6] {
    let rotation = if header.version == 2 { 3 } else { 4 };
    let harmonics = 3 * ((header.sh_degree as u64 + 1).pow(2) - 1);
    [9, 1, 3, 3, rotation, harmonics].map(|bytes| bytes * header.num_gaussians as u64)
}

/// The arrays and the extensions of a file of version 2 or 3, or what is wrong.
fn one_stream(file: impl Read, header: &Header) -> Result<(Arrays, Vec<u8>), String> {
    let mut stream = GzDecoder::new(file);
    let mut next = |length: u64| -> Result<Vec<u8>, String> {
        let mut bytes = Vec::new();
        stream.by_ref().take(length).read_to_end(&mut bytes).map_err(|error| damaged(&error))?;
        Ok(bytes)
    };
    next(HEADER as u64)?;
    let mut arrays = Vec::new();
    for length in sizes(header) {
        let array = next(length)?;
        if array.len() as u64 != length {
            return Err(ends_early());
        }
        arrays.push(array);
    }
    // Reading to the end verifies the checksum of gzip.
    let rest = next(MAX_EXTENSIONS + 1)?;
    if rest.len() as u64 > MAX_EXTENSIONS {
        return Err(format!("holds more than {MAX_EXTENSIONS} bytes behind its Gaussians, expected extensions alone"));
    }
    Ok((arrays, if header.has_extensions { rest } else { vec![] }))
}

/// The arrays and the extensions of a file of version 4, or what is wrong.
fn streams(bytes: &[u8], header: &Header) -> Result<(Arrays, Vec<u8>), String> {
    let table_at =
        bytes.get(16..20).and_then(|at| at.try_into().ok()).map(u32::from_le_bytes).ok_or_else(ends_early)?;
    let sizes = sizes(header);
    let num_streams = sizes.iter().filter(|&&size| size > 0).count();
    if usize::from(header.num_streams) != num_streams {
        return Err(format!("has {} streams, expected {num_streams}", header.num_streams));
    }
    let table_at = table_at as usize;
    let extensions = bytes.get(HEADER_4..table_at).ok_or_else(|| {
        format!("has its table at byte {table_at}, expected it from {HEADER_4} on and inside the file")
    })?;
    let table = bytes.get(table_at..).and_then(|rest| rest.get(..16 * num_streams)).ok_or_else(ends_early)?;
    let mut rest = &bytes[table_at + table.len()..];
    let mut rows = table.as_chunks::<8>().0.iter().map(|number| u64::from_le_bytes(*number));
    let mut arrays = Vec::new();
    for size in sizes {
        if size == 0 {
            arrays.push(vec![]);
            continue;
        }
        let (packed, plain) = (rows.next().unwrap_or(0), rows.next().unwrap_or(0));
        if plain != size {
            return Err(format!("has {plain} bytes in stream {}, expected {size}", arrays.len()));
        }
        let packed = usize::try_from(packed).ok().filter(|&packed| packed <= rest.len()).ok_or_else(ends_early)?;
        let (frame, behind) = rest.split_at(packed);
        rest = behind;
        let decoder = StreamingDecoder::new(frame).map_err(|error| format!("{error}, expected a Zstandard frame"))?;
        let mut array = Vec::new();
        decoder.take(size + 1).read_to_end(&mut array).map_err(|error| damaged(&error))?;
        if array.len() as u64 != size {
            return Err(format!("has {} bytes in stream {}, expected {size}", array.len(), arrays.len()));
        }
        arrays.push(array);
    }
    Ok((arrays, if header.has_extensions { extensions.to_vec() } else { vec![] }))
}

/// The axes that a file's extensions declare; none if they declare none. An error says what is wrong.
fn declared_axes(mut records: &[u8]) -> Result<Option<Axes>, String> {
    let mut axes = None;
    while let Some((head, rest)) = records.split_first_chunk::<8>() {
        let [kind, length] = [0, 4].map(|at| u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]]));
        let content = rest.get(..length as usize).ok_or("has an extension that ends early, expected a whole one")?;
        records = &rest[content.len()..];
        if kind != COORDINATE_SYSTEM {
            continue;
        }
        let system = content.first_chunk().map_or(u32::MAX, |system| u32::from_le_bytes(*system));
        axes = match system {
            // Unspecified, which the format's library takes for a file without the extension.
            0 => None,
            1..=8 => Axes::all().find(|axes| axes_number(*axes) == system),
            _ => {
                return Err(format!("is in coordinate system {system}, expected one of 1 to 8, whose y is up or down"));
            }
        };
    }
    Ok(axes)
}

/// The number of axes in the extension, from 1 on: LDB, RDB, LUB, RUB, LDF, RDF, LUF, RUF. Each letter is a bit.
fn axes_number(axes: Axes) -> u32 {
    let [left, up, back] = axes.against_rdf();
    1 + u32::from(!left) + 2 * u32::from(up) + 4 * u32::from(!back)
}

fn ends_early() -> String {
    "ends early, expected a whole SPZ file".into()
}

fn damaged(error: &std::io::Error) -> String {
    match error.kind() {
        ErrorKind::UnexpectedEof => ends_early(),
        _ => format!("{}, expected a whole SPZ file", error.to_string().replace('\n', " ")),
    }
}

#[cfg(test)]
mod tests;
