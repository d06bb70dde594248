//! Kinds of sections, entries of the table of contents, and a cursor that reads a section's fields one after another.

use std::ops::Range;

use tcgs_core::Attribute;

use crate::error::DecodeError;

/// Kind of a section.
pub(super) type Tag = [u8; 4];

/// Counts and provenance.
pub(super) const INFO: Tag = *b"INFO";
/// Timesteps and positions of the cohorts.
pub(super) const COHORTS: Tag = *b"COHO";
/// Coding of the tracks: quantizers, predictors.
pub(super) const PLAN: Tag = *b"PLAN";
/// Bit widths, and flags of the tracks that move.
pub(super) const MAPS: Tag = *b"MAPS";
/// Application data.
pub(super) const APPLICATION: Tag = *b"appl";
/// Segment number of a section that belongs to no segment.
pub(super) const SHARED: u16 = u16::MAX;

/// Tag of the codes of an attribute: first codes in a shared layer, keypoints in a segment.
pub(super) fn of_attribute(attribute: Attribute) -> Tag {
    match attribute {
        Attribute::Mean => *b"MEAN",
        Attribute::Quat => *b"QUAT",
        Attribute::LogScale => *b"SCAL",
        Attribute::LogitOpacity => *b"OPAC",
        Attribute::Color => *b"COLR",
        Attribute::Extra { .. } => *b"MORE",
    }
}

/// Content of a skipped attribute. A head stores no tags; this one serves the table of its sections.
pub(super) const SKIPPED: Tag = *b"skip";

/// Name of a section in messages.
pub(super) fn name(tag: Tag) -> &'static str {
    match &tag {
        b"INFO" => "info",
        b"PLAN" => "plan",
        b"MAPS" => "maps",
        b"COHO" => "cohorts",
        b"MORE" => "further attribute",
        b"skip" => "skipped attribute",
        b"appl" => "application data",
        _ => Attribute::BASE.into_iter().find(|&a| of_attribute(a) == tag).map_or("unknown section", Attribute::name),
    }
}

/// A section in the table of contents.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    pub(super) tag: Tag,
    pub(super) segment: u16,
    pub(super) layer: u16,
    /// Byte range in the file.
    pub(super) range: Range<u64>,
    pub(super) checksum: u32,
}

impl Entry {
    /// Whether a reader that does not know the section may skip it.
    pub(super) fn is_optional(&self) -> bool {
        self.tag[0] & 0x20 != 0
    }

    /// The fields of the section; fails if it is damaged.
    pub(super) fn open<'a>(&self, bytes: &'a [u8]) -> Result<Cursor<'a>, DecodeError> {
        let cursor = Cursor::new(name(self.tag), self.range.start, bytes);
        let undamaged = cfg!(fuzzing) || crc32fast::hash(bytes) == self.checksum;
        if undamaged { Ok(cursor) } else { Err(cursor.invalid("checksum", "the section is damaged")) }
    }
}

/// Reads fields from the bytes of one section, never past its end.
pub(super) struct Cursor<'a> {
    section: &'static str,
    /// Offset of the section in the file.
    offset: u64,
    bytes: &'a [u8],
    position: usize,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(section: &'static str, offset: u64, bytes: &'a [u8]) -> Self {
        Self { section, offset, bytes, position: 0 }
    }

    /// An error at the current position.
    pub(super) fn invalid(&self, field: &'static str, problem: &'static str) -> DecodeError {
        DecodeError::Format { section: self.section, field, offset: self.offset + self.position as u64, problem }
    }

    /// Number of bytes read so far.
    pub(super) fn position(&self) -> u64 {
        self.position as u64
    }

    pub(super) fn take(&mut self, field: &'static str, length: usize) -> Result<&'a [u8], DecodeError> {
        let rest = &self.bytes[self.position..];
        let taken = rest.get(..length).ok_or_else(|| self.invalid(field, "reaches past the end"))?;
        self.position += length;
        Ok(taken)
    }

    /// The bytes of the section not yet read.
    pub(super) fn rest(&mut self) -> &'a [u8] {
        let rest = &self.bytes[self.position..];
        self.position = self.bytes.len();
        rest
    }

    fn array<const L: usize>(&mut self, field: &'static str) -> Result<[u8; L], DecodeError> {
        let mut bytes = [0; L];
        bytes.copy_from_slice(self.take(field, L)?);
        Ok(bytes)
    }

    pub(super) fn u8(&mut self, field: &'static str) -> Result<u8, DecodeError> {
        self.array(field).map(u8::from_le_bytes)
    }

    pub(super) fn u16(&mut self, field: &'static str) -> Result<u16, DecodeError> {
        self.array(field).map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self, field: &'static str) -> Result<u32, DecodeError> {
        self.array(field).map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self, field: &'static str) -> Result<u64, DecodeError> {
        self.array(field).map(u64::from_le_bytes)
    }

    pub(super) fn f32(&mut self, field: &'static str) -> Result<f32, DecodeError> {
        self.array(field).map(f32::from_le_bytes)
    }

    pub(super) fn tag(&mut self, field: &'static str) -> Result<Tag, DecodeError> {
        self.array(field)
    }

    /// A text: its length in two bytes, then that many bytes of UTF-8.
    pub(super) fn text(&mut self, field: &'static str) -> Result<String, DecodeError> {
        let length = self.u16(field)?;
        let text = std::str::from_utf8(self.take(field, length.into())?);
        text.map(str::to_owned).map_err(|_| self.invalid(field, "not UTF-8"))
    }

    /// Refuses a section with unread bytes.
    pub(super) fn finish(self) -> Result<(), DecodeError> {
        if self.position == self.bytes.len() { Ok(()) } else { Err(self.invalid("end", "bytes are left over")) }
    }
}
