//! Computes the memory that decoding a `.4dgs` file takes, from the headers of its records. Nothing is decoded.
//!
//! The crate `fourdgs` bounds each chunk by 512 MiB and decodes all chunks. A stream of few bytes may stand for any
//! number of Gaussians: a constant is written once, and a chunk of differences repeats the state that it refers to.

use std::collections::BTreeMap;

use ::fourdgs::chunk::chunk_stream_bytes;
use ::fourdgs::records::{ChunkHeader, parse_chunk, parse_delta_chunk_records};
use ::fourdgs::serialization::{Cursor, Records};
use ::fourdgs::{MAGIC, Result, opcode};

use super::states::last_uses;

/// Size of a decoded symbol in the crate, an `i64`.
const SYMBOL_BYTES: u64 = 8;
/// Size of a Gaussian of `gaussian-birth`: its columns in the chunk, and in the scene.
const GAUSSIAN_BYTES: u64 = 80 + 96;
/// Size of a Gaussian at a timestep of `keyframe-delta`, in stored form and while it is made.
const STORED_BYTES: u64 = 56;
const MAKING_BYTES: u64 = 256;
/// Rough size of a chunk, a stream or a state without its numbers.
const RECORD_BYTES: u64 = 1024;

/// Temporal models of these files.
#[derive(Clone, Copy, PartialEq)]
pub enum Model {
    /// `gaussian-birth`
    Births,
    /// `keyframe-delta`
    States,
}

/// Bytes that decoding a file holds at once, the file's own included.
///
/// - `most`: counting stops above this; the sum so far is returned
///
/// # Errors
/// If a record is damaged.
pub fn held_bytes(file: &[u8], model: Model, most: u64) -> Result<u64> {
    let last_uses = last_uses(file)?;
    let (stored, making) = match model {
        Model::Births => (GAUSSIAN_BYTES, 0),
        Model::States => (STORED_BYTES, MAKING_BYTES),
    };
    let mut kept = file.len() as u64;
    let mut largest = kept;
    let mut states: BTreeMap<u64, State> = BTreeMap::new();
    // Of these.
    let mut live = 0_u64;
    for record in Records::new(file, MAGIC.len()) {
        let record = record?;
        let place = record.offset as u64;
        // Dropped after the chunk.
        let mut streams = Streams::default();
        let mut state = State::default();
        let mut released = 0;
        match record.opcode {
            opcode::CHUNK => {
                let (head, packed) = parse_chunk(record.content)?;
                streams.add_chunk(&head, packed, most, Streams::add)?;
                state = State { count: head.count.into(), symbols: streams.symbols };
                kept = kept.saturating_add(stored.saturating_mul(state.count));
            }
            opcode::DELTA_CHUNK => {
                let (delta, packed) = parse_delta_chunk_records(record.content)?;
                let (compression, uncompressed_size) = (delta.compression, delta.uncompressed_size);
                let head = ChunkHeader { compression, uncompressed_size, ..ChunkHeader::default() };
                streams.add_chunk(&head, packed, most, |streams, groups| {
                    // Updates, births, deaths.
                    let mut groups = Cursor::new(groups);
                    (0..3).try_for_each(|_| streams.add(groups.blob()?))
                })?;
                let before = states.get(&delta.reference_offset).copied().unwrap_or_default();
                state = State {
                    count: before.count.saturating_add(delta.birth_count.into()),
                    symbols: before.symbols.max(streams.symbols),
                };
                kept = kept.saturating_add(stored.saturating_mul(state.count));
                if last_uses.get(&delta.reference_offset) == Some(&place) {
                    released = states.remove(&delta.reference_offset).map_or(0, |state| state.bytes());
                }
            }
            opcode::SH_BAND_STREAM => {
                // The band, then a stream.
                let stream = record.content.get(1..).map(Stream::read).transpose()?;
                kept = kept.saturating_add(stream.map_or(0, |(stream, _)| stream.bytes()));
            }
            _ => {}
        }
        kept = kept.saturating_add(RECORD_BYTES);
        let state_bytes = if model == Model::States { state.bytes() } else { 0 };
        let now = [live, streams.bytes, state_bytes, making.saturating_mul(state.count)];
        let now = now.into_iter().fold(kept, u64::saturating_add);
        largest = largest.max(now);
        if largest > most {
            break;
        }
        live = live.saturating_sub(released);
        if last_uses.contains_key(&place) {
            live = live.saturating_add(state.bytes());
            states.insert(place, state);
        }
    }
    Ok(largest)
}

/// A state of `keyframe-delta`, which is kept for the chunks that refer to it.
#[derive(Clone, Copy, Default)]
struct State {
    /// Gaussians, at most.
    count: u64,
    /// Of a Gaussian.
    symbols: u64,
}

impl State {
    fn bytes(&self) -> u64 {
        (self.symbols + 1).saturating_mul(SYMBOL_BYTES).saturating_mul(self.count)
    }
}

/// The streams of a chunk together.
#[derive(Default)]
struct Streams {
    /// Of a Gaussian.
    symbols: u64,
    bytes: u64,
}

impl Streams {
    /// Adds what a chunk holds, unpacked if the chunk is compressed as a whole.
    ///
    /// - `most`: more bytes than this are not unpacked
    /// - `add`: adds unpacked bytes
    fn add_chunk(
        &mut self,
        head: &ChunkHeader,
        packed: &[u8],
        most: u64,
        add: impl FnOnce(&mut Self, &[u8]) -> Result<()>,
    ) -> Result<()> {
        if !head.compression.is_empty() {
            self.bytes = self.bytes.saturating_add(head.uncompressed_size);
        }
        if self.bytes > most {
            return Ok(());
        }
        add(self, &chunk_stream_bytes(head, packed)?)
    }

    /// Adds streams that follow one another.
    fn add(&mut self, mut streams: &[u8]) -> Result<()> {
        while !streams.is_empty() {
            let (stream, rest) = Stream::read(streams)?;
            self.symbols += stream.channels;
            self.bytes = self.bytes.saturating_add(stream.bytes());
            streams = rest;
        }
        Ok(())
    }
}

/// The header of a stream: `attribute u8, width u8, mode u8, codec u8, channels u8, count u32, length u64`.
struct Stream {
    width: u64,
    channels: u64,
    count: u64,
}

impl Stream {
    /// A stream, and what lies behind it.
    fn read(bytes: &[u8]) -> Result<(Self, &[u8])> {
        let mut cursor = Cursor::new(bytes);
        let head = cursor.take(5)?;
        let (width, channels) = (head[1].into(), head[4].into());
        let count = cursor.u32()?.into();
        let length = cursor.u64()?;
        cursor.take(usize::try_from(length).unwrap_or(usize::MAX))?;
        Ok((Self { width, channels, count }, cursor.rest()))
    }

    /// As packed symbols and decoded.
    fn bytes(&self) -> u64 {
        let symbols = self.channels.saturating_mul(self.count);
        (self.width + SYMBOL_BYTES).saturating_mul(symbols).saturating_add(RECORD_BYTES)
    }
}
