//! Description of a file for people: sections, sizes, checksums and statistics; and the application data of a file.

use std::collections::BTreeMap;
use std::ops::Range;

use tcgs_core::Attribute;

use super::FORMAT_VERSION;
use super::archive::{Archive, Opening};
use super::decode::{decode, open_whole};
use super::section::{SHARED, name};
use crate::compact::SceneInfo;
use crate::error::DecodeError;
use crate::limits::DecodeLimits;

/// Description of a file, made by [`inspect`].
#[derive(Clone, Debug, PartialEq)]
pub struct FileInfo {
    /// Version of the format.
    pub version: u16,
    /// Length of the file in bytes.
    pub bytes: u64,
    /// Length of the file in bytes as its table of contents says; more than [`Self::bytes`] if the file was cut.
    pub bytes_before: u64,
    /// All sections, in the order of the file.
    pub sections: Vec<SectionInfo>,
    /// For every segment its timesteps and its range of bytes in the file.
    pub segments: Vec<(Range<usize>, Range<u64>)>,
    /// `[layers]`: number of Gaussians of each layer.
    pub layers: Vec<u32>,
    /// Axis-aligned bounding box of all means at all timesteps, in scene units: the smallest and the largest
    /// coordinates.
    pub bounds: [[f32; 3]; 2],
    /// Statistics of the decoded scene; none if a section is damaged or missing.
    pub contents: Option<Contents>,
}

/// One section of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SectionInfo {
    /// Name of the kind of section, such as `maps`; [`Attribute::name`] for a section with codes of an attribute.
    pub name: &'static str,
    /// Index of the segment that the section belongs to; none if all segments share the section.
    pub segment: Option<usize>,
    /// Index of the layer that the section belongs to; 0 if the section belongs to none.
    pub layer: usize,
    /// Length of the section in bytes, without its entry in the table of contents.
    pub bytes: u64,
    /// Whether all bytes of the section are there; false only of a file that was cut.
    pub is_whole: bool,
    /// Whether the CRC-32 of the section agrees with the table of contents; false if the section is not whole.
    pub checksum_ok: bool,
}

/// Statistics of the scene in an undamaged file.
#[derive(Clone, Debug, PartialEq)]
pub struct Contents {
    /// Counts and provenance of the scene.
    pub info: SceneInfo,
    /// By [`Attribute::index`]: the number of Gaussians of each width in use.
    pub bits_histogram: Vec<BTreeMap<u8, usize>>,
    /// By [`Attribute::index`]: mean number of keypoints of a track.
    pub keypoints_mean: Vec<f64>,
    /// Size as 32-bit floats, in bytes: [`crate::CompactScene::raw_bytes`].
    pub raw_bytes: u64,
    /// Size in the paper's sparse form, in bytes: [`crate::CompactScene::plain_bytes`].
    pub plain_bytes: u64,
}

impl FileInfo {
    /// Whether the checksums of all sections are right.
    pub fn checksums_ok(&self) -> bool {
        self.sections.iter().all(|s| s.checksum_ok)
    }

    /// By [`Attribute::index`]: total length of the sections with codes of the attribute, in bytes. Bit widths and all
    /// else lie in other sections.
    pub fn bytes_by_attribute(&self) -> [u64; 5] {
        Attribute::BASE.map(|a| self.sections.iter().filter(|s| s.name == a.name()).map(|s| s.bytes).sum())
    }
}

/// Describes a file. A wrong checksum is an error in the header, `INFO` and `PLAN`; in any other section it is reported
/// by [`SectionInfo::checksum_ok`].
///
/// - `file`: all bytes of the file
/// - `limits`: bounds on memory and counts
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneInfo, compress, encode, inspect};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
/// let info = inspect(&encode(&compact)?, &DecodeLimits::default())?;
/// assert!(info.checksums_ok() && info.segments.len() == 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// - [`DecodeError::Format`] if the header, `INFO` or `PLAN` is damaged, the file is truncated or followed by other
///   bytes, or a file of right checksums breaks a rule of the format
/// - [`DecodeError::Version`] if the file is of another version
/// - [`DecodeError::Limit`] if decoding exceeds `limits`
pub fn inspect(file: &[u8], limits: &DecodeLimits) -> Result<FileInfo, DecodeError> {
    inspect_archive(file, limits, &open_whole(file, limits)?)
}

