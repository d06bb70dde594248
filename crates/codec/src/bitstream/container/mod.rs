//! The containers of both versions (`docs/FORMAT.md`, "Container"): positions of sections in a file, and checksums.

pub(super) mod version_1;
pub(super) mod version_2;

use super::section::{Cursor, Tag};
use crate::error::DecodeError;

/// The first four bytes of every `.tcgs` file.
pub const MAGIC: Tag = *b"TCGS";
/// Number of bytes that give the length of the header; for an unknown version the smallest such number.
pub(super) fn fixed_bytes(start: &[u8]) -> usize {
    match start.get(MAGIC.len()..MAGIC.len() + 2) {
        Some([2, 0]) => version_2::FIXED_BYTES,
        _ => version_1::FIXED_BYTES,
    }
}

/// Whether a checksum matches; always true when fuzzing, since a fuzzer cannot guess checksums.
fn agrees(checksum: u32, hash: u32) -> bool {
    cfg!(fuzzing) || checksum == hash
}

/// Version and length of the header; `None` if the bytes end before them.
///
/// # Errors
/// If this is not a file of a known version.
pub(super) fn length_of_header(start: &[u8]) -> Result<Option<(u16, usize)>, DecodeError> {
    let known = start.len().min(MAGIC.len());
    let mut cursor = Cursor::new("header", 0, start);
    if start[..known] != MAGIC[..known] {
        return Err(cursor.invalid("magic", "this is not a .tcgs file"));
    }
    if start.len() < 6 {
        return Ok(None);
    }
    cursor.tag("magic")?;
    let version = cursor.u16("version")?;
    let length = match version {
        1 => version_1::length_of_header(cursor, start.len())?,
        2 => version_2::length_of_header(cursor, start.len())?,
        found => return Err(DecodeError::Version { found, expected: super::FORMAT_VERSION }),
    };
    Ok(length.map(|length| (version, length)))
}
