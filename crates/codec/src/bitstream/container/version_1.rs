//! The container of version 1: magic, version, table of contents, and all sections of the only cohort in a fixed order.

use std::io::{Seek, SeekFrom, Write};
use std::sync::Arc;

use super::super::archive::{Archive, Opening};
use super::super::cohort::Cohort;
use super::super::head::{Head, MAX_SEGMENTS, read_info_1};
use super::super::plan::read_plan_1;
use super::super::section::{self, Cursor, Entry, INFO, MAPS, PLAN, SHARED, Tag};
use super::{MAGIC, agrees};
use crate::error::{CompressError, DecodeError};
use crate::limits::{Budget, DecodeLimits};

/// Magic, version, reserved, number of sections, checksum.
pub(super) const FIXED_BYTES: usize = 16;
/// Tag, segment, layer, length, checksum.
const ENTRY_BYTES: usize = 16;
/// Offset of the header's checksum.
const CHECKSUM_AT: usize = 12;
/// Largest number of sections: more than all attributes of 65,535 segments in practice.
const MAX_SECTIONS: u32 = 1 << 20;

/// Tags of the mandatory sections that version 1 knows.
const KNOWN: [Tag; 8] = [INFO, PLAN, MAPS, *b"MEAN", *b"QUAT", *b"SCAL", *b"OPAC", *b"COLR"];

/// A section to be written.
pub struct Part {
    pub tag: Tag,
    pub segment: u16,
    pub layer: u16,
    pub bytes: Vec<u8>,
}

impl Part {
    /// A section that belongs to no segment.
    pub fn shared(tag: Tag, layer: usize, bytes: Vec<u8>) -> Self {
        Self { tag, segment: SHARED, layer: layer as u16, bytes }
    }
}

/// Writes a file section by section, and at the end its table of contents.
pub struct Writer<'a, W> {
    file: &'a mut W,
    /// Position of the file's first byte.
    start: u64,
    /// Header and the entries of the sections written so far; the checksum is still 0.
    header: Vec<u8>,
    num_sections: usize,
}

impl<'a, W: Write + Seek> Writer<'a, W> {
    /// Reserves space for the header.
    ///
    /// # Errors
    /// [`CompressError`] if there are more than 2^20 sections or the file cannot be written.
    pub fn new(file: &'a mut W, num_sections: usize) -> Result<Self, CompressError> {
        let expected = MAX_SECTIONS as usize;
        if num_sections > expected {
            return Err(CompressError::Count { what: "sections".into(), found: num_sections, expected });
        }
        let start = file.stream_position()?;
        file.write_all(&vec![0; header_bytes(num_sections)])?;
        let mut header = Vec::with_capacity(header_bytes(num_sections));
        header.extend(MAGIC);
        header.extend(1_u16.to_le_bytes());
        header.extend(0_u16.to_le_bytes());
        header.extend((num_sections as u32).to_le_bytes());
        header.extend(0_u32.to_le_bytes());
        Ok(Self { file, start, header, num_sections })
    }

    /// Writes the next section.
    ///
    /// # Errors
    /// [`CompressError`] if the section is of 4 GiB or more, or the file cannot be written.
    pub fn section(&mut self, part: &Part) -> Result<(), CompressError> {
        let (found, expected) = (part.bytes.len(), u32::MAX as usize);
        let too_long = |_| CompressError::Count { what: "bytes of a section".into(), found, expected };
        let length = u32::try_from(found).map_err(too_long)?;
        self.header.extend(part.tag);
        self.header.extend(part.segment.to_le_bytes());
        self.header.extend(part.layer.to_le_bytes());
        self.header.extend(length.to_le_bytes());
        self.header.extend(crc32fast::hash(&part.bytes).to_le_bytes());
        Ok(self.file.write_all(&part.bytes)?)
    }

    /// Writes the header, after all sections; leaves the position at the end of the file.
    ///
    /// # Errors
    /// [`CompressError::Io`] if the file cannot be written.
    ///
    /// # Panics
    /// If the number of sections written differs from that given to [`Self::new`].
    pub fn finish(mut self) -> Result<(), CompressError> {
        assert_eq!(self.header.len(), header_bytes(self.num_sections), "bytes of the table of contents");
        let checksum = header_checksum(&self.header);
        self.header[CHECKSUM_AT..FIXED_BYTES].copy_from_slice(&checksum.to_le_bytes());
        let end = self.file.stream_position()?;
        self.file.seek(SeekFrom::Start(self.start))?;
        self.file.write_all(&self.header)?;
        self.file.seek(SeekFrom::Start(end))?;
        Ok(())
    }
}

/// Bytes before the first section.
fn header_bytes(num_sections: usize) -> usize {
    FIXED_BYTES + num_sections * ENTRY_BYTES
}

/// CRC-32 of the header without its checksum field.
fn header_checksum(header: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&header[..CHECKSUM_AT]);
    hasher.update(&header[FIXED_BYTES..]);
    hasher.finalize()
}

