//! The container of a file (`docs/FORMAT.md`, "Container"): magic, version, table of contents and checksums around
//! sections. The content of a section is opaque here.

use std::io::{Seek, SeekFrom, Write};

use super::FORMAT_VERSION;
use super::section::{self, Cursor, Entry, SHARED, Tag};
use crate::error::{CompressError, DecodeError};

/// The first four bytes of every `.tcgs` file.
pub const MAGIC: Tag = *b"TCGS";
/// Magic, version, reserved, number of sections, checksum.
pub(super) const FIXED_BYTES: usize = 16;
/// Tag, segment, layer, length, checksum.
pub(super) const ENTRY_BYTES: usize = 16;
/// Where the checksum of the header lies.
const CHECKSUM_AT: usize = 12;
/// Most sections: all attributes of 65,535 segments are more than anyone needs.
const MAX_SECTIONS: u32 = 1 << 20;

/// A section to be written.
pub(super) struct Part {
    pub(super) tag: Tag,
    pub(super) segment: u16,
    pub(super) layer: u16,
    pub(super) bytes: Vec<u8>,
}

impl Part {
    /// A section that belongs to no segment.
    pub(super) fn shared(tag: Tag, layer: usize, bytes: Vec<u8>) -> Self {
        Self { tag, segment: SHARED, layer: layer as u16, bytes }
    }
}

/// Writes a file section after section, and in the end its table of contents.
pub(super) struct Writer<'a, W> {
    file: &'a mut W,
    /// Position of the file's first byte.
    start: u64,
    /// Header and the entries of the sections written so far; the checksum is 0.
    header: Vec<u8>,
    num_sections: usize,
}

impl<'a, W: Write + Seek> Writer<'a, W> {
    /// Leaves room for the header.
    ///
    /// # Errors
    /// [`CompressError`] if there are more than 2^20 sections or the file cannot be written.
    pub(super) fn new(file: &'a mut W, num_sections: usize) -> Result<Self, CompressError> {
        let expected = MAX_SECTIONS as usize;
        if num_sections > expected {
            return Err(CompressError::Count { what: "sections".into(), found: num_sections, expected });
        }
        let start = file.stream_position()?;
        file.write_all(&vec![0; header_bytes(num_sections)])?;
        let mut header = Vec::with_capacity(header_bytes(num_sections));
        header.extend(MAGIC);
        header.extend(FORMAT_VERSION.to_le_bytes());
        header.extend(0_u16.to_le_bytes());
        header.extend((num_sections as u32).to_le_bytes());
        header.extend(0_u32.to_le_bytes());
        Ok(Self { file, start, header, num_sections })
    }

    /// Writes the next section.
    ///
    /// # Errors
    /// [`CompressError`] if the section is of 4 GiB or more, or the file cannot be written.
    pub(super) fn section(&mut self, part: &Part) -> Result<(), CompressError> {
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

    /// Writes the header, after all sections; the file then stands at its end.
    ///
    /// # Errors
    /// [`CompressError::Io`] if the file cannot be written.
    ///
    /// # Panics
    /// If another number of sections was written than [`Self::new`] was told.
    pub(super) fn finish(mut self) -> Result<(), CompressError> {
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

/// CRC-32 of the header without the field of the checksum.
fn header_checksum(header: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&header[..CHECKSUM_AT]);
    hasher.update(&header[FIXED_BYTES..]);
    hasher.finalize()
}

/// Length of the header, if the bytes reach far enough to tell.
///
/// # Errors
/// If this is no file of the one version known.
pub(super) fn length_of_header(start: &[u8]) -> Result<Option<usize>, DecodeError> {
    let known = start.len().min(MAGIC.len());
    let mut cursor = Cursor::new("header", 0, start);
    if start[..known] != MAGIC[..known] {
        return Err(cursor.invalid("magic", "this is not a .tcgs file"));
    }
    if start.len() < FIXED_BYTES {
        return Ok(None);
    }
    cursor.tag("magic")?;
    let found = cursor.u16("version")?;
    if found != FORMAT_VERSION {
        return Err(DecodeError::Version { found, expected: FORMAT_VERSION });
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

/// The table of contents.
///
/// - `header`: of the length that [`length_of_header`] gives
pub(super) fn read_header(header: &[u8]) -> Result<Vec<Entry>, DecodeError> {
    let mut cursor = Cursor::new("header", 0, header);
    cursor.take("header", CHECKSUM_AT)?;
    let checksum = cursor.u32("checksum")?;
    if !cfg!(fuzzing) && checksum != header_checksum(header) {
        return Err(cursor.invalid("checksum", "the header is damaged"));
    }
    let mut offset = header.len() as u64;
    let mut entries = Vec::with_capacity((header.len() - FIXED_BYTES) / ENTRY_BYTES);
    for _ in 0..entries.capacity() {
        let tag = cursor.tag("tag")?;
        let (segment, layer) = (cursor.u16("segment")?, cursor.u16("layer")?);
        let end = offset + u64::from(cursor.u32("length")?);
        let entry = Entry { tag, segment, layer, range: offset..end, checksum: cursor.u32("checksum")? };
        if section::name(tag) == "unknown section" && !entry.is_optional() {
            return Err(cursor.invalid("tag", "a section that this decoder does not know and may not skip"));
        }
        offset = end;
        entries.push(entry);
    }
    Ok(entries)
}
