//! What is in a file, for people.

use std::collections::BTreeMap;

use tcgs_core::Attribute;

use super::{FORMAT_VERSION, container, decode, section};
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
    /// What the sections say; none if one is damaged.
    pub contents: Option<Contents>,
}

/// One section of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SectionInfo {
    /// Such as `bit map`; that of an attribute's keypoints is [`Attribute::name`].
    pub name: &'static str,
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
    pub bits_histogram: [BTreeMap<u8, usize>; 5],
    /// By [`Attribute::index`]: mean number of keypoints of a track.
    pub keypoints_mean: [f64; 5],
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

    /// By [`Attribute::index`]: bytes of the attribute's keypoints; the bit map and all else are shared.
    pub fn bytes_by_attribute(&self) -> [u64; 5] {
        Attribute::ALL.map(|a| {
            let name = section::of_attribute(a).name;
            self.sections.iter().filter(|s| s.name == name).map(|s| s.bytes).sum()
        })
    }
}

/// Looks into a file. A section whose checksum is wrong is reported, not an error.
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneInfo, compress, encode, inspect};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings);
/// let info = inspect(&encode(&compact), &DecodeLimits::default())?;
/// assert!(info.checksums_ok() && info.sections.len() == 8);
/// # Ok::<(), tcgs_codec::DecodeError>(())
/// ```
///
/// # Errors
/// [`DecodeError`] if the header is damaged or of another version, the length is wrong, or an undamaged
/// file breaks a rule of the format or asks for more than `limits` allow.
pub fn inspect(file: &[u8], limits: &DecodeLimits) -> Result<FileInfo, DecodeError> {
    let parts = container::read(file)?;
    let sections: Vec<SectionInfo> = parts
        .iter()
        .map(|p| SectionInfo { name: p.section.name, bytes: p.bytes.len() as u64, checksum_ok: p.checksum_ok })
        .collect();
    let mut file_info = FileInfo { version: FORMAT_VERSION, bytes: file.len() as u64, sections, contents: None };
    if file_info.checksums_ok() {
        let scene = decode::read_scene(&parts, limits)?;
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
