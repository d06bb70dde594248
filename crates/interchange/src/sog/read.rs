//! Reads a SOG, packed or not. Nothing is allocated by a number of the file before it was compared with the limits.

use std::borrow::Cow;
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{BufReader, Cursor, Read};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use image_webp::WebPDecoder;
use tcgs_core::{Attribute, Gaussians, Layout, MAX_SH_DEGREE};
use zip::ZipArchive;

use super::{
    ANTIALIASED, FIRST_ROTATION, MAX_PALETTE, MAX_POSITION, MAX_SIDE, META, Meta, ROWS_A_LINE, VERSION, coefficients,
};
use crate::axes::Axes;
use crate::stored::{Head, color_from_sh0, logit_of_byte};
use crate::{HigherHarmonics, InterchangeError, ReadSettings, input, parent_folder};

/// Longest `meta.json`. One with three codebooks has 20 kB.
const MAX_META_BYTES: u64 = 1 << 20;
/// Deflate cannot shrink by more than this (RFC 1951: 258 bytes from 2 bits).
const MAX_DEFLATE_RATIO: u64 = 1032;
/// Bytes that decoding a pixel holds: the pixel as it is decoded, and with alpha.
const BYTES_A_PIXEL: u64 = 8;

/// Whether names are those of SOG: a table, in any folder, and images.
pub(crate) fn is_sog(names: &[String]) -> bool {
    names.iter().any(|name| is_meta(name)) && names.iter().any(|name| name.ends_with(".webp"))
}

fn is_meta(name: &str) -> bool {
    name.strip_suffix(META).is_some_and(|folder| folder.is_empty() || folder.ends_with('/'))
}

/// Whether a path is that of the table of an unpacked SOG, by its name.
pub(crate) fn is_table(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name == META)
}

/// The table in a folder that is an unpacked SOG. None if the folder is none, or cannot be read.
pub(crate) fn table_in(folder: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(folder).ok()?.flatten();
    let names: Vec<String> = entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    is_sog(&names).then(|| folder.join(META))
}

/// The images that the table of an unpacked SOG names; empty if the table cannot be read.
pub(crate) fn images_of(table: &Path) -> Vec<PathBuf> {
    let meta = SogFile::open(table, ReadSettings::default()).ok();
    let names = meta.iter().flat_map(|file| file.meta.images());
    names.filter_map(|name| beside(parent_folder(table), name)).collect()
}

/// A file in a folder. None if the name is that of a file elsewhere, or of none.
fn beside(folder: &Path, name: &str) -> Option<PathBuf> {
    let is_plain = Path::new(name).components().eq([Component::Normal(name.as_ref())]);
    Some(folder.join(name)).filter(|file| is_plain && file.is_file())
}

/// Whether [`read_gaussians`](crate::read_gaussians) takes a file for a SOG: a ZIP archive of one, or a `meta.json`
/// beside images. False if it cannot be read.
pub fn is_sog_file(path: &Path) -> bool {
    if is_table(path) {
        return table_in(parent_folder(path)).is_some();
    }
    let archive = File::open(path).ok().and_then(|file| ZipArchive::new(BufReader::new(file)).ok());
    archive.is_some_and(|archive| is_sog(&archive.file_names().flatten().map(Cow::into_owned).collect::<Vec<_>>()))
}

/// Reads the Gaussians of one SOG file, or of an unpacked SOG, in stored form. Numbers need not be finite.
///
/// # Errors
/// [`InterchangeError::Read`] if the file cannot be read; [`InterchangeError::File`] if the file is not a complete SOG
/// file of version 2 with images that are lossless, or has no Gaussian; [`InterchangeError::Limit`] if it claims more
/// memory than the settings allow.
pub(crate) fn read_sog(path: &Path, settings: ReadSettings) -> Result<Gaussians, InterchangeError> {
    let mut file = SogFile::open(path, settings)?;
    let mut gaussians = Gaussians::zeros_of(&file.layout, file.meta.count);
    file.read_means(&mut gaussians)?;
    file.read_quats(&mut gaussians)?;
    file.read_scales(&mut gaussians)?;
    file.read_colors(&mut gaussians)?;
    file.read_harmonics(&mut gaussians)?;
    settings.axes.unwrap_or(Axes::RDF).turn(&mut gaussians);
    Ok(gaussians)
}

