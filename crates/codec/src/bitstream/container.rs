//! Magic, version, table of contents and checksums around sections of bytes.

use super::FORMAT_VERSION;
use super::section::{Cursor, Section, all};
use crate::error::DecodeError;

const MAGIC: [u8; 4] = *b"TCGS";
/// Magic, version, number of sections.
const FIXED_BYTES: usize = 8;
/// Tag, length, checksum.
const ENTRY_BYTES: usize = 16;
const CHECKSUM_BYTES: usize = 4;

/// One section of a file as it lies there.
pub(super) struct Part<'a> {
    pub(super) section: Section,
    /// In the file.
    pub(super) offset: usize,
    pub(super) bytes: &'a [u8],
    pub(super) checksum_ok: bool,
}

impl<'a> Part<'a> {
    pub(super) fn cursor(&self) -> Cursor<'a> {
        Cursor::new(self.section.name, self.offset, self.bytes)
    }
}

/// A file of the sections of [`all`], in that order.
pub(super) fn write(sections: &[Vec<u8>; 8]) -> Vec<u8> {
    let mut file = Vec::with_capacity(header_bytes() + sections.iter().map(Vec::len).sum::<usize>());
    file.extend(MAGIC);
    file.extend(FORMAT_VERSION.to_le_bytes());
    file.extend((sections.len() as u16).to_le_bytes());
    for (section, bytes) in all().iter().zip(sections) {
        file.extend(section.tag);
        file.extend((bytes.len() as u64).to_le_bytes());
        file.extend(crc32fast::hash(bytes).to_le_bytes());
    }
    let checksum = crc32fast::hash(&file);
    file.extend(checksum.to_le_bytes());
    for bytes in sections {
        file.extend(bytes);
    }
    file
}

/// Bytes before the first section.
pub(super) fn header_bytes() -> usize {
    FIXED_BYTES + all().len() * ENTRY_BYTES + CHECKSUM_BYTES
}

/// The sections of a file. Their checksums are compared but not insisted on.
pub(super) fn read(file: &[u8]) -> Result<Vec<Part<'_>>, DecodeError> {
    let mut cursor = Cursor::new("header", 0, file);
    if file.get(..4).is_none_or(|magic| magic != MAGIC) {
        return Err(cursor.invalid("magic", "this is not a .tcgs file"));
    }
    cursor.tag("magic")?;
    let found = cursor.u16("version")?;
    if found != FORMAT_VERSION {
        return Err(DecodeError::Version { found, expected: FORMAT_VERSION });
    }
    if usize::from(cursor.u16("number of sections")?) != all().len() {
        return Err(cursor.invalid("number of sections", "version 1 has 8"));
    }
    let mut entries = Vec::with_capacity(all().len());
    for section in all() {
        entries.push((section, cursor.tag("tag")?, cursor.u64("length")?, cursor.u32("checksum")?));
    }
    let checksum = crc32fast::hash(&file[..header_bytes() - CHECKSUM_BYTES]);
    if cursor.u32("checksum")? != checksum {
        return Err(cursor.invalid("checksum", "the header is damaged"));
    }
    let mut offset = header_bytes();
    let mut parts = Vec::with_capacity(entries.len());
    for (section, tag, length, checksum) in entries {
        if tag != section.tag {
            return Err(cursor.invalid("tag", "not the sections of version 1 in their order"));
        }
        let Some(bytes) = usize::try_from(length).ok().and_then(|length| file[offset..].get(..length)) else {
            return Err(Cursor::new(section.name, offset, &[]).invalid("length", "the file ends early"));
        };
        parts.push(Part { section, offset, bytes, checksum_ok: crc32fast::hash(bytes) == checksum });
        offset += bytes.len();
    }
    if offset < file.len() {
        return Err(Cursor::new("file", offset, &[]).invalid("end", "bytes are left over"));
    }
    Ok(parts)
}
