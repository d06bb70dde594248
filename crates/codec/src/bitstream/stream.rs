//! Many symbols as compressed bytes.
//!
//! A stream is a byte of method (low four bits: [`Method`]; high four: [`Transform`]), a `u32` length
//! and that many bytes. The number of symbols is never stored: the reader knows it. Symbols of several
//! bytes lie in planes, all lowest bytes first, so that the noise of the low ones does not hide the
//! regularity of the high ones.

use std::io::Read;

use super::residual::Transform;
use super::section::Cursor;
use crate::error::DecodeError;
use crate::limits::Budget;

/// Slow to write, no slower to read.
const ZSTD_LEVEL: i32 = 19;
/// Largest window that [`ZSTD_LEVEL`] uses; a file may not ask for more.
const ZSTD_WINDOW_LOG: u32 = 23;

#[repr(u8)]
enum Method {
    Stored = 0,
    Zstd = 1,
}

/// Bytes of a stream before compression: `planes[p * count + i]` is byte `p` of symbol `i`.
pub(super) struct Planes {
    count: usize,
    bytes: Vec<u8>,
}

impl Planes {
    pub(super) fn new(symbols: impl IntoIterator<Item = u64>, count: usize, symbol_bytes: usize) -> Self {
        let mut bytes = vec![0; count * symbol_bytes];
        let mut written = 0;
        for (i, symbol) in symbols.into_iter().enumerate() {
            for (plane, byte) in symbol.to_le_bytes()[..symbol_bytes].iter().enumerate() {
                bytes[plane * count + i] = *byte;
            }
            written += 1;
        }
        debug_assert_eq!(written, count);
        Self { count, bytes }
    }

    #[inline(always)]
    pub(super) fn get(&self, index: usize) -> u64 {
        let plane_starts = (index..self.bytes.len()).step_by(self.count);
        plane_starts.enumerate().fold(0, |symbol, (plane, at)| symbol | u64::from(self.bytes[at]) << (8 * plane))
    }
}

/// The shortest stream of several that say the same; of equal ones the first.
pub(super) fn write(candidates: &[(Transform, Planes)]) -> Vec<u8> {
    let streams = candidates.iter().map(|(transform, planes)| {
        let raw = &planes.bytes;
        let packed = zstd::bulk::compress(raw, ZSTD_LEVEL).ok().filter(|packed| packed.len() < raw.len());
        let (method, body) = match &packed {
            Some(packed) => (Method::Zstd, packed),
            None => (Method::Stored, raw),
        };
        assert!(body.len() <= u32::MAX as usize, "a stream of {} bytes, expected less than 4 GiB", body.len());
        let mut stream = vec![method as u8 | (*transform as u8) << 4];
        stream.extend((body.len() as u32).to_le_bytes());
        stream.extend(body);
        stream
    });
    streams.min_by_key(Vec::len).unwrap_or_default()
}

/// Reads a stream of `count` symbols of `symbol_bytes`.
///
/// - `transforms`: those that may be used
pub(super) fn read(
    cursor: &mut Cursor<'_>,
    budget: &mut Budget,
    field: &'static str,
    transforms: &[Transform],
    count: usize,
    symbol_bytes: usize,
) -> Result<(Transform, Planes), DecodeError> {
    let head = cursor.u8(field)?;
    let transform = transforms.iter().copied().find(|&t| t as u8 == head >> 4);
    let transform = transform.ok_or_else(|| cursor.invalid(field, "an unknown transform"))?;
    let length = cursor.u32(field)?;
    let body = cursor.take(field, length as usize)?;
    let expected = budget.reserve(field, count as u64, symbol_bytes)? * symbol_bytes;
    let bytes = match head & 15 {
        0 => body.to_vec(),
        1 => unzstd(body, expected).map_err(|_| cursor.invalid(field, "damaged zstd data"))?,
        _ => return Err(cursor.invalid(field, "an unknown method")),
    };
    if bytes.len() != expected {
        return Err(cursor.invalid(field, "another number of symbols than the counts say"));
    }
    Ok((transform, Planes { count, bytes }))
}

/// Grows with what is really there, up to one byte more than expected.
fn unzstd(body: &[u8], expected: usize) -> std::io::Result<Vec<u8>> {
    let mut decoder = zstd::stream::read::Decoder::with_buffer(body)?.single_frame();
    decoder.window_log_max(ZSTD_WINDOW_LOG)?;
    let mut bytes = Vec::new();
    (&mut decoder).take(expected as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() == expected && !decoder.finish().is_empty() {
        return Err(std::io::ErrorKind::InvalidData.into());
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::DecodeLimits;

    fn read_back(stream: &[u8], count: usize, symbol_bytes: usize, max_bytes: u64) -> Result<Vec<u64>, DecodeError> {
        let mut cursor = Cursor::new("test", 0, stream);
        let mut budget = Budget::new(&DecodeLimits { max_bytes, ..Default::default() });
        let (_, planes) = read(&mut cursor, &mut budget, "codes", &[Transform::Plain], count, symbol_bytes)?;
        cursor.finish()?;
        Ok((0..count).map(|i| planes.get(i)).collect())
    }

    #[test]
    fn symbols_of_every_size_come_back() {
        for symbol_bytes in 1..=6 {
            for count in [0, 1, 1000] {
                let symbols: Vec<u64> = (0..count as u64)
                    .map(|i| i.wrapping_mul(0x9e37_79b9_7f4a) & ((1 << (8 * symbol_bytes)) - 1))
                    .collect();
                let planes = Planes::new(symbols.iter().copied(), count, symbol_bytes);
                let stream = write(&[(Transform::Plain, planes)]);
                assert_eq!(read_back(&stream, count, symbol_bytes, 1 << 20).unwrap(), symbols);
            }
        }
    }

    #[test]
    fn a_stream_that_expands_without_end_is_cut_off() {
        let bomb = zstd::bulk::compress(&vec![0; 1 << 28], 1).unwrap();
        let stream = [&[Method::Zstd as u8][..], &(bomb.len() as u32).to_le_bytes(), &bomb].concat();
        assert_eq!(unzstd(&bomb, 10).unwrap().len(), 11);
        let error = read_back(&stream, 10, 1, 1 << 20).unwrap_err().to_string();
        assert!(error.ends_with("another number of symbols than the counts say"), "{error}");
        let error = read_back(&stream, 1 << 28, 1, 1 << 20).unwrap_err().to_string();
        assert_eq!(error, "codes needs 268435456 bytes, limit is 1048576");
    }

    #[test]
    fn wrong_heads_and_trailing_bytes_are_refused() {
        let planes = || Planes::new((0..100).map(|i| i % 3), 100, 1);
        let stream = write(&[(Transform::Plain, planes())]);
        let problem = |stream: &[u8], count| read_back(stream, count, 1, 1 << 20).unwrap_err().to_string();
        assert!(problem(&stream, 99).contains("another number of symbols"));
        assert!(problem(&stream, 101).contains("another number of symbols"));
        let changed = |at: usize, value: u8| {
            let mut stream = stream.clone();
            stream[at] = value;
            stream
        };
        assert!(problem(&changed(0, 2), 100).contains("unknown method"));
        assert!(problem(&changed(0, 0x11), 100).contains("unknown transform"));
        assert!(problem(&changed(4, 1), 100).contains("past the end"));
        let mut longer = stream.clone();
        longer[1] += 1;
        longer.push(0);
        assert!(problem(&longer, 100).contains("damaged zstd data"));
    }
}