/// [`inspect`] of a file that may have been cut: sections that are not whole are reported by
/// [`SectionInfo::is_whole`].
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneInfo, compress, encode, inspect_cut};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let file = encode(&compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?)?;
/// let info = inspect_cut(&file[..file.len() - 1], &DecodeLimits::default())?;
/// assert_eq!(info.sections.iter().filter(|section| !section.is_whole).count(), 1);
/// assert_eq!(info.bytes_before - info.bytes, 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As [`inspect`], of a file that was cut only if the header, `INFO` or `PLAN` is not whole.
pub fn inspect_cut(file: &[u8], limits: &DecodeLimits) -> Result<FileInfo, DecodeError> {
    match Archive::open(file, limits)? {
        Opening::Ready(archive) if archive.file_bytes() > file.len() as u64 => inspect_archive(file, limits, &archive),
        _ => inspect(file, limits),
    }
}

fn inspect_archive(file: &[u8], limits: &DecodeLimits, archive: &Archive) -> Result<FileInfo, DecodeError> {
    let sections = archive.entries().iter().map(|entry| {
        let bytes = file.get(entry.range.start as usize..entry.range.end as usize);
        SectionInfo {
            name: name(entry.tag),
            segment: (entry.segment != SHARED).then_some(entry.segment.into()),
            layer: entry.layer.into(),
            bytes: entry.range.end - entry.range.start,
            is_whole: bytes.is_some(),
            checksum_ok: bytes.is_some_and(|bytes| entry.open(bytes).is_ok()),
        }
    });
    let layers = archive.num_layers();
    let mut file_info = FileInfo {
        version: FORMAT_VERSION,
        bytes: file.len() as u64,
        bytes_before: archive.file_bytes(),
        sections: sections.collect(),
        segments: (0..archive.num_segments())
            .map(|segment| (archive.timesteps(segment), archive.segment_range(segment, layers)))
            .collect(),
        layers: archive.layers().to_vec(),
        bounds: archive.bounds(),
        contents: None,
    };
    if file_info.checksums_ok() {
        let scene = decode(file, limits)?;
        file_info.contents = Some(Contents {
            bits_histogram: scene.bit_map.histogram(),
            keypoints_mean: scene.keypoints_mean(),
            raw_bytes: scene.raw_bytes(),
            plain_bytes: scene.plain_bytes(),
            info: scene.info,
        });
    }
    Ok(file_info)
}

/// Application data of a file, as [`encode_with`](crate::encode_with) wrote them.
///
/// - `file`: all bytes of the file
/// - `limits`: bounds on memory and counts
/// - returns: name and content of each piece, in the order of the file, without those that lack a name in UTF-8
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneInfo, application_data, compress, encode_with};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
/// let file = encode_with(&compact, &[("notes", b"a red ball")])?;
/// assert_eq!(application_data(&file, &DecodeLimits::default())?, [("notes".to_owned(), &b"a red ball"[..])]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// As [`inspect`] for the start of the file; also [`DecodeError::Format`] if a section of application data is damaged.
pub fn application_data<'a>(file: &'a [u8], limits: &DecodeLimits) -> Result<Vec<(String, &'a [u8])>, DecodeError> {
    let archive = open_whole(file, limits)?;
    let of_range = |(index, range): (usize, Range<u64>)| {
        archive.read_application(index, &file[range.start as usize..range.end as usize]).transpose()
    };
    archive.application_ranges().into_iter().enumerate().filter_map(of_range).collect()
}
