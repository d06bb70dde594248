//! Description of a file for people: sections, sizes, checksums and statistics. Also the application data of a file.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use tcgs_core::Layout;

use super::archive::{Archive, Opening};
use super::cohort::Cohort;
use super::decode::{decode_cohorts, open_cohorts, open_whole};
use super::section::{Entry, SHARED, name};
use crate::compact::{CompactScene, SceneInfo};
use crate::error::DecodeError;
use crate::limits::DecodeLimits;

/// Description of a file, made by [`inspect`], or without [`Self::contents`] by
/// [`SceneFile::outline`](crate::SceneFile::outline).
#[derive(Clone, Debug, PartialEq)]
pub struct FileInfo {
    /// Version of the format.
    pub version: u16,
    /// Length of the file in bytes.
    pub bytes: u64,
    /// Length of the file in bytes that its table of contents declares; more than [`Self::bytes`] if the file was cut.
    pub bytes_before: u64,
    /// Counts and provenance of the scene.
    pub scene: SceneInfo,
    /// All sections: those of the whole scene, then those of each cohort; in a file of version 1 in the order of the
    /// file.
    pub sections: Vec<SectionInfo>,
    /// All cohorts whose heads are whole.
    pub cohorts: Vec<CohortInfo>,
    /// Axis-aligned bounding box of all means at all timesteps, in scene units: the smallest and the largest
    /// coordinates.
    pub bounds: [[f32; 3]; 2],
    /// By name of the attribute: the largest error against the compressed scene that the file declares
    /// ([`Archive::declared_errors`]).
    pub declared_errors: Vec<(String, f32)>,
    /// Statistics of the decoded scene; `None` if a section is damaged, missing, or was not read.
    pub contents: Option<Contents>,
}

/// One cohort of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct CohortInfo {
    /// Timesteps of the scene that the cohort spans.
    pub timesteps: Range<usize>,
    /// `[layers]`: number of Gaussians of each layer.
    pub layers: Vec<u32>,
    /// For every segment its timesteps of the scene and its range of bytes in the file.
    pub segments: Vec<(Range<usize>, Range<u64>)>,
    /// Which columns the Gaussians have.
    pub layout: Arc<Layout>,
    /// Names of optional attributes that this version of the crate cannot decode, and skips.
    pub skipped: Vec<String>,
}

/// One section of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SectionInfo {
    /// Kind of section, such as `maps`; for codes of an attribute the attribute's name.
    pub name: String,
    /// Index of the cohort that the section belongs to; `None` if it belongs to the whole scene.
    pub cohort: Option<usize>,
    /// Index of the segment that the section belongs to; `None` if all segments share the section.
    pub segment: Option<usize>,
    /// Index of the layer that the section belongs to; 0 if the section belongs to none.
    pub layer: usize,
    /// Length of the section in bytes, without its entry in the table of contents.
    pub bytes: u64,
    /// Whether all bytes of the section are there; false only of a file that was cut.
    pub is_whole: bool,
    /// Whether the CRC-32 of the section matches the table of contents. `Some(false)` if the section is not whole,
    /// `None` if it was not read.
    pub checksum_ok: Option<bool>,
}

/// Statistics of the scene in an undamaged file.
#[derive(Clone, Debug, PartialEq)]
pub struct Contents {
    /// By name of the attribute: the number of Gaussians of each width in use; width 0 counts Gaussians that lack it.
    pub bits_histogram: Vec<(String, BTreeMap<u8, usize>)>,
    /// By name of the attribute: mean number of keypoints of a track.
    pub keypoints_mean: Vec<(String, f64)>,
    /// Size as 32-bit floats, in bytes: [`crate::CompactScene::raw_bytes`].
    pub raw_bytes: u64,
    /// Size in the paper's sparse form, in bytes: [`crate::CompactScene::plain_bytes`].
    pub plain_bytes: u64,
}

impl FileInfo {
    /// Whether all sections were read and all checksums match.
    pub fn checksums_ok(&self) -> bool {
        self.sections.iter().all(|s| s.checksum_ok == Some(true))
    }

