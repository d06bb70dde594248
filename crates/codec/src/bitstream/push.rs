//! Push decoding: a file is decoded while its bytes arrive, in pieces of any size.

use std::collections::{BTreeMap, BTreeSet};

use super::archive::{Archive, Opening};
use super::cohort::Cohort;
use super::container;
use super::decode::end_of_file;
use super::reader::SegmentReader;
use super::section::Cursor;
use super::segment::Segment;
use crate::error::DecodeError;
use crate::limits::DecodeLimits;

/// A part of the file that the bytes given to [`Decoder::push`] completed. The header comes first, the layers of each
/// cohort before its segments, and the end last.
#[derive(Debug)]
pub enum Event {
    /// The description of the scene has arrived: [`Decoder::archive`] is available.
    Header,
    /// One more shared layer of a cohort.
    Layer {
        /// Index of the cohort.
        cohort: usize,
        /// Number of its shared layers so far.
        layers: usize,
    },
    /// A segment with the layers that have arrived. Each segment comes once per layer, each time with one more layer.
    Segment(Box<Segment>),
    /// The file is complete.
    End,
}

/// Push decoder: decodes a file from pieces of bytes. The events do not depend on where the file is cut.
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, Decoder, Event, SceneInfo, compress, encode};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
/// let mut decoder = Decoder::new(DecodeLimits::default());
/// let mut last = None;
/// for bytes in encode(&compact)?.chunks(7) {
///     for event in decoder.push(bytes)? {
///         if let Event::Segment(segment) = event {
///             last = Some(segment);
///         }
///     }
/// }
/// assert!(decoder.is_finished());
/// assert_eq!(last.expect("a segment").at(0), compact.at(0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Decoder {
    limits: DecodeLimits,
    /// Bytes from `offset` of the file that are not yet decoded.
    bytes: Vec<u8>,
    offset: u64,
    /// Number of bytes from the start of the file that the next step needs.
    needed: u64,
    archive: Option<Box<Archive>>,
    /// Open cohorts with parts still to come.
    cohorts: BTreeMap<usize, Cohort>,
    /// Parts still to come: offset, cohort, and part of the cohort.
    parts: BTreeSet<(u64, usize, Part)>,
    /// Reader of a segment whose layers are decoded in part.
    reader: Option<SegmentReader>,
    finished: bool,
}

/// Part of a cohort.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    Head,
    /// A group of sections (see [`Cohort`]).
    Group(usize),
}

impl Decoder {
    /// A decoder of one file, which has received no bytes yet.
    ///
    /// - `limits`: bounds on memory and counts
    pub fn new(limits: DecodeLimits) -> Self {
        Self {
            limits,
            bytes: Vec::new(),
            offset: 0,
            needed: 0,
            archive: None,
            cohorts: BTreeMap::new(),
            parts: BTreeSet::new(),
            reader: None,
            finished: false,
        }
    }

    /// Decodes the parts of the file that the next bytes complete.
    ///
    /// - `bytes`: the next bytes of the file, any number
    /// - returns: the parts, in the order of the file; none if `bytes` complete no part
    ///
    /// # Errors
    /// [`DecodeError`] if the file is damaged, breaks a rule of the format, is of another version, exceeds the limits,
    /// or was complete already. The decoder cannot be used after an error.
    pub fn push(&mut self, bytes: &[u8]) -> Result<Vec<Event>, DecodeError> {
        let mut events = Vec::new();
        self.bytes.extend_from_slice(bytes);
        if self.archive.is_none() {
            // Refuses other files at the first wrong byte of the header.
            container::length_of_header(&self.bytes)?;
        }
        while !self.finished && self.offset + self.bytes.len() as u64 >= self.needed {
            if !self.step(&mut events)? {
                return Ok(events);
            }
        }
        if self.finished && !self.bytes.is_empty() {
            return Err(Cursor::new("file", self.offset, &[]).invalid("end", "bytes are left over"));
        }
        Ok(events)
    }

    /// The archive from the start of the file; `None` before [`Event::Header`].
    pub fn archive(&self) -> Option<&Archive> {
        self.archive.as_deref()
    }

    /// Whether all bytes of the file have arrived and [`Event::End`] was returned.
    pub fn is_finished(&self) -> bool {
        self.finished
    }

