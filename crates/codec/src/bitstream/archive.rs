//! A file from which parts are read: which bytes a timestep needs, and what they say.

use std::ops::Range;
use std::sync::Arc;

use tcgs_core::Attribute;

use super::coder::{Coder, Decoder as SymbolDecoder};
use super::container;
use super::head::{Head, read_info, read_plan};
use super::keypoints::{KeypointModels, Motion, Place, Problem, UnitTracks};
use super::section::{self, APPLICATION, Cursor, Entry, INFO, MAPS, PLAN, SHARED, Tag};
use super::segment::Segment;
use super::shared::{CurveModels, FirstModels, MapModels, Shared};
use crate::compact::SceneInfo;
use crate::error::DecodeError;
use crate::limits::{Budget, DecodeLimits};
use crate::parallel;

/// What the start of a file gives.
#[derive(Debug)]
pub enum Opening {
    /// So many bytes from the start are needed at least.
    More(u64),
    /// Enough.
    Ready(Box<Archive>),
}

/// A file of which the start is known: where its parts lie, and what of them was read.
///
/// All layers that are wanted are read first ([`Self::shared_range`], [`Self::read_shared`]), then any
/// segments in any order ([`Self::segment_range`], [`Self::read_segment`]).
///
/// ```
/// use tcgs_codec::{Archive, BitMap, CompressSettings, DecodeLimits, Opening, SceneInfo, compress, encode};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings);
/// let file = encode(&compact);
/// let range = |r: std::ops::Range<u64>| &file[r.start as usize..r.end as usize]; // an HTTP request
///
/// let Opening::Ready(mut archive) = Archive::open(&file[..1000.min(file.len())], &DecodeLimits::default())? else {
///     panic!("more bytes are needed")
/// };
/// archive.read_shared(range(archive.shared_range(archive.num_layers())))?;
/// let index = archive.segment_at(1);
/// let segment = archive.read_segment(index, range(archive.segment_range(index, archive.num_layers())))?;
/// assert_eq!(segment.at(1), compact.at(1));
/// # Ok::<(), tcgs_codec::DecodeError>(())
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
    /// Opens a file by its start.
    ///
    /// - `start`: any number of bytes; some kilobytes are usually enough
    ///
    /// # Errors
    /// [`DecodeError`] if this is no file of the one version known, its header is damaged or breaks a rule, or
    /// it asks for more than `limits` allow.
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

        let mut groups = Vec::new();
        for layer in 0..head.layers.len() {
            groups.push(next(MAPS, shared, layer)?.0);
            for attribute in Attribute::ALL {
                next(section::of_attribute(attribute), shared, layer)?;
            }
        }
        let varying: Vec<Attribute> = Attribute::ALL.into_iter().filter(|a| head.plan.varies[a.index()]).collect();
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

    /// What the file says besides symbols.
    pub fn info(&self) -> &SceneInfo {
        &self.head.info
    }

    /// Smallest and largest coordinates of all means at all timesteps.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        self.head.bounds
    }

    /// By [`Attribute::index`]: whether it varies over time.
    pub fn varies(&self) -> [bool; 5] {
        self.head.plan.varies
    }

    /// Length of the whole file.
    pub fn file_bytes(&self) -> u64 {
        self.entries.last().map_or(container::FIXED_BYTES as u64, |e| e.range.end)
    }

    /// Number of segments.
    pub fn num_segments(&self) -> usize {
        self.head.num_segments()
    }

    /// Number of layers; none without Gaussians.
    pub fn num_layers(&self) -> usize {
        self.head.layers.len()
    }

    /// By layer: how many Gaussians it adds.
    pub fn layers(&self) -> &[u32] {
        &self.head.layers
    }

    /// How many layers were read by [`Self::read_shared`].
    pub fn layers_read(&self) -> usize {
        self.layers_read
    }

    /// Timesteps of a segment.
    ///
    /// # Panics
    /// If there is no such segment.
    pub fn timesteps(&self, segment: usize) -> Range<usize> {
        assert!(segment < self.num_segments(), "segment {segment} of {}", self.num_segments());
        self.head.span(segment)
    }

    /// The segment that holds a timestep.
    ///
    /// # Panics
    /// If there is no such timestep.
    pub fn segment_at(&self, timestep: usize) -> usize {
        assert!(timestep < self.head.num_timesteps(), "timestep {timestep} of {}", self.head.num_timesteps());
        timestep / self.head.segment_length()
    }

    /// Bytes of the file that [`Self::read_shared`] needs to know the first `layers` layers.
    ///
    /// # Panics
    /// If there are not so many.
    pub fn shared_range(&self, layers: usize) -> Range<u64> {
        assert!(layers <= self.num_layers(), "{layers} layers of {}", self.num_layers());
        self.range_of(self.layers_read.min(layers)..layers)
    }

    /// Bytes of the file that [`Self::read_segment`] needs for the first `layers` layers of a segment.
    ///
    /// # Panics
    /// If there are not so many.
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

    /// Bytes of the file that hold data of applications, each by itself; usually close to its start.
    pub fn application_ranges(&self) -> impl Iterator<Item = Range<u64>> {
        self.application().map(|entry| entry.range.clone())
    }

    /// The name of an application's data, and the data.
    ///
    /// - `range`: one of [`Self::application_ranges`], and `bytes` what lies there
    ///
    /// # Errors
    /// [`DecodeError`] if the section is damaged.
    ///
    /// # Panics
    /// If there is no such range.
    pub fn read_application<'a>(&self, range: &Range<u64>, bytes: &'a [u8]) -> Result<(String, &'a [u8]), DecodeError> {
        let entry = self.application().find(|entry| entry.range == *range);
        let mut cursor = entry.expect("a range of application data").open(bytes)?;
        Ok((cursor.text("name")?, cursor.rest()))
    }

    /// Sections of a group with their bytes.
    ///
    /// - `bytes`: from `offset` of the file
    fn sections<'a>(&self, group: usize, offset: u64, bytes: &'a [u8]) -> Result<Vec<Cursor<'a>>, DecodeError> {
        let entries = &self.entries[self.groups[group]..self.groups[group + 1]];
        let needed = entries.iter().filter(|e| !e.is_optional());
        needed
            .map(|entry| {
                let range = (entry.range.start - offset) as usize..(entry.range.end - offset) as usize;
                let section = bytes.get(range);
                let early = || {
                    Cursor::new(section::name(entry.tag), entry.range.start, &[])
                        .invalid("length", "the file ends early")
                };
                entry.open(section.ok_or_else(early)?)
            })
            .collect()
    }

    /// Reads the next layers.
    ///
    /// - `bytes`: those of a [`Self::shared_range`]; more are ignored, with fewer as many layers are read as
    ///   are complete
    ///
    /// # Errors
    /// [`DecodeError`] if a section is damaged or too large.
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

    /// Reads the first layers of a segment.
    ///
    /// - `bytes`: those of a [`Self::segment_range`] of at most as many layers as were read by
    ///   [`Self::read_shared`]; fewer give fewer layers
    ///
    /// # Errors
    /// [`DecodeError`] if a section is damaged or too large.
    ///
    /// # Panics
    /// If there is no such segment.
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

    /// Where data of applications lie, with their checksums.
    pub(super) fn application(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter().filter(|e| e.tag == APPLICATION)
    }
}