/// Reads the table of a SOG file.
///
/// # Errors
/// As [`read_sog`], but for errors that only the images show.
pub(crate) fn read_head(path: &Path, settings: ReadSettings) -> Result<Head, InterchangeError> {
    let SogFile { meta, layout, .. } = SogFile::open(path, settings)?;
    Ok(Head { num_gaussians: meta.count, layout })
}

/// Where a table and its images are.
enum Source {
    /// Entries of an archive. Their names begin with that of a folder, which may be empty.
    Archive(ZipArchive<BufReader<File>>, String),
    /// Files in a folder.
    Folder(PathBuf),
}

/// A file whose table was read and checked.
struct SogFile<'a> {
    path: &'a Path,
    settings: ReadSettings,
    /// Of all files.
    file_bytes: u64,
    source: Source,
    meta: Meta,
    /// Layout of the Gaussians after reading.
    layout: Arc<Layout>,
}

/// A decoded image.
struct Pixels {
    bytes: Vec<u8>,
    /// 4, or 3 without alpha.
    channels: usize,
    width: usize,
}

impl Pixels {
    /// The pixels in turn, line by line.
    fn iter(&self) -> impl Iterator<Item = [u8; 4]> {
        self.bytes.chunks_exact(self.channels).map(|pixel| match *pixel {
            [red, green, blue, alpha] => [red, green, blue, alpha],
            [red, green, blue] => [red, green, blue, 255],
            _ => [0; 4],
        })
    }
}

/// The coordinate of a share of a range of logarithms.
///
/// - `bytes`: of the share, the low one first
fn coordinate(min: f64, max: f64, bytes: [u8; 2]) -> f32 {
    let logarithm = min + (max - min) * (f64::from(u16::from_le_bytes(bytes)) / MAX_POSITION);
    logarithm.abs().exp_m1().copysign(logarithm) as f32
}

/// `w, x, y, z`, unit up to rounding.
fn rotation([a, b, c, kind]: [u8; 4]) -> Option<[f32; 4]> {
    let which = usize::from(kind.checked_sub(FIRST_ROTATION)?);
    let others = [a, b, c].map(|byte| std::f64::consts::SQRT_2 * (f64::from(byte) / 255.0 - 0.5));
    let largest = (1.0 - others.iter().map(|x| x * x).sum::<f64>()).max(0.0).sqrt();
    let mut others = others.into_iter();
    Some(std::array::from_fn(|c| if c == which { largest } else { others.next().unwrap_or(0.0) } as f32))
}