    /// Decodes the next part of the file if its bytes have arrived.
    ///
    /// - returns: false if more bytes are needed
    fn step(&mut self, events: &mut Vec<Event>) -> Result<bool, DecodeError> {
        let Some(archive) = &mut self.archive else {
            match Archive::open(&self.bytes, &self.limits)? {
                Opening::More(needed) => {
                    let waits = needed > self.bytes.len() as u64;
                    self.needed = needed;
                    return Ok(!waits);
                }
                Opening::Ready(archive) => {
                    events.push(Event::Header);
                    for cohort in 0..archive.num_cohorts() {
                        self.parts.insert((archive.head_range(cohort).start, cohort, Part::Head));
                    }
                    self.archive = Some(archive);
                    self.wait_for_next();
                    return Ok(true);
                }
            }
        };
        let Some((_, index, part)) = self.parts.pop_first() else {
            let end = archive.file_bytes();
            archive.check_optional(self.offset, &self.bytes[..(end - self.offset) as usize])?;
            self.drain(end);
            self.finished = true;
            events.push(Event::End);
            return Ok(true);
        };
        let range = match part {
            Part::Head => archive.head_range(index),
            Part::Group(group) => self.cohorts[&index].range_of(group..group + 1),
        };
        // The parts of an invalid file may overlap.
        if !range.is_empty() && range.start < self.offset {
            return Err(end_of_file(self.offset, "parts overlap"));
        }
        let end = match part {
            Part::Head => {
                let bytes =
                    if range.is_empty() { &[][..] } else { &self.bytes[(range.start - self.offset) as usize..] };
                let cohort = archive.open_cohort(index, bytes)?;
                for group in 0..cohort.num_groups() {
                    self.parts.insert((cohort.range_of(group..group + 1).start, index, Part::Group(group)));
                }
                // A cohort without Gaussians has no layers, so no group would produce its segments.
                for segment in 0..if cohort.num_layers() == 0 { cohort.num_segments() } else { 0 } {
                    events.push(Event::Segment(Box::new(cohort.read_segment(segment, &[])?)));
                }
                self.cohorts.insert(index, cohort);
                range.end
            }
            Part::Group(group) => {
                let cohort = self.cohorts.get_mut(&index).expect("a cohort that was opened");
                let end = range.end.max(self.offset);
                archive.check_optional(self.offset, &self.bytes[..(end - self.offset) as usize])?;
                let num_layers = cohort.num_layers();
                if group < num_layers {
                    let section = (range.start - self.offset) as usize..(range.end - self.offset) as usize;
                    cohort.read_shared(&self.bytes[section])?;
                    events.push(Event::Layer { cohort: index, layers: group + 1 });
                } else {
                    let (segment, layer) = (group / num_layers - 1, group % num_layers);
                    let mut reader = self.reader.take().filter(|_| layer > 0);
                    let mut reader = reader.take().unwrap_or_else(|| SegmentReader::new(cohort, segment));
                    reader.read(cohort, self.offset, &self.bytes, cohort.budget())?;
                    if layer + 1 < num_layers {
                        events.push(Event::Segment(Box::new(reader.snapshot(cohort)?)));
                        self.reader = Some(reader);
                    } else {
                        events.push(Event::Segment(Box::new(reader.finish(cohort))));
                    }
                }
                if group + 1 == cohort.num_groups() {
                    self.cohorts.remove(&index);
                }
                end
            }
        };
        self.drain(end);
        self.wait_for_next();
        Ok(true)
    }

    /// Drops the bytes before `end`.
    fn drain(&mut self, end: u64) {
        let end = end.max(self.offset);
        self.bytes.drain(..(end - self.offset) as usize);
        self.offset = end;
    }

    /// Sets the number of bytes that the next step needs.
    fn wait_for_next(&mut self) {
        let Some(archive) = &self.archive else { return };
        self.needed = match self.parts.first() {
            Some((_, cohort, Part::Head)) => archive.head_range(*cohort).end,
            Some((_, cohort, Part::Group(group))) => self.cohorts[cohort].range_of(*group..group + 1).end,
            None => archive.file_bytes(),
        };
    }
}
