//! Decoding of parts of a file: which ranges of bytes a timestep needs, and their content. Input is the caller's: this
//! module takes bytes, and names the ranges that it needs.

use std::ops::Range;
use std::sync::Arc;

use tcgs_core::Attribute;

use super::container;
use super::head::{Head, MAX_SEGMENTS, read_info, read_plan};
use super::reader::{SegmentReader, SharedModels};
use super::section::{self, APPLICATION, Cursor, Entry, INFO, MAPS, PLAN, SHARED, Tag};
use super::segment::Segment;
use super::shared::Shared;
use crate::compact::SceneInfo;
use crate::error::{DecodeError, ENDS_EARLY};
use crate::limits::{Budget, DecodeLimits};

/// Result of [`Archive::open`].
#[derive(Debug)]
pub enum Opening {
    /// The bytes end before the table of contents, `INFO` and `PLAN` do: [`Archive::open`] needs at least this many
    /// bytes from the start of the file.
    More(u64),
    /// The archive is open.
    Ready(Box<Archive>),
}

/// Table of contents of a file, and the shared layers that were read so far.
///
/// A caller fetches ranges of bytes, for example with HTTP range requests:
///
/// 1. the start of the file, for [`Self::open`]
/// 2. [`Self::shared_range`] of the layers that it wants, for [`Self::read_shared`]
/// 3. [`Self::segment_range`] of any segments in any order, for [`Self::read_segment`]
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
/// archive.read_shared(range(archive.shared_range(archive.num_layers())))?;
/// let index = archive.segment_at(1);
/// let segment = archive.read_segment(index, range(archive.segment_range(index, archive.num_layers())))?;
/// assert_eq!(segment.at(1), compact.at(1));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Archive {
    entries: Vec<Entry>,
    head: Arc<Head>,
    /// Index in `entries` of the first section of every shared layer, then of every layer of every
    /// segment, and the number of entries.
    groups: Vec<usize>,
    shared: Arc<Shared>,
    layers_read: usize,
    models: SharedModels,
    budget: Budget,
}

impl Archive {
    /// Opens a file from its first bytes: the header, `INFO` and `PLAN`.
    ///
    /// - `start`: any number of bytes from the start of the file; 16 KiB usually suffice
    /// - `limits`: bounds on memory and counts, also for all that is read later
    ///
    /// # Errors
    /// - [`DecodeError::Format`] if `start` is not the start of a `.tcgs` file, is damaged, or breaks a rule of the
    ///   format
    /// - [`DecodeError::Version`] if the file is of another version
    /// - [`DecodeError::Limit`] if the counts exceed `limits`
    pub fn open(start: &[u8], limits: &DecodeLimits) -> Result<Opening, DecodeError> {
        let Some(header) = container::length_of_header(start)? else {
            return Ok(Opening::More(container::FIXED_BYTES as u64));
        };
        let Some(header) = start.get(..header) else { return Ok(Opening::More(header as u64)) };
        let entries = container::read_header(header)?;
        let head_end = entries.iter().filter(|e| e.tag == INFO || e.tag == PLAN).map(|e| e.range.end).max();
        let head_end = head_end.unwrap_or(header.len() as u64);
        if head_end > start.len() as u64 {
            return Ok(Opening::More(head_end));
        }
        let mut sections = entries.iter().enumerate().filter(|(_, e)| !e.is_optional());
        let mut next = |tag: Tag, segment: usize, layer: usize| {
            let found = sections.next();
            let place = found.map_or(header.len() - container::ENTRY_BYTES, |(index, _)| {
                container::FIXED_BYTES + index * container::ENTRY_BYTES
            });
            found
                .filter(|(_, e)| (e.tag, usize::from(e.segment), usize::from(e.layer)) == (tag, segment, layer))
                .ok_or_else(|| Cursor::new("header", place as u64, &[]).invalid("tag", "not the section that is due"))
        };
        let shared = usize::from(SHARED);
        let bytes = |entry: &Entry| &start[entry.range.start as usize..entry.range.end as usize];
        let (_, info) = next(INFO, shared, 0)?;
        let mut head = read_info(info.open(bytes(info))?, limits)?;
        let (_, plan) = next(PLAN, shared, 0)?;
        head.plan = read_plan(plan.open(bytes(plan))?)?;
        if head.num_segments() > MAX_SEGMENTS {
            let at_info = Cursor::new(section::name(INFO), info.range.start, &[]);
            return Err(at_info.invalid("segment_length", "more than 65535 segments"));
        }

        let mut groups = Vec::new();
        for layer in 0..head.layers.len() {
            groups.push(next(MAPS, shared, layer)?.0);
            for attribute in Attribute::BASE {
                next(section::of_attribute(attribute), shared, layer)?;
            }
        }
        let varying: Vec<Attribute> = Attribute::BASE.into_iter().filter(|a| head.plan.varies[a.index()]).collect();
        for segment in 0..head.num_segments() {
            for layer in 0..head.layers.len() {
                let mut first = None;
                for &attribute in &varying {
                    let (index, _) = next(section::of_attribute(attribute), segment, layer)?;
                    first.get_or_insert(index);
                }
                groups.push(first.unwrap_or(entries.len()));
            }
        }
        if let Some((index, _)) = sections.next() {
            let place = container::FIXED_BYTES + index * container::ENTRY_BYTES;
            return Err(Cursor::new("header", place as u64, &[]).invalid("tag", "a section too many"));
        }
        groups.push(entries.len());
        let length = entries.last().map_or(header.len() as u64, |e| e.range.end);
        Ok(Opening::Ready(Box::new(Self {
            models: SharedModels::new(),
            shared: Arc::new(Shared::default()),
            layers_read: 0,
            head: Arc::new(head),
            groups,
            entries,
            budget: Budget::new(limits, length),
        })))
    }