    /// By name of the attribute: total length of the sections with its codes, in bytes. Bit widths and all other data
    /// lie in other sections.
    pub fn bytes_by_attribute(&self) -> Vec<(String, u64)> {
        let layouts = self.cohorts.iter().map(|cohort| &cohort.layout);
        let layout = layouts.max_by_key(|layout| layout.columns().len()).map_or_else(Layout::base, Arc::clone);
        let bytes = |name: &str| self.sections.iter().filter(|s| s.name == name).map(|s| s.bytes).sum();
        layout.columns().iter().map(|column| (column.name.clone(), bytes(&column.name))).collect()
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
/// assert!(info.checksums_ok() && info.cohorts[0].segments.len() == 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// - [`DecodeError::Format`] if the header, `INFO` or `PLAN` is damaged, the file is truncated or followed by other
///   bytes, or a file with correct checksums breaks a rule of the format
/// - [`DecodeError::Version`] if the file is of another version
/// - [`DecodeError::Limit`] if decoding exceeds `limits`
pub fn inspect(file: &[u8], limits: &DecodeLimits) -> Result<FileInfo, DecodeError> {
    inspect_archive(file, limits, open_whole(file, limits)?)
}

/// [`inspect`] of a file that may have been cut: [`SectionInfo::is_whole`] is false for sections that are not whole.
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
/// As [`inspect`]. A file that was cut is an error only if the header, `INFO` or `PLAN` is not whole.
pub fn inspect_cut(file: &[u8], limits: &DecodeLimits) -> Result<FileInfo, DecodeError> {
    match Archive::open(file, limits)? {
        Opening::Ready(archive) if archive.file_bytes() > file.len() as u64 => inspect_archive(file, limits, *archive),
        _ => inspect(file, limits),
    }
}

fn inspect_archive(file: &[u8], limits: &DecodeLimits, mut archive: Archive) -> Result<FileInfo, DecodeError> {
    let is_whole = file.len() as u64 == archive.file_bytes();
    let cohorts: Vec<Cohort> = if is_whole {
        open_cohorts(&mut archive, file)?
    } else {
        // Heads come by ascending timesteps, so heads beyond the end of the cut file are missing.
        let whole = (0..archive.num_cohorts()).take_while(|&i| archive.head_range(i).end <= file.len() as u64);
        let whole: Vec<usize> = whole.collect();
        let head = |archive: &Archive, i| archive.head_range(i).start as usize..archive.head_range(i).end as usize;
        whole.into_iter().map(|i| archive.open_cohort(i, &file[head(&archive, i)])).collect::<Result<_, _>>()?
    };
    let mut info = FileInfo::new(&archive, file.len() as u64, Some(file));
    cohorts.iter().for_each(|cohort| info.add(&archive, cohort, Some(file)));
    if is_whole && info.checksums_ok() {
        info.contents = Some(contents(&decode_cohorts(file, limits)?.1));
    }
    Ok(info)
}

impl FileInfo {
    /// A description from the start of a file.
    ///
    /// - `length`: of the file in bytes, which may have been cut
    /// - `file`: all of these bytes; with `None` sections are not read
    pub(crate) fn new(archive: &Archive, length: u64, file: Option<&[u8]>) -> Self {
        let sections = archive.entries().iter();
        Self {
            version: archive.version(),
            bytes: length,
            bytes_before: archive.file_bytes(),
            scene: archive.info().clone(),
            sections: sections.map(|entry| describe(entry, name(entry.tag), None, length, file)).collect(),
            cohorts: Vec::new(),
            bounds: archive.bounds(),
            declared_errors: archive.declared_errors().to_vec(),
            contents: None,
        }
    }

    /// Adds the next cohort.
    pub(crate) fn add(&mut self, archive: &Archive, cohort: &Cohort, file: Option<&[u8]>) {
        // In version 1 the table of contents already lists the sections of the only cohort.
        if archive.version() > 1 {
            let (index, length) = (Some(self.cohorts.len()), self.bytes);
            let named = cohort.entries().iter().zip(cohort.entry_names());
            self.sections.extend(named.map(|(entry, name)| describe(entry, &name, index, length, file)));
        }
        let all = cohort.num_layers();
        let segments = (0..cohort.num_segments()).map(|i| (cohort.timesteps_of(i), cohort.segment_range(i, all)));
        self.cohorts.push(CohortInfo {
            timesteps: cohort.timesteps(),
            layers: cohort.layers().to_vec(),
            segments: segments.collect(),
            layout: Arc::clone(cohort.layout()),
            skipped: cohort.skipped().map(str::to_owned).collect(),
        });
    }
}

fn describe(entry: &Entry, name: &str, cohort: Option<usize>, length: u64, file: Option<&[u8]>) -> SectionInfo {
    let Range { start, end } = entry.range;
    let is_right = |file: &[u8]| file.get(start as usize..end as usize).is_some_and(|bytes| entry.open(bytes).is_ok());
    SectionInfo {
        name: name.into(),
        cohort,
        segment: (entry.segment != SHARED).then_some(entry.segment.into()),
        layer: entry.layer.into(),
        bytes: end - start,
        is_whole: end <= length,
        checksum_ok: file.map(is_right),
    }
}

/// Statistics of all cohorts together.
fn contents(cohorts: &[CompactScene]) -> Contents {
    let layout = cohorts.iter().map(|cohort| &cohort.layout).max_by_key(|layout| layout.columns().len());
    let columns = layout.map_or(&[][..], |layout| layout.columns());
    let mut contents = Contents {
        bits_histogram: columns.iter().map(|column| (column.name.clone(), BTreeMap::new())).collect(),
        keypoints_mean: Vec::new(),
        raw_bytes: cohorts.iter().map(CompactScene::raw_bytes).sum(),
        plain_bytes: cohorts.iter().map(CompactScene::plain_bytes).sum(),
    };
    let mut sums = vec![(0, 0); columns.len()];
    for cohort in cohorts {
        let histograms = cohort.bit_map.histogram();
        for (attribute, tracks) in cohort.layout.attributes().zip(&cohort.tracks) {
            let name = cohort.layout.name(attribute);
            let Some(place) = columns.iter().position(|column| column.name == name) else { continue };
            for (&width, &count) in &histograms[attribute.index()] {
                *contents.bits_histogram[place].1.entry(width).or_default() += count;
            }
            sums[place].0 += tracks.num_keypoints();
            sums[place].1 += tracks.len();
        }
    }
    let means = sums.into_iter().map(|(keypoints, tracks)| keypoints as f64 / tracks.max(1) as f64);
    contents.keypoints_mean = columns.iter().map(|column| column.name.clone()).zip(means).collect();
    contents
}

/// Application data of a file, as written by [`encode_with`](crate::encode_with).
///
/// - `file`: all bytes of the file
/// - `limits`: bounds on memory and counts
/// - returns: name and content of each piece, in the order of the file. Pieces without a name in UTF-8 are left out
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
    open_whole(file, limits)?.application_data_in(file)
}
