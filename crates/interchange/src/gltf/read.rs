//! Reads the Gaussians that the scene of a glTF file shows.

use std::io::{BufReader, Read};
use std::path::Path;

use tcgs_core::{Gaussians, Layout};

use super::buffers::{Buffers, Files};
use super::document::{Document, Placed, Primitive};
use super::{BIN, JSON, attribute, harmonic};
use crate::axes::Axes;
use crate::stored::{Head, color_from_sh0, logit};
use crate::{HigherHarmonics, InterchangeError, ReadSettings, input};

/// Whether bytes are the beginning of a glTF file: of a `.glb`, or of JSON.
pub(crate) fn is_gltf(start: &[u8]) -> bool {
    let text = start.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(start);
    start.starts_with(b"glTF") || text.trim_ascii_start().starts_with(b"{")
}

/// Reads the Gaussians of one glTF file, `.glb` or `.gltf`, in stored form and in the axes of PLY files: those of all
/// primitives, one after another.
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::File`] if the file is not complete, shows
/// no Gaussians, has them in a way that is not read, or holds a number out of range; [`InterchangeError::Limit`] if it
/// claims more memory than the settings allow.
pub(crate) fn read_gltf(path: &Path, settings: ReadSettings) -> Result<Gaussians, InterchangeError> {
    let problem = |problem| InterchangeError::File { path: path.into(), problem };
    let Opened { document, chunk, length } = open(path, Wanted::All)?;
    let (Head { layout, .. }, files) = head(path, &document, length, settings)?;
    let placed = document.placed(usize::MAX).map_err(problem)?;
    let buffers = Buffers::open(&document, &files, chunk).map_err(problem)?;
    let mut parts = Vec::new();
    for Placed { primitive, placement } in &placed {
        let mut part = gaussians(&buffers, primitive, layout.sh_degree()).map_err(problem)?;
        placement.apply(&mut part);
        parts.push(part.extended(&layout));
    }
    let mut gaussians = Gaussians::concat(&layout, &parts);
    settings.axes.unwrap_or(Axes::LUF).turn(&mut gaussians);
    Ok(gaussians)
}

/// Reads the number of Gaussians that a glTF file shows.
///
/// # Errors
/// As [`read_gltf`], except for errors that only the numbers show.
pub(crate) fn read_head(path: &Path, settings: ReadSettings) -> Result<Head, InterchangeError> {
    let Opened { document, length, .. } = open(path, Wanted::Document)?;
    Ok(head(path, &document, length, settings)?.0)
}

/// Rough memory of a primitive besides its numbers: names and a dozen arrays.
const PRIMITIVE_BYTES: u64 = 1024;

/// Counts the Gaussians of a document, finds the files that it names, and compares both with the limits.
///
/// - `length`: of the document's file
fn head(
    path: &Path,
    document: &Document,
    length: u64,
    settings: ReadSettings,
) -> Result<(Head, Files), InterchangeError> {
    let problem = |problem| InterchangeError::File { path: path.into(), problem };
    let files = Files::find(document, path).map_err(problem)?;
    let file_bytes = length.saturating_add(files.num_bytes());
    let most = usize::try_from(settings.limits.bytes(file_bytes) / PRIMITIVE_BYTES).unwrap_or(usize::MAX).max(1);
    let placed = document.placed(most).map_err(problem)?;
    let head = count(document, &placed, settings).map_err(problem)?;
    // The file, its buffers, the numbers of accessors, the parts, and the whole.
    let gaussians = (head.num_gaussians as u64).saturating_mul(head.layout.raw_bytes(1, 1)).saturating_mul(3);
    let parts = PRIMITIVE_BYTES.saturating_mul(placed.len() as u64);
    let needed = file_bytes.saturating_mul(2).saturating_add(gaussians).saturating_add(parts);
    settings.limits.check_bytes(path, file_bytes, needed)?;
    Ok((head, files))
}

fn count(document: &Document, placed: &[Placed], settings: ReadSettings) -> Result<Head, String> {
    let (mut num_gaussians, mut sh_degree) = (0_usize, 0);
    for Placed { primitive, .. } in placed {
        let position = *primitive.attributes.get("POSITION").ok_or_else(|| missing("POSITION"))?;
        let count = document.accessors.get(position).map_or(0, |accessor| accessor.count);
        num_gaussians = num_gaussians.checked_add(count).ok_or("holds too many Gaussians, expected fewer")?;
        if settings.higher_harmonics == HigherHarmonics::Keep {
            sh_degree = sh_degree.max(primitive.sh_degree());
        }
    }
    if num_gaussians == 0 {
        return Err("holds no Gaussian, expected at least one".into());
    }
    Ok(Head { num_gaussians, layout: Layout::with_harmonics(sh_degree) })
}

/// The Gaussians of one primitive in its own axes.
///
/// - `sh_degree`: highest degree to read; the primitive may have fewer
fn gaussians(buffers: &Buffers, primitive: &Primitive, sh_degree: usize) -> Result<Gaussians, String> {
    let mut num_gaussians = None;
    let mut read = |name: &str, components: usize| -> Result<(Vec<f32>, f64), String> {
        let index = *primitive.attributes.get(name).ok_or_else(|| missing(name))?;
        let (values, step) = buffers.read(index, name, components)?;
        let found = values.len() / components;
        let expected = *num_gaussians.get_or_insert(found);
        if found != expected {
            return Err(format!("{name} is of {found} Gaussians, expected {expected}"));
        }
        Ok((values, step))
    };
    let (means, _) = read("POSITION", 3)?;
    let (rotations, _) = read(&attribute("ROTATION"), 4)?;
    let (scales, _) = read(&attribute("SCALE"), 3)?;
    let (opacities, step) = read(&attribute("OPACITY"), 1)?;
    let (colors, _) = read(&harmonic(0, 0), 3)?;
    if let Some(i) = scales.iter().position(|&scale| scale < 0.0) {
        return Err(format!("SCALE of Gaussian {}: {}, expected a number that is not negative", i / 3, scales[i]));
    }
    if let Some(i) = opacities.iter().position(|opacity| !(0.0..=1.0).contains(opacity)) {
        return Err(format!("OPACITY of Gaussian {i}: {}, expected a number from 0 to 1", opacities[i]));
    }
    // Substitutes for 0 and 1: half of the next number for floats, the middle of the values that round to 0 or 1 for
    // integers.
    let nearest = if step > 0.0 { [step / 4.0; 2] } else { [f64::from(f32::from_bits(1)) / 2.0, 2.0_f64.powi(-25)] };
    let mut values = vec![
        means,
        rotations.as_chunks().0.iter().flat_map(|&[x, y, z, w]| [w, x, y, z]).collect(),
        scales.into_iter().map(f32::ln).collect(),
        opacities.iter().map(|&opacity| logit(f64::from(opacity), nearest)).collect(),
        colors.into_iter().map(color_from_sh0).collect(),
    ];
    let sh_degree = sh_degree.min(primitive.sh_degree());
    for l in 1..=sh_degree {
        let coefficients: Vec<Vec<f32>> =
            (0..=2 * l).map(|n| Ok(read(&harmonic(l, n), 3)?.0)).collect::<Result<_, String>>()?;
        let rows = 0..coefficients[0].len() / 3;
        values.push(rows.flat_map(|i| coefficients.iter().flat_map(move |c| c[3 * i..3 * i + 3].to_vec())).collect());
    }
    Ok(Gaussians::new(Layout::with_harmonics(sh_degree), num_gaussians.unwrap_or(0), values))
}

fn missing(name: &str) -> String {
    format!("has no attribute {name}, expected POSITION, ROTATION, SCALE, OPACITY and SH_DEGREE_0_COEF_0")
}

/// The part of a file to read.
#[derive(Clone, Copy, PartialEq)]
enum Wanted {
    Document,
    All,
}

/// The part of a file that was read.
struct Opened {
    document: Document,
    /// The buffer that lies in the file.
    chunk: Option<Vec<u8>>,
    /// Bytes of the file.
    length: u64,
}

/// Reads the JSON of a file, and the buffer that lies in it.
fn open(path: &Path, wanted: Wanted) -> Result<Opened, InterchangeError> {
    let failed = |error| InterchangeError::Read { path: path.into(), error };
    let invalid = |problem: String| InterchangeError::File { path: path.into(), problem };
    let (file, length) = input::open(path)?;
    let mut file = BufReader::new(file);
    let mut next = |length: u64| -> Result<Vec<u8>, InterchangeError> {
        let mut bytes = Vec::new();
        file.by_ref().take(length).read_to_end(&mut bytes).map_err(failed)?;
        Ok(bytes)
    };
    let ends_early = || invalid("ends early, expected a whole glTF file".into());
    let start = next(12)?;
    let (json, chunk) = if start.starts_with(b"glTF") {
        let Some(&[_, _, _, _, a, b, c, d, ..]) = start.first_chunk::<12>() else { return Err(ends_early()) };
        let version = u32::from_le_bytes([a, b, c, d]);
        if version != 2 {
            return Err(invalid(format!("is glTF of version {version}, expected 2")));
        }
        let mut chunk = |expected: u32| -> Result<Option<Vec<u8>>, InterchangeError> {
            let head = next(8)?;
            let Some(&[a, b, c, d, kind @ ..]) = head.first_chunk::<8>() else {
                return if head.is_empty() { Ok(None) } else { Err(ends_early()) };
            };
            let length = u32::from_le_bytes([a, b, c, d]);
            let content = next(length.into())?;
            if content.len() < length as usize {
                return Err(ends_early());
            }
            Ok((u32::from_le_bytes(kind) == expected).then_some(content))
        };
        let json = chunk(JSON)?.ok_or_else(|| invalid("has no chunk JSON, expected it first".into()))?;
        (json, if wanted == Wanted::All { chunk(BIN)? } else { None })
    } else {
        ([start, next(u64::MAX)?].concat(), None)
    };
    let json = json.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(&json);
    let document = serde_json::from_slice(json).map_err(|error| invalid(format!("{error}, expected a glTF file")))?;
    Ok(Opened { document, chunk, length })
}
