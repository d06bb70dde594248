//! What is in a file, for people.

use std::collections::BTreeMap;
use std::ops::Range;

use tcgs_core::Attribute;

use super::FORMAT_VERSION;
use super::decode::{decode, open_whole};
use super::section::{SHARED, name};
use crate::compact::SceneInfo;
use crate::error::DecodeError;
use crate::limits::DecodeLimits;

/// What [`inspect`] finds.
#[derive(Clone, Debug, PartialEq)]
pub struct FileInfo {
    /// Of the format.
    pub version: u16,
    /// Length of the file.
    pub bytes: u64,
    /// In the order of the file.
    pub sections: Vec<SectionInfo>,
    /// Timesteps and bytes of every segment.
    pub segments: Vec<(Range<usize>, Range<u64>)>,
    /// By layer: how many Gaussians it adds.
    pub layers: Vec<u32>,
    /// Smallest and largest coordinates of means.
    pub bounds: [[f32; 3]; 2],
    /// What the sections say; none if one is damaged.
    pub contents: Option<Contents>,
}

/// One section of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SectionInfo {
    /// Such as `maps`; that of an attribute's codes is [`Attribute::name`].
    pub name: &'static str,
    /// Which segment it belongs to; none if all share it.
    pub segment: Option<usize>,
    /// Which layer it belongs to, if it belongs to any.
    pub layer: usize,
    /// Length without the table of contents.
    pub bytes: u64,
    /// Whether its content is what was written.
    pub checksum_ok: bool,
}

/// What the sections of an undamaged file say.
#[derive(Clone, Debug, PartialEq)]
pub struct Contents {
    /// Counts and provenance.
    pub info: SceneInfo,
    /// By [`Attribute::index`]: how many Gaussians have each width.
    pub bits_histogram: Vec<BTreeMap<u8, usize>>,
    /// By [`Attribute::index`]: mean number of keypoints of a track.
    pub keypoints_mean: Vec<f64>,
    /// Size as plain 32-bit floats: [`crate::CompactScene::raw_bytes`].
    pub raw_bytes: u64,
    /// Size in the paper's sparse form: [`crate::CompactScene::plain_bytes`].
    pub plain_bytes: u64,
}

impl FileInfo {
    /// Whether every section is what was written.
    pub fn checksums_ok(&self) -> bool {
        self.sections.iter().all(|s| s.checksum_ok)
    }

    /// By [`Attribute::index`]: bytes of the attribute's codes; bit widths and all else are shared.
    pub fn bytes_by_attribute(&self) -> [u64; 5] {
        Attribute::BASE.map(|a| self.sections.iter().filter(|s| s.name == a.name()).map(|s| s.bytes).sum())
    }
}

/// Looks into a file. A section whose checksum is wrong is reported, not an error, but for those at its start.
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
/// [`DecodeError`] if the header or one of the first two sections is damaged or of another version, the
/// length is wrong, or an undamaged file breaks a rule of the format or asks for more than `limits` allow.
pub fn inspect(file: &[u8], limits: &DecodeLimits) -> Result<FileInfo, DecodeError> {
    let archive = open_whole(file, limits)?;
    let sections = archive.entries().iter().map(|entry| {
        let bytes = &file[entry.range.start as usize..entry.range.end as usize];
        SectionInfo {
            name: name(entry.tag),
            segment: (entry.segment != SHARED).then_some(entry.segment.into()),
            layer: entry.layer.into(),
            bytes: bytes.len() as u64,
            checksum_ok: entry.open(bytes).is_ok(),
        }
    });
    let layers = archive.num_layers();
    let mut file_info = FileInfo {
        version: FORMAT_VERSION,
        bytes: file.len() as u64,
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

/// Data that applications added to a file: for each its name and its bytes.
///
/// # Errors
/// [`DecodeError`] if the header or one of these sections is damaged.
pub fn application_data<'a>(file: &'a [u8], limits: &DecodeLimits) -> Result<Vec<(String, &'a [u8])>, DecodeError> {
    let archive = open_whole(file, limits)?;
    let of_range = |(index, range): (usize, Range<u64>)| {
        archive.read_application(index, &file[range.start as usize..range.end as usize])
    };
    archive.application_ranges().into_iter().enumerate().map(of_range).collect()
}