impl<'a> SogFile<'a> {
    fn open(path: &'a Path, settings: ReadSettings) -> Result<Self, InterchangeError> {
        let invalid = |problem| InterchangeError::File { path: path.into(), problem };
        let (file, mut file_bytes) = input::open(path)?;
        let mut source = if is_table(path) {
            Source::Folder(parent_folder(path).into())
        } else {
            let archive = ZipArchive::new(BufReader::new(file));
            let archive = archive.map_err(|error| invalid(format!("{error}, expected a whole SOG file")))?;
            let Some(name) = archive.file_names().flatten().find(|name| is_meta(name)).map(Cow::into_owned) else {
                return Err(invalid(format!("has no {META}, expected a SOG file")));
            };
            Source::Archive(archive, name[..name.len() - META.len()].to_owned())
        };
        let bytes = source.read(path, file_bytes, META, |size| {
            let problem = format!("has {META} of {size} bytes, expected at most {MAX_META_BYTES}");
            if size > MAX_META_BYTES { Err(invalid(problem)) } else { Ok(()) }
        })?;
        let meta = parse(&bytes).map_err(invalid)?;
        if let Source::Folder(folder) = &source {
            let images = meta.images().into_iter().filter_map(|name| beside(folder, name)?.metadata().ok());
            file_bytes = images.fold(file_bytes, |sum, image| sum.saturating_add(image.len()));
        }
        let sh_degree = match (settings.higher_harmonics, &meta.sh_n) {
            (HigherHarmonics::Keep, Some(harmonics)) => harmonics.bands,
            _ => 0,
        };
        let is_antialiased = meta.model.as_deref() == Some(ANTIALIASED);
        let layout = Layout::with_harmonics(sh_degree).antialiased(is_antialiased);
        let opened = Self { path, settings, file_bytes, source, meta, layout };
        // Each Gaussian has a pixel in each image.
        opened.check_bytes((opened.meta.count as u64).saturating_mul(BYTES_A_PIXEL))?;
        Ok(opened)
    }

    fn invalid(&self, problem: String) -> InterchangeError {
        InterchangeError::File { path: self.path.into(), problem }
    }

    /// Refuses what is held beside the Gaussians if both together are too large.
    fn check_bytes(&self, further: u64) -> Result<(), InterchangeError> {
        let floats = self.layout.raw_bytes(self.meta.count, 1);
        self.settings.limits.check_bytes(self.path, self.file_bytes, floats.saturating_add(further))
    }

    /// Decodes an image of at least so many pixels.
    fn image(&mut self, name: &str, num_pixels: usize) -> Result<Pixels, InterchangeError> {
        let invalid = |problem| InterchangeError::File { path: self.path.into(), problem };
        let (settings, path, file_bytes) = (self.settings, self.path, self.file_bytes);
        let check = |size| settings.limits.check_bytes(path, file_bytes, size);
        let bytes = self.source.read(path, file_bytes, name, check)?;
        let damaged =
            |error: image_webp::DecodingError| invalid(format!("{name}: {error}, expected a lossless WebP image"));
        let length = bytes.len() as u64;
        let mut decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(damaged)?;
        if decoder.is_lossy() || decoder.is_animated() {
            let kind = if decoder.is_animated() { "animated" } else { "lossy" };
            return Err(invalid(format!("{name} is {kind}, expected a lossless WebP image")));
        }
        let (width, height) = decoder.dimensions();
        let size = u64::from(width) * u64::from(height);
        if size < num_pixels as u64 {
            return Err(invalid(format!("{name} has {size} pixels, expected at least {num_pixels}")));
        }
        self.check_bytes(length.saturating_add(BYTES_A_PIXEL.saturating_mul(size)))?;
        let channels = if decoder.has_alpha() { 4 } else { 3 };
        let mut bytes = vec![0; size as usize * channels];
        decoder.read_image(&mut bytes).map_err(damaged)?;
        Ok(Pixels { bytes, channels, width: width as usize })
    }

    fn read_means(&mut self, gaussians: &mut Gaussians) -> Result<(), InterchangeError> {
        let [low, high] = self.meta.means.files.clone();
        let (low, high) = (self.image(&low, self.meta.count)?, self.image(&high, self.meta.count)?);
        let (mins, maxs) = (self.meta.means.mins, self.meta.means.maxs);
        for ((mean, low), high) in gaussians.means_mut().iter_mut().zip(low.iter()).zip(high.iter()) {
            *mean = std::array::from_fn(|c| coordinate(mins[c], maxs[c], [low[c], high[c]]));
        }
        Ok(())
    }