/// Models that go on from layer to layer.
#[derive(Debug)]
struct SharedModels {
    maps: MapModels,
    curve: CurveModels,
    /// Of all attributes but means.
    others: Vec<FirstModels>,
}

impl SharedModels {
    fn new() -> Self {
        let others = Attribute::ALL[1..].iter().map(|&a| FirstModels::new(a)).collect();
        Self { maps: MapModels::new(), curve: CurveModels::new(), others }
    }

    /// - `sections`: maps, then every attribute
    fn read(
        &mut self,
        head: &Head,
        layer: Range<usize>,
        sections: Vec<Cursor<'_>>,
        shared: &mut Shared,
        budget: &Budget,
    ) -> Result<(), DecodeError> {
        let plan = &head.plan;
        budget.reserve("layer", layer.len() as u64, plan.bytes_per_gaussian())?;
        shared.extend(plan, &layer);
        let mut sections = sections.into_iter();
        let mut next = || sections.next().expect("a section for every attribute");

        let mut cursor = next();
        let mut decoder = SymbolDecoder::new(cursor.rest());
        self.maps.code(&mut decoder, plan, layer.clone(), shared);
        complete(&decoder, &cursor)?;
        for attribute in Attribute::ALL {
            let (a, known) = (attribute.index(), plan.quantizers.by_width(attribute));
            if shared.bit_map.widths[a][layer.clone()].iter().any(|&w| known[usize::from(w)].is_empty()) {
                return Err(cursor.invalid("bit widths", "a width without quantizers"));
            }
        }
        shared.count_units(plan, &layer);

        let mut cursor = next();
        let mut decoder = SymbolDecoder::new(cursor.rest());
        self.curve.code(&mut decoder, plan, layer.clone(), shared);
        complete(&decoder, &cursor)?;
        let points: Vec<_> = shared.points(layer.clone()).collect();
        shared.neighbors.extend(points.into_iter());

        let Shared { bit_map, neighbors, first_codes, .. } = shared;
        let jobs: Vec<_> = self.others.iter_mut().zip(&mut first_codes[1..]).map(|job| (job, next())).collect();
        let results = parallel::map(jobs, |((models, codes), mut cursor)| {
            let widths = &bit_map.widths[models.attribute().index()];
            let mut decoder = SymbolDecoder::new(cursor.rest());
            models.code(&mut decoder, plan, layer.clone(), neighbors, widths, codes);
            complete(&decoder, &cursor)
        });
        results.into_iter().collect()
    }
}

