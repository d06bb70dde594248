//! Push decoding: a file is decoded while its bytes arrive, in pieces of any size.

use super::archive::{Archive, Opening};
use super::container;
use super::reader::SegmentReader;
use super::section::Cursor;
use super::segment::Segment;
use crate::error::DecodeError;
use crate::limits::DecodeLimits;

/// A part of the file that the bytes given to [`Decoder::push`] completed. The parts come in the order of the variants.
#[derive(Debug)]
pub enum Event {
    /// The table of contents, `INFO` and `PLAN`: [`Decoder::archive`] is available from now on.
    Header,
    /// One more shared layer.
    Layer {
        /// Number of shared layers so far.
        layers: usize,
    },
    /// A segment with the layers that arrived so far. A segment comes once for each of its layers, each time with one
    /// layer more.
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
    /// Bytes from `offset` of the file that were not yet decoded.
    bytes: Vec<u8>,
    offset: u64,
    /// Number of bytes from the start of the file that the next step needs.
    needed: u64,
    archive: Option<Box<Archive>>,
    /// Reader of the segment of which some layers were decoded.
    reader: Option<SegmentReader>,
    /// Number of groups of sections (see [`Archive`]) that were decoded.
    groups: usize,
    finished: bool,
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
            reader: None,
            groups: 0,
            finished: false,
        }
    }

    /// Decodes the parts of the file that the next bytes complete.
    ///
    /// - `bytes`: the bytes of the file that follow those of the call before, any number
    /// - returns: the parts, in the order of the file; none if `bytes` complete no part
    ///
    /// # Errors
    /// [`DecodeError`] if the file is damaged, breaks a rule of the format, is of another version, exceeds the limits,
    /// or was complete already. The decoder cannot be used after an error.
    pub fn push(&mut self, bytes: &[u8]) -> Result<Vec<Event>, DecodeError> {
        let mut events = Vec::new();
        self.bytes.extend_from_slice(bytes);
        if self.archive.is_none() {
            // What is no such file is refused as soon as it can be told.
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

    /// Table of contents and shared layers of the file; none before [`Event::Header`].
    pub fn archive(&self) -> Option<&Archive> {
        self.archive.as_deref()
    }

    /// Whether all bytes of the file have arrived: [`Event::End`] was returned.
    pub fn is_finished(&self) -> bool {
        self.finished
    }

    /// Decodes the next part of the file, if its bytes have arrived.
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
                    self.archive = Some(archive);
                    return Ok(self.wait_for_next());
                }
            }
        };
        let (num_layers, num_groups) = (archive.num_layers(), archive.num_layers() * (1 + archive.num_segments()));
        if self.groups == num_groups {
            let end = archive.file_bytes();
            archive.check_optional(self.offset, &self.bytes[..(end - self.offset) as usize])?;
            self.bytes.drain(..(end - self.offset) as usize);
            self.offset = end;
            self.finished = true;
            // A scene without Gaussians has no layers to send its segments with.
            if num_layers == 0 {
                for segment in 0..archive.num_segments() {
                    events.push(Event::Segment(Box::new(archive.read_segment(segment, &[])?)));
                }
            }
            events.push(Event::End);
            return Ok(true);
        }
        let range = archive.range_of(self.groups..self.groups + 1);
        let start = (range.start - self.offset) as usize;
        archive.check_optional(self.offset, &self.bytes[..(range.end - self.offset) as usize])?;
        if self.groups < num_layers {
            archive.read_shared(&self.bytes[start..(range.end - self.offset) as usize])?;
            events.push(Event::Layer { layers: self.groups + 1 });
        } else {
            let (segment, layer) = (self.groups / num_layers - 1, self.groups % num_layers);
            let mut reader = self.reader.take().filter(|_| layer > 0);
            let mut reader = reader.take().unwrap_or_else(|| SegmentReader::new(archive, segment));
            reader.read(archive, self.offset, &self.bytes, archive.budget())?;
            if layer + 1 < num_layers {
                events.push(Event::Segment(Box::new(reader.snapshot(archive)?)));
                self.reader = Some(reader);
            } else {
                events.push(Event::Segment(Box::new(reader.finish(archive))));
            }
        }
        self.groups += 1;
        self.bytes.drain(..(range.end - self.offset) as usize);
        self.offset = range.end;
        Ok(self.wait_for_next())
    }

    /// Sets the number of bytes that the next step needs.
    fn wait_for_next(&mut self) -> bool {
        if let Some(archive) = &self.archive {
            let num_groups = archive.num_layers() * (1 + archive.num_segments());
            self.needed = if self.groups < num_groups {
                archive.range_of(self.groups..self.groups + 1).end
            } else {
                archive.file_bytes()
            };
        }
        true
    }
}