    fn read_quats(&mut self, gaussians: &mut Gaussians) -> Result<(), InterchangeError> {
        let [name] = self.meta.quats.files.clone();
        let pixels = self.image(&name, self.meta.count)?;
        for (i, (quat, pixel)) in gaussians.quats_mut().iter_mut().zip(pixels.iter()).enumerate() {
            let Some(found) = rotation(pixel) else {
                let kind = pixel[3];
                return Err(self.invalid(format!("{name} has alpha {kind} at Gaussian {i}, expected 252 to 255")));
            };
            *quat = found;
        }
        Ok(())
    }

    fn read_scales(&mut self, gaussians: &mut Gaussians) -> Result<(), InterchangeError> {
        let [name] = self.meta.scales.files.clone();
        let pixels = self.image(&name, self.meta.count)?;
        let value = self.decoder(&name, &self.meta.scales.codebook);
        for (i, (scales, pixel)) in gaussians.log_scales_mut().iter_mut().zip(pixels.iter()).enumerate() {
            *scales = value(pixel, i)?;
        }
        Ok(())
    }

    fn read_colors(&mut self, gaussians: &mut Gaussians) -> Result<(), InterchangeError> {
        let [name] = self.meta.sh0.files.clone();
        let pixels = self.image(&name, self.meta.count)?;
        let value = self.decoder(&name, &self.meta.sh0.codebook);
        let base = gaussians.views_mut();
        let targets = base.colors.iter_mut().zip(base.logit_opacities);
        for (i, ((color, logit), pixel)) in targets.zip(pixels.iter()).enumerate() {
            *color = value(pixel, i)?.map(color_from_sh0);
            *logit = logit_of_byte(pixel[3]);
        }
        Ok(())
    }

    /// Looks a pixel's places up in a codebook. Takes the index of the Gaussian, or of the palette's row, for messages.
    fn decoder(&self, name: &str, codebook: &[f32]) -> impl Fn([u8; 4], usize) -> Result<[f32; 3], InterchangeError> {
        move |[red, green, blue, _], i| {
            let mut values = [0.0; 3];
            for (value, place) in values.iter_mut().zip([red, green, blue]) {
                *value = *codebook.get(usize::from(place)).ok_or_else(|| {
                    let length = codebook.len();
                    self.invalid(format!("{name} has place {place} at {i}, expected one of {length} in its codebook"))
                })?;
            }
            Ok(values)
        }
    }

    /// Reads the columns of degree 1 and above, if the layout has any.
    fn read_harmonics(&mut self, gaussians: &mut Gaussians) -> Result<(), InterchangeError> {
        let bands: Vec<Attribute> = self.layout.harmonics();
        let Some(harmonics) = self.meta.sh_n.as_ref().filter(|_| !bands.is_empty()) else { return Ok(()) };
        let (count, of_row) = (harmonics.count, coefficients(harmonics.bands));
        let [centroids, labels] = harmonics.files.clone();
        let pixels = self.image(&centroids, count * of_row)?;
        if pixels.width != ROWS_A_LINE * of_row {
            let (width, expected) = (pixels.width, ROWS_A_LINE * of_row);
            return Err(self.invalid(format!("{centroids} is {width} pixels wide, expected {expected}")));
        }
        let harmonics = self.meta.sh_n.as_ref().map_or(&[][..], |harmonics| &harmonics.codebook);
        let value = self.decoder(&centroids, harmonics);
        let palette = pixels.iter().take(count * of_row).enumerate();
        let palette = palette.map(|(i, pixel)| value(pixel, i / of_row)).collect::<Result<Vec<[f32; 3]>, _>>()?;
        drop(value);
        let pixels = self.image(&labels, self.meta.count)?;
        for (i, [low, high, ..]) in pixels.iter().take(self.meta.count).enumerate() {
            let place = usize::from(u16::from_le_bytes([low, high]));
            let Some(row) = palette.chunks_exact(of_row).nth(place) else {
                return Err(self.invalid(format!("{labels} has row {place} at Gaussian {i}, expected one of {count}")));
            };
            let mut row = row.as_flattened();
            for &band in &bands {
                let (own, behind) = row.split_at(band.components());
                gaussians.values_mut(band)[i * band.components()..][..band.components()].copy_from_slice(own);
                row = behind;
            }
        }
        Ok(())
    }
}

