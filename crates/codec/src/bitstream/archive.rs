//! The start of a file: a description of the scene, and the positions of its cohorts. The caller does the input: this
//! module takes bytes, and names the ranges that it needs.

use std::ops::Range;
use std::sync::Arc;

use super::cohort::Cohort;
use super::container::{self, version_1, version_2};
use super::head::{Head, Info};
use super::plan::Plan;
use super::section::{APPLICATION, Cursor, Entry};
use crate::compact::SceneInfo;
use crate::error::DecodeError;
use crate::limits::{Budget, DecodeLimits};

/// Result of [`Archive::open`].
#[derive(Debug)]
pub enum Opening {
    /// More bytes are needed: the description of the file ends after those given. [`Archive::open`] needs at least this
    /// many bytes from the start of the file.
    More(u64),
    /// The archive is open.
    Ready(Box<Archive>),
}

/// The start of a file: a description of the scene, and the positions of its cohorts.
///
/// A *cohort* is a set of Gaussians that are described together and live within one span of timesteps. A file of
/// version 1 has one cohort of all timesteps. A caller fetches ranges of bytes, for example with HTTP range requests:
///
/// 1. the start of the file, for [`Self::open`]
/// 2. [`Self::head_range`] of the cohorts that live at a timestep ([`Self::cohorts_at`]), for [`Self::open_cohort`]
/// 3. the ranges that a [`Cohort`] names
///
/// ```
/// use tcgs_codec::{Archive, BitMap, CompressSettings, DecodeLimits, Opening, SceneInfo, compress, encode};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
/// let file = encode(&compact)?;
/// let range = |r: std::ops::Range<u64>| &file[r.start as usize..r.end as usize]; // an HTTP request
///
/// let Opening::Ready(mut archive) = Archive::open(&file[..1000.min(file.len())], &DecodeLimits::default())? else {
///     panic!("more bytes are needed")
/// };
/// let mut cohort = archive.open_cohort(0, range(archive.head_range(0)))?;
/// cohort.read_shared(range(cohort.shared_range(cohort.num_layers())))?;
/// let index = cohort.segment_at(1);
/// let segment = cohort.read_segment(index, range(cohort.segment_range(index, cohort.num_layers())))?;
/// assert_eq!(segment.at(1), compact.at(1));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Archive {
    version: u16,
    info: Arc<Info>,
    /// Length of the whole file, bytes.
    length: u64,
    /// Sections of the table of contents, in the order of the file.
    entries: Vec<Entry>,
    cohorts: Cohorts,
    limits: DecodeLimits,
}

/// Positions of the cohorts of a file.
#[derive(Debug)]
enum Cohorts {
    /// The only cohort of a file of version 1, already open.
    One(Box<Cohort>),
    /// The cohorts of a file of version 2, by ascending start, and the plans read so far.
    Many(Vec<Place>, Vec<Option<Arc<Plan>>>),
}

/// Position of a cohort: an entry of the section `COHO`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Place {
    /// First timestep of the scene at which the cohort lives.
    pub(super) start: u32,
    pub(super) num_timesteps: u32,
    pub(super) num_gaussians: u32,
    /// Index of the cohort whose plan this one uses: its own or an earlier one.
    pub(super) plan: u32,
    /// Length of the head in bytes; its checksum follows.
    pub(super) head_bytes: u32,
    pub(super) head_checksum: u32,
    /// Length of the shared layers in bytes; they follow the head.
    pub(super) shared_bytes: u32,
    /// Offset of the head in the file.
    pub(super) offset: u64,
}

impl Place {
    pub(super) fn timesteps(&self) -> Range<usize> {
        self.start as usize..self.start as usize + self.num_timesteps as usize
    }

    fn head(&self) -> Range<u64> {
        self.offset..self.offset + u64::from(self.head_bytes)
    }
}

impl Archive {
    /// Opens a file from its first bytes: the header, and the description of the whole scene.
    ///
    /// - `start`: any number of bytes from the start of the file; 16 KiB usually suffice
    /// - `limits`: bounds on memory and counts, also for all later reads
    ///
    /// # Errors
    /// - [`DecodeError::Format`] if `start` is not the start of a `.tcgs` file, is damaged, or breaks a rule of the
    ///   format
    /// - [`DecodeError::Version`] if the file is of another version
    /// - [`DecodeError::Limit`] if the counts exceed `limits`
    pub fn open(start: &[u8], limits: &DecodeLimits) -> Result<Opening, DecodeError> {
        let Some((version, header)) = container::length_of_header(start)? else {
            return Ok(Opening::More(container::fixed_bytes(start) as u64));
        };
        let Some(header) = start.get(..header) else { return Ok(Opening::More(header as u64)) };
        if version == 1 { version_1::open(header, start, limits) } else { version_2::open(header, start, limits) }
    }

    pub(super) fn of_one(length: u64, entries: Vec<Entry>, cohort: Cohort, limits: &DecodeLimits) -> Self {
        let info = Arc::clone(&cohort.head().info);
        Self { version: 1, info, length, entries, cohorts: Cohorts::One(Box::new(cohort)), limits: limits.clone() }
    }

