//! The containers of both versions (`docs/FORMAT.md`, "Container"): where sections lie in a file, and checksums around
//! them.

pub(super) mod version_1;
pub(super) mod version_2;

use super::section::{Cursor, Tag};
use crate::error::DecodeError;

/// The first four bytes of every `.tcgs` file.
pub const MAGIC: Tag = *b"TCGS";
/// Bytes from which the length of the header follows; of a version that is not known yet those of the shortest.
pub(super) fn fixed_bytes(start: &[u8]) -> usize {
    match start.get(MAGIC.len()..MAGIC.len() + 2) {
        Some([2, 0]) => version_2::FIXED_BYTES,
        _ => version_1::FIXED_BYTES,
    }
}

/// A checksum that a fuzzer need not guess.
fn agrees(checksum: u32, hash: u32) -> bool {
    cfg!(fuzzing) || checksum == hash
}

/// Version and length of the header, if the bytes reach far enough to tell.
///
/// # Errors
/// If this is no file of a version known.
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