    /// Counts and provenance of the scene.
    pub fn info(&self) -> &SceneInfo {
        &self.head.info
    }

    /// Axis-aligned bounding box of all means at all timesteps, in scene units: the smallest and the largest
    /// coordinates.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        self.head.bounds
    }

    /// By [`Attribute::index`]: whether the attribute varies over time.
    pub fn varies(&self) -> [bool; 5] {
        self.head.plan.varies
    }

    /// Length of the whole file in bytes, as the table of contents says.
    pub fn file_bytes(&self) -> u64 {
        self.entries.last().map_or(container::FIXED_BYTES as u64, |e| e.range.end)
    }

    /// Number of segments of the file.
    pub fn num_segments(&self) -> usize {
        self.head.num_segments()
    }

    /// Number of layers of the file; 0 for a scene without Gaussians.
    pub fn num_layers(&self) -> usize {
        self.head.layers.len()
    }

    /// `[layers]`: number of Gaussians of each layer.
    pub fn layers(&self) -> &[u32] {
        &self.head.layers
    }

    /// Number of shared layers that [`Self::read_shared`] has read so far.
    pub fn layers_read(&self) -> usize {
        self.layers_read
    }

    /// Timesteps of a segment.
    ///
    /// # Panics
    /// If `segment` is not below [`Self::num_segments`].
    pub fn timesteps(&self, segment: usize) -> Range<usize> {
        assert!(segment < self.num_segments(), "segment {segment} of {}", self.num_segments());
        self.head.span(segment)
    }

    /// Index of the segment that holds a timestep.
    ///
    /// # Panics
    /// If `timestep` is not below [`SceneInfo::num_timesteps`].
    pub fn segment_at(&self, timestep: usize) -> usize {
        assert!(timestep < self.head.num_timesteps(), "timestep {timestep} of {}", self.head.num_timesteps());
        timestep / self.head.segment_length()
    }

    /// Range of the file that [`Self::read_shared`] needs so that the first `layers` shared layers are read; layers
    /// that were read already are not part of it.
    ///
    /// # Panics
    /// If `layers` exceeds [`Self::num_layers`].
    pub fn shared_range(&self, layers: usize) -> Range<u64> {
        assert!(layers <= self.num_layers(), "{layers} layers of {}", self.num_layers());
        self.range_of(self.layers_read.min(layers)..layers)
    }

    /// Range of the file that [`Self::read_segment`] needs for the first `layers` layers of a segment.
    ///
    /// # Panics
    /// If `segment` is not below [`Self::num_segments`], or `layers` exceeds [`Self::num_layers`].
    pub fn segment_range(&self, segment: usize, layers: usize) -> Range<u64> {
        let (num_layers, num_segments) = (self.num_layers(), self.num_segments());
        assert!(
            layers <= num_layers && segment < num_segments,
            "{layers} of {num_layers}, {segment} of {num_segments}"
        );
        let first = num_layers * (1 + segment);
        self.range_of(first..first + layers)
    }

    /// Bytes of groups of sections.
    pub(super) fn range_of(&self, groups: Range<usize>) -> Range<u64> {
        let at = |group: usize| self.entries.get(self.groups[group]).map_or(self.file_bytes(), |e| e.range.start);
        if groups.is_empty() { at(groups.start)..at(groups.start) } else { at(groups.start)..at(groups.end) }
    }

    /// Sections of a group with their bytes.
    ///
    /// - `bytes`: from `offset` of the file
    pub(super) fn sections<'a>(
        &self,
        group: usize,
        offset: u64,
        bytes: &'a [u8],
    ) -> Result<Vec<Cursor<'a>>, DecodeError> {
        let entries = &self.entries[self.groups[group]..self.groups[group + 1]];
        let needed = entries.iter().filter(|e| !e.is_optional());
        needed
            .map(|entry| {
                let range = (entry.range.start - offset) as usize..(entry.range.end - offset) as usize;
                let section = bytes.get(range);
                let early =
                    || Cursor::new(section::name(entry.tag), entry.range.start, &[]).invalid("length", ENDS_EARLY);
                entry.open(section.ok_or_else(early)?)
            })
            .collect()
    }

    /// Verifies the checksums of the optional sections that lie whole in some bytes of the file. The other sections are
    /// verified when they are decoded.
    ///
    /// - `bytes`: from `offset` of the file
    pub(super) fn check_optional(&self, offset: u64, bytes: &[u8]) -> Result<(), DecodeError> {
        let end = offset + bytes.len() as u64;
        let within = |entry: &&Entry| entry.is_optional() && offset <= entry.range.start && entry.range.end <= end;
        self.entries.iter().filter(within).try_for_each(|entry| {
            let section = (entry.range.start - offset) as usize..(entry.range.end - offset) as usize;
            entry.open(&bytes[section]).map(drop)
        })
    }

    /// Reads the shared layers that follow those read so far.
    ///
    /// - `bytes`: the bytes of a [`Self::shared_range`]; further bytes are ignored, and a layer that is incomplete is
    ///   not read
    ///
    /// # Errors
    /// [`DecodeError::Format`] if a section is damaged, [`DecodeError::Limit`] if decoding exceeds the limits.
    pub fn read_shared(&mut self, bytes: &[u8]) -> Result<(), DecodeError> {
        let start = self.range_of(self.layers_read..self.layers_read).start;
        while self.layers_read < self.num_layers()
            && self.range_of(self.layers_read..self.layers_read + 1).end - start <= bytes.len() as u64
        {
            let sections = self.sections(self.layers_read, start, bytes)?;
            let layer = self.head.layer(self.layers_read);
            // Segments that were given away keep what they had.
            let shared = Arc::make_mut(&mut self.shared);
            self.models.read(&self.head, layer, sections, shared, &self.budget)?;
            self.layers_read += 1;
        }
        Ok(())
    }

    /// Decodes the first layers of a segment.
    ///
    /// - `bytes`: the bytes of a [`Self::segment_range`]. Layers beyond [`Self::layers_read`] and layers that are
    ///   incomplete are left out
    /// - returns: the segment, of as many layers as were decoded
    ///
    /// # Errors
    /// [`DecodeError::Format`] if a section is damaged, [`DecodeError::Limit`] if decoding exceeds the limits.
    ///
    /// # Panics
    /// If `segment` is not below [`Self::num_segments`].
    pub fn read_segment(&self, segment: usize, bytes: &[u8]) -> Result<Segment, DecodeError> {
        assert!(segment < self.num_segments(), "segment {segment} of {}", self.num_segments());
        let mut reader = SegmentReader::new(self, segment);
        // Segments come and go: each may take what is left beside the shared layers.
        let budget = self.budget.fork();
        let start = self.segment_range(segment, 0).start;
        for layer in 0..self.layers_read {
            if self.segment_range(segment, layer + 1).end - start > bytes.len() as u64 {
                break;
            }
            reader.read(self, start, bytes, &budget)?;
        }
        Ok(reader.finish(self))
    }

    pub(super) fn head(&self) -> &Arc<Head> {
        &self.head
    }

    pub(super) fn shared(&self) -> &Arc<Shared> {
        &self.shared
    }

    pub(super) fn budget(&self) -> &Budget {
        &self.budget
    }

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
    /// - returns: the name, and the bytes after the name; none if the section does not begin with a name in UTF-8, which
    ///   no decoder needs
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

    /// Entries of the table of contents for application data.
    fn application(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter().filter(|e| e.tag == APPLICATION)
    }
}