fn complete(decoder: &SymbolDecoder<'_>, cursor: &Cursor<'_>) -> Result<(), DecodeError> {
    if decoder.finished() { Ok(()) } else { Err(cursor.invalid("symbols", "not exactly as many as there should be")) }
}

/// Reads a segment layer by layer.
pub(super) struct SegmentReader {
    segment: usize,
    layers: usize,
    /// By attribute; those of attributes that do not vary stay empty.
    attributes: Vec<(Attribute, KeypointModels, UnitTracks)>,
}

impl SegmentReader {
    pub(super) fn new(archive: &Archive, segment: usize) -> Self {
        let plan = &archive.head.plan;
        let varying = Attribute::ALL.into_iter().filter(|a| plan.varies[a.index()]);
        let attributes = varying.map(|a| (a, KeypointModels::new(a), UnitTracks::new(plan.channels(a)))).collect();
        Self { segment, layers: 0, attributes }
    }

    /// Reads the next layer.
    ///
    /// - `bytes`: from `offset` of the file
    pub(super) fn read(
        &mut self,
        archive: &Archive,
        offset: u64,
        bytes: &[u8],
        budget: &Budget,
    ) -> Result<(), DecodeError> {
        let sections = archive.sections(archive.num_layers() * (1 + self.segment) + self.layers, offset, bytes)?;
        let jobs = self.attributes.iter_mut().zip(sections).collect();
        let results = parallel::map(jobs, |((attribute, models, units), mut cursor)| {
            let motion = Motion::ALL.get(usize::from(cursor.u8("motion")?)).copied();
            let motion = motion.ok_or_else(|| cursor.invalid("motion", "unknown"))?;
            let place = Place {
                plan: &archive.head.plan,
                shared: &archive.shared,
                attribute: *attribute,
                layer: archive.head.layer(self.layers),
                span: archive.head.span(self.segment),
                num_timesteps: archive.head.num_timesteps(),
                budget,
            };
            let mut decoder = SymbolDecoder::new(cursor.rest());
            match models.code(&mut decoder, &place, motion, None, units) {
                Ok(()) if decoder.finished() => Ok(()),
                Err(Problem::TooMany(error)) => Err(error),
                Err(Problem::Damaged) if !decoder.exhausted() => {
                    Err(cursor.invalid("keypoint times", "not within the timesteps that are left"))
                }
                _ => Err(cursor.invalid("symbols", "not exactly as many as there should be")),
            }
        });
        self.layers += 1;
        results.into_iter().collect()
    }

    /// What was read so far.
    pub(super) fn finish(self, archive: &Archive) -> Segment {
        let (segment, layers) = (self.segment, self.layers);
        let units = self.attributes.into_iter().map(|(attribute, _, units)| (attribute, units));
        segment_of(archive, segment, layers, units)
    }

    /// A copy of what was read so far.
    pub(super) fn snapshot(&self, archive: &Archive) -> Result<Segment, DecodeError> {
        let bytes: usize = self.attributes.iter().map(|(_, _, units)| units.bytes()).sum();
        archive.budget.reserve("segment", bytes as u64, 1)?;
        let units = self.attributes.iter().map(|(attribute, _, units)| (*attribute, units.clone()));
        Ok(segment_of(archive, self.segment, self.layers, units))
    }
}

/// - `units`: of the attributes that vary
fn segment_of(
    archive: &Archive,
    segment: usize,
    layers: usize,
    units: impl Iterator<Item = (Attribute, UnitTracks)>,
) -> Segment {
    let mut tracks: [UnitTracks; 5] = Attribute::ALL.map(|a| UnitTracks::new(archive.head.plan.channels(a)));
    for (attribute, units) in units {
        tracks[attribute.index()] = units;
    }
    Segment::new(archive.head.clone(), archive.shared.clone(), segment, layers, tracks)
}