/// Parses and checks a table, or says what is wrong with it.
fn parse(bytes: &[u8]) -> Result<Meta, String> {
    let damaged = |error: serde_json::Error| format!("{META}: {error}, expected the table of a SOG file");
    let value: serde_json::Value = serde_json::from_slice(bytes).map_err(damaged)?;
    if value.get("version").and_then(serde_json::Value::as_u64) != Some(VERSION.into()) {
        let found = value.get("version").map_or_else(|| "1".into(), ToString::to_string);
        return Err(format!("is SOG of version {found}, expected version {VERSION}"));
    }
    let meta: Meta = serde_json::from_value(value).map_err(damaged)?;
    if meta.count == 0 {
        return Err("holds no Gaussian, expected at least one".into());
    }
    // Pixels of the largest image.
    if meta.count > MAX_SIDE * MAX_SIDE {
        return Err(format!("has {} Gaussians, expected at most {}", meta.count, MAX_SIDE * MAX_SIDE));
    }
    if let Some(harmonics) = &meta.sh_n {
        let (bands, count) = (harmonics.bands, harmonics.count);
        if !(1..=MAX_SH_DEGREE).contains(&bands) {
            return Err(format!("has spherical harmonics of degree {bands}, expected 1 to {MAX_SH_DEGREE}"));
        }
        if count > MAX_PALETTE {
            return Err(format!("has a palette of {count} rows, expected at most {MAX_PALETTE}"));
        }
    }
    Ok(meta)
}

impl Meta {
    /// The names of all images, each once.
    fn images(&self) -> BTreeSet<&str> {
        let [low, high] = &self.means.files;
        let single = [&self.quats.files, &self.scales.files, &self.sh0.files].map(|[name]| name);
        let harmonics = self.sh_n.iter().flat_map(|harmonics| &harmonics.files);
        [low, high].into_iter().chain(single).chain(harmonics).map(String::as_str).collect()
    }
}

impl Source {
    /// The bytes of a file.
    ///
    /// - `path`: of the SOG, for messages
    /// - `check`: gets their number before any is allocated
    fn read(
        &mut self,
        path: &Path,
        file_bytes: u64,
        name: &str,
        check: impl FnOnce(u64) -> Result<(), InterchangeError>,
    ) -> Result<Vec<u8>, InterchangeError> {
        let invalid = |problem| InterchangeError::File { path: path.into(), problem };
        let damaged = |error: &dyn std::fmt::Display| invalid(format!("{name}: {error}, expected a whole SOG file"));
        let missing = || invalid(format!("has no {name}, expected the files that {META} names"));
        let mut bytes = Vec::new();
        let size = match self {
            Self::Archive(archive, folder) => {
                let full = format!("{folder}{name}");
                if archive.index_for_name(&full).is_none() {
                    return Err(missing());
                }
                let mut entry = archive.by_name(&full).map_err(|error| damaged(&error))?;
                let size = entry.size();
                if size > entry.compressed_size().min(file_bytes).saturating_mul(MAX_DEFLATE_RATIO) {
                    return Err(damaged(&"ends early"));
                }
                check(size)?;
                // One byte more than promised, so that a longer entry is noticed.
                entry.by_ref().take(size.saturating_add(1)).read_to_end(&mut bytes).map_err(|error| damaged(&error))?;
                size
            }
            Self::Folder(folder) => {
                let image = beside(folder, name).ok_or_else(missing)?;
                let (file, size) = input::open(&image)?;
                check(size)?;
                file.take(size).read_to_end(&mut bytes).map_err(|error| damaged(&error))?;
                size
            }
        };
        if bytes.len() as u64 != size {
            return Err(damaged(&format!("has {} bytes instead of {size}", bytes.len())));
        }
        Ok(bytes)
    }
}