/// Length of the header; `None` if the bytes end before it.
///
/// - `cursor`: after the version
/// - `found`: number of bytes available
pub(super) fn length_of_header(mut cursor: Cursor<'_>, found: usize) -> Result<Option<usize>, DecodeError> {
    if found < FIXED_BYTES {
        return Ok(None);
    }
    if cursor.u16("reserved")? != 0 {
        return Err(cursor.invalid("reserved", "not zero"));
    }
    let num_sections = cursor.u32("number of sections")?;
    if num_sections > MAX_SECTIONS {
        return Err(cursor.invalid("number of sections", "more than 1048576"));
    }
    Ok(Some(header_bytes(num_sections as usize)))
}

/// Opens a file from its first bytes.
///
/// - `header`: its length is that of [`length_of_header`]
pub fn open(header: &[u8], start: &[u8], limits: &DecodeLimits) -> Result<Opening, DecodeError> {
    let entries = read_header(header)?;
    let head_end = entries.iter().filter(|e| e.tag == INFO || e.tag == PLAN).map(|e| e.range.end).max();
    let head_end = head_end.unwrap_or(header.len() as u64);
    if head_end > start.len() as u64 {
        return Ok(Opening::More(head_end));
    }
    let mut sections = entries.iter().enumerate().filter(|(_, e)| !e.is_optional());
    let mut next = |tag: Tag, segment: usize, layer: usize| {
        let found = sections.next();
        let place = found.map_or(header.len() - ENTRY_BYTES, |(index, _)| FIXED_BYTES + index * ENTRY_BYTES);
        found
            .filter(|(_, e)| (e.tag, usize::from(e.segment), usize::from(e.layer)) == (tag, segment, layer))
            .map(|(_, entry)| entry.clone())
            .ok_or_else(|| Cursor::new("header", place as u64, &[]).invalid("tag", "not the section that is due"))
    };
    let shared = usize::from(SHARED);
    let bytes = |entry: &Entry| &start[entry.range.start as usize..entry.range.end as usize];
    let at_info = next(INFO, shared, 0)?;
    let (info, segment_length, layers) = read_info_1(at_info.open(bytes(&at_info))?, limits)?;
    let plan = next(PLAN, shared, 0)?;
    let plan = read_plan_1(plan.open(bytes(&plan))?)?;
    let head = Head {
        index: 0,
        plan: Arc::new(plan),
        start: 0,
        num_timesteps: info.scene.num_timesteps as usize,
        num_gaussians: info.scene.num_gaussians as usize,
        has_lives: false,
        layers,
        segment_length,
        info: Arc::new(info),
    };
    if head.num_segments() > MAX_SEGMENTS {
        let at_info = Cursor::new(section::name(INFO), at_info.range.start, &[]);
        return Err(at_info.invalid("segment_length", "more than 65535 segments"));
    }
    let mut of_cohort = Vec::new();
    for layer in 0..head.layers.len() {
        of_cohort.push(next(MAPS, shared, layer)?);
        for attribute in head.plan.layout.attributes() {
            of_cohort.push(next(section::of_attribute(attribute), shared, layer)?);
        }
    }
    for segment in 0..head.num_segments() {
        for layer in 0..head.layers.len() {
            for attribute in head.plan.varying() {
                of_cohort.push(next(section::of_attribute(attribute), segment, layer)?);
            }
        }
    }
    if let Some((index, _)) = sections.next() {
        let place = FIXED_BYTES + index * ENTRY_BYTES;
        return Err(Cursor::new("header", place as u64, &[]).invalid("tag", "a section too many"));
    }
    let length = entries.last().map_or(header.len() as u64, |e| e.range.end);
    let cohort = Cohort::new(head, of_cohort, Arc::new(Budget::new(limits, length)));
    Ok(Opening::Ready(Box::new(Archive::of_one(length, entries, cohort, limits))))
}

/// Reads the table of contents.
///
/// - `header`: its length is that of [`length_of_header`]
fn read_header(header: &[u8]) -> Result<Vec<Entry>, DecodeError> {
    let mut cursor = Cursor::new("header", 0, header);
    cursor.take("header", CHECKSUM_AT)?;
    let checksum = cursor.u32("checksum")?;
    if !agrees(checksum, header_checksum(header)) {
        return Err(cursor.invalid("checksum", "the header is damaged"));
    }
    let mut offset = header.len() as u64;
    let mut entries = Vec::with_capacity((header.len() - FIXED_BYTES) / ENTRY_BYTES);
    for _ in 0..entries.capacity() {
        let tag = cursor.tag("tag")?;
        let (segment, layer) = (cursor.u16("segment")?, cursor.u16("layer")?);
        let end = offset + u64::from(cursor.u32("length")?);
        let entry = Entry { tag, segment, layer, range: offset..end, checksum: cursor.u32("checksum")? };
        if !KNOWN.contains(&tag) && !entry.is_optional() {
            return Err(cursor.invalid("tag", "a section that this decoder does not know and may not skip"));
        }
        offset = end;
        entries.push(entry);
    }
    Ok(entries)
}
