//! The header of a PLY file of any content, read within bounded memory, and the least length of the file according to
//! it.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek};
use std::path::Path;

use serde_ply::{DeserializeError, PlyFormat, PlyHeader, PlyReader, PropertyType, ScalarType};

use crate::{InterchangeError, input};

/// Longest header that is read, bytes. A header of 59 properties has 1.5 kB; comments may follow.
const MAX_HEADER_BYTES: u64 = 1 << 20;

/// Opens a PLY file and reads its header.
///
/// - `damaged`: makes the problem from the error of the reader
/// - returns: the reader, and the file's length
///
/// # Errors
/// [`InterchangeError`] if the file cannot be read, or begins with no header of at most [`MAX_HEADER_BYTES`].
pub(crate) fn open_header(
    path: &Path,
    damaged: impl FnOnce(DeserializeError) -> InterchangeError,
) -> Result<(PlyReader<BufReader<File>>, u64), InterchangeError> {
    let failed = |error| InterchangeError::Read { path: path.into(), error };
    let (file, length) = input::open(path)?;
    let mut file = BufReader::new(file);
    // The crate's reader takes lines of any length.
    let header = header_bytes(&mut file).map_err(failed)?;
    if header >= MAX_HEADER_BYTES {
        let problem = format!("has a header of more than {MAX_HEADER_BYTES} bytes, expected a shorter one");
        return Err(InterchangeError::File { path: path.into(), problem });
    }
    file.rewind().map_err(failed)?;
    Ok((PlyReader::from_reader(file).map_err(damaged)?, length))
}

/// Bytes up to the end of the line `end_header`, or of the file; at most [`MAX_HEADER_BYTES`].
fn header_bytes(file: &mut impl BufRead) -> std::io::Result<u64> {
    let mut left = file.take(MAX_HEADER_BYTES);
    let mut line = Vec::new();
    loop {
        line.clear();
        left.read_until(b'\n', &mut line)?;
        if line.is_empty() || line.trim_ascii() == b"end_header" {
            return Ok(MAX_HEADER_BYTES - left.limit());
        }
    }
}

/// Fewest bytes of the rows: with it, a file's length bounds the number of rows. `None` beyond `u64`.
pub(crate) fn least_bytes(header: &PlyHeader) -> Option<u64> {
    let bytes = |property: &PropertyType| match property {
        // A digit and a space.
        _ if header.format == PlyFormat::Ascii => 2,
        // A count of bytes, which is zero.
        PropertyType::List { .. } => 1,
        PropertyType::Scalar(ScalarType::I8 | ScalarType::U8) => 1,
        PropertyType::Scalar(ScalarType::I16 | ScalarType::U16) => 2,
        PropertyType::Scalar(ScalarType::I32 | ScalarType::U32 | ScalarType::F32) => 4,
        PropertyType::Scalar(ScalarType::F64) => 8,
    };
    let known = header.elem_defs.iter().filter(|element| ["chunk", "vertex", "sh"].contains(&&*element.name));
    known
        .map(|element| {
            let row: u64 = element.properties.iter().map(|property| bytes(&property.property_type)).sum();
            row.checked_mul(element.count as u64)
        })
        .try_fold(0_u64, |sum, bytes| sum.checked_add(bytes?))
}