    pub(super) fn of_many(
        length: u64,
        entries: Vec<Entry>,
        info: Info,
        places: Vec<Place>,
        limits: &DecodeLimits,
    ) -> Self {
        let plans = vec![None; places.len()];
        let cohorts = Cohorts::Many(places, plans);
        Self { version: 2, info: Arc::new(info), length, entries, cohorts, limits: limits.clone() }
    }

    /// Version of the format.
    pub fn version(&self) -> u16 {
        self.version
    }

    /// Counts and provenance of the scene. The number of Gaussians is that of all cohorts together.
    pub fn info(&self) -> &SceneInfo {
        &self.info.scene
    }

    /// Axis-aligned bounding box of all means at all timesteps, in scene units: the smallest and the largest
    /// coordinates.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        self.info.bounds
    }

    /// By name of the attribute: the largest error against the compressed scene that the file declares, as
    /// [`attribute_error`](crate::attribute_error) measures it; empty if the file declares none.
    pub fn declared_errors(&self) -> &[(String, f32)] {
        &self.info.errors
    }

    /// Length of the whole file in bytes, as declared at its start.
    pub fn file_bytes(&self) -> u64 {
        self.length
    }

    /// Number of cohorts.
    pub fn num_cohorts(&self) -> usize {
        match &self.cohorts {
            Cohorts::One(_) => 1,
            Cohorts::Many(places, _) => places.len(),
        }
    }

    /// Timesteps of the scene that a cohort spans.
    ///
    /// # Panics
    /// If `cohort` is not below [`Self::num_cohorts`].
    pub fn timesteps_of(&self, cohort: usize) -> Range<usize> {
        match &self.cohorts {
            Cohorts::One(only) if cohort == 0 => only.timesteps(),
            Cohorts::Many(places, _) if cohort < places.len() => places[cohort].timesteps(),
            _ => panic!("cohort {cohort} of {}", self.num_cohorts()),
        }
    }

    /// Number of Gaussians of a cohort.
    ///
    /// # Panics
    /// If `cohort` is not below [`Self::num_cohorts`].
    pub fn num_gaussians_of(&self, cohort: usize) -> usize {
        match &self.cohorts {
            Cohorts::One(only) if cohort == 0 => only.num_gaussians(),
            Cohorts::Many(places, _) if cohort < places.len() => places[cohort].num_gaussians as usize,
            _ => panic!("cohort {cohort} of {}", self.num_cohorts()),
        }
    }

    /// The cohorts that live at a timestep of the scene, ascending.
    pub fn cohorts_at(&self, timestep: usize) -> impl Iterator<Item = usize> {
        // Cohorts ascend by their first timesteps.
        let begun = match &self.cohorts {
            Cohorts::One(_) => 1,
            Cohorts::Many(places, _) => places.partition_point(|place| place.start as usize <= timestep),
        };
        (0..begun).filter(move |&cohort| self.timesteps_of(cohort).contains(&timestep))
    }

    /// The largest span around a timestep in which the same cohorts live.
    ///
    /// # Panics
    /// If the scene has no such timestep.
    pub fn span_at(&self, timestep: usize) -> Range<usize> {
        let num_timesteps = self.info().num_timesteps as usize;
        assert!(timestep < num_timesteps, "timestep {timestep} of {num_timesteps}");
        let mut span = 0..num_timesteps;
        for cohort in 0..self.num_cohorts() {
            for change in [self.timesteps_of(cohort).start, self.timesteps_of(cohort).end] {
                if change <= timestep {
                    span.start = span.start.max(change);
                } else {
                    span.end = span.end.min(change);
                }
            }
        }
        span
    }

    /// Range of the file that [`Self::open_cohort`] needs.
    ///
    /// # Panics
    /// If `cohort` is not below [`Self::num_cohorts`].
    pub fn head_range(&self, cohort: usize) -> Range<u64> {
        match &self.cohorts {
            Cohorts::One(_) if cohort == 0 => 0..0,
            Cohorts::Many(places, _) if cohort < places.len() => places[cohort].head(),
            _ => panic!("cohort {cohort} of {}", self.num_cohorts()),
        }
    }

    /// Range of the file from the head of a cohort to the end of its shared layers: one request for both
    /// [`Self::open_cohort`] and [`Cohort::read_shared`].
    ///
    /// # Panics
    /// If `cohort` is not below [`Self::num_cohorts`].
    pub fn start_range(&self, cohort: usize) -> Range<u64> {
        match &self.cohorts {
            Cohorts::One(only) if cohort == 0 => only.shared_range(only.num_layers()),
            Cohorts::Many(places, _) if cohort < places.len() => {
                let Range { start, end } = places[cohort].head();
                start..end + u64::from(places[cohort].shared_bytes)
            }
            _ => panic!("cohort {cohort} of {}", self.num_cohorts()),
        }
    }

    /// The cohort whose plan (attributes, quantizers, predictors) this cohort shares, and which [`Self::open_cohort`]
    /// must have opened before; `None` if the cohort has its own plan or the shared one is already open.
    ///
    /// # Panics
    /// If `cohort` is not below [`Self::num_cohorts`].
    pub fn needs_before(&self, cohort: usize) -> Option<usize> {
        match &self.cohorts {
            Cohorts::One(_) => None,
            Cohorts::Many(places, plans) => {
                let plan = places[cohort].plan as usize;
                (plan != cohort && plans[plan].is_none()).then_some(plan)
            }
        }
    }

    /// Opens a cohort, so that the positions of its sections are known.
    ///
    /// - `bytes`: those of [`Self::head_range`]; further bytes are ignored
    ///
    /// # Errors
    /// - [`DecodeError::Format`] if the bytes are damaged or break a rule of the format
    /// - [`DecodeError::Limit`] if the counts exceed the limits
    ///
    /// # Panics
    /// If `cohort` is not below [`Self::num_cohorts`], or [`Self::needs_before`] names one that was not opened.
    pub fn open_cohort(&mut self, cohort: usize, bytes: &[u8]) -> Result<Cohort, DecodeError> {
        match &mut self.cohorts {
            Cohorts::One(only) if cohort == 0 => Ok((**only).clone()),
            Cohorts::One(_) => panic!("cohort {cohort} of 1"),
            Cohorts::Many(places, plans) => {
                let place = &places[cohort];
                let shared = (place.plan as usize != cohort)
                    .then(|| plans[place.plan as usize].clone().expect("the cohort whose plan is shared was opened"));
                let info = Arc::clone(&self.info);
                let (head, sections): (Head, _) =
                    version_2::read_head(cohort, place, info, shared, bytes, self.length, &self.limits)?;
                let known = plans.iter().flatten().next().map(|plan| plan.layout.is_antialiased());
                if known.is_some_and(|known| known != head.plan.layout.is_antialiased()) {
                    return Err(Cursor::new("cohort", place.offset, bytes).invalid("flags", version_2::MIXED));
                }
                if place.plan as usize == cohort {
                    plans[cohort] = Some(Arc::clone(&head.plan));
                }
                Ok(Cohort::new(head, sections, Arc::new(Budget::new(&self.limits, self.length))))
            }
        }
    }

    /// Verifies the checksums of the optional sections that lie entirely within some bytes of the file. The other
    /// sections are verified when they are decoded.
    ///
    /// - `bytes`: start at `offset` of the file
    pub(super) fn check_optional(&self, offset: u64, bytes: &[u8]) -> Result<(), DecodeError> {
        let end = offset + bytes.len() as u64;
        let within = |entry: &&Entry| entry.is_optional() && offset <= entry.range.start && entry.range.end <= end;
        self.entries.iter().filter(within).try_for_each(|entry| {
            let section = (entry.range.start - offset) as usize..(entry.range.end - offset) as usize;
            entry.open(&bytes[section]).map(drop)
        })
    }

    /// Bytes before the first section or piece.
    pub(super) fn header_bytes(&self) -> u64 {
        version_2::header_bytes(self.entries.len()) as u64
    }

    /// Sections of the table of contents.
    pub(super) fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// Ranges of the file with application data, in the order of the file; [`Self::read_application`] reads their
    /// content.
    pub fn application_ranges(&self) -> Vec<Range<u64>> {
        self.application().map(|entry| entry.range.clone()).collect()
    }

    /// Name and content of one piece of application data.
    ///
    /// - `index`: position in [`Self::application_ranges`]
    /// - `bytes`: the bytes of the range at `index`
    /// - returns: the name, and the bytes after the name. `None` if the section does not begin with a name in UTF-8; no
    ///   decoder needs such a section
    ///
    /// # Errors
    /// [`DecodeError::Format`] if the checksum does not match.
    ///
    /// # Panics
    /// If `index` is not below the number of [`Self::application_ranges`].
    pub fn read_application<'a>(
        &self,
        index: usize,
        bytes: &'a [u8],
    ) -> Result<Option<(String, &'a [u8])>, DecodeError> {
        let mut entries = self.application();
        let entry = entries.nth(index).unwrap_or_else(|| panic!("data {index} of {}", self.application().count()));
        let mut cursor = entry.open(bytes)?;
        Ok(cursor.text("name").ok().map(|name| (name, cursor.rest())))
    }

    /// Names and bytes of all application data, in the order of the file.
    ///
    /// - `file`: all bytes of the file
    pub(crate) fn application_data_in<'a>(&self, file: &'a [u8]) -> Result<Vec<(String, &'a [u8])>, DecodeError> {
        let of_range = |(index, range): (usize, Range<u64>)| {
            self.read_application(index, &file[range.start as usize..range.end as usize]).transpose()
        };
        self.application_ranges().into_iter().enumerate().filter_map(of_range).collect()
    }

    /// Entries of the table of contents for application data.
    fn application(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter().filter(|e| e.tag == APPLICATION)
    }
}
