//! Decodes a file of the model `keyframe-delta` to the Gaussians of each timestep.
//!
//! The crate's own decoder keeps the state of every chunk twice, in numbers of 64 bits. This decoder keeps a state only
//! as long as a later chunk refers to it.

use std::collections::BTreeMap;

use ::fourdgs::keyframe_delta::State;
use ::fourdgs::keyframe_delta_file::{
    DecodedSequence, check_keyframe_mu_t, check_streamed_population, compose_delta_chunk, decode_keyframe_chunk,
    reconstruct_at,
};
use ::fourdgs::quantization::{dequantize_rotation, rct_inverse};
use ::fourdgs::records::parse_delta_chunk_records;
use ::fourdgs::serialization::Records;
use ::fourdgs::{Error, Header, MAGIC, Quantization, Result, WindowTable, opcode};
use tcgs_core::{Gaussians, Layout};

use super::read::{Row, gaussians_of};

/// A scene in memory.
#[derive(Debug)]
pub struct States {
    pub header: Header,
    /// Beginning of each timestep, seconds.
    pub times: Vec<f64>,
    /// In the axes of the file.
    pub timesteps: Vec<Gaussians>,
}

/// The last chunk that refers to each chunk, by their places in the file.
///
/// # Errors
/// If a record is damaged.
pub fn last_uses(file: &[u8]) -> Result<BTreeMap<u64, u64>> {
    let mut uses = BTreeMap::new();
    for record in Records::new(file, MAGIC.len()) {
        let record = record?;
        if record.opcode == opcode::DELTA_CHUNK {
            uses.insert(parse_delta_chunk_records(record.content)?.0.reference_offset, record.offset as u64);
        }
    }
    Ok(uses)
}

/// Decodes a file.
///
/// # Errors
/// If a record is damaged or missing, or refers to a missing one.
pub fn decode(file: &[u8]) -> Result<States> {
    let last_uses = last_uses(file)?;
    let mut header = None;
    let mut quantization = None;
    let mut windows = Vec::new();
    let mut states: BTreeMap<u64, State> = BTreeMap::new();
    let (mut times, mut timesteps) = (Vec::new(), Vec::new());
    // Reconstruction reads the header, the steps and the windows of a sequence.
    let mut sequence = None;
    for record in Records::new(file, MAGIC.len()) {
        let record = record?;
        let place = record.offset as u64;
        let (state, from, until) = match record.opcode {
            // Records behind a state are not read, as in the crate.
            opcode::HEADER if times.is_empty() => {
                header = Some(Header::parse(record.content)?);
                continue;
            }
            opcode::QUANTIZATION if times.is_empty() => {
                quantization = Some(Quantization::parse(record.content)?);
                continue;
            }
            opcode::WINDOW_TABLE if times.is_empty() => {
                windows = WindowTable::parse(record.content)?.windows;
                continue;
            }
            opcode::CHUNK => {
                let (state, head) = decode_keyframe_chunk(record.content, &windows)?;
                let steps = quantization.as_ref().ok_or_else(|| missing("Quantization record before a keyframe"))?;
                check_keyframe_mu_t(&state, head.t0, steps)?;
                (state, head.t0, head.t1)
            }
            opcode::DELTA_CHUNK => {
                let reference = parse_delta_chunk_records(record.content)?.0.reference_offset;
                let before = states.get(&reference).ok_or_else(|| missing("chunk that a delta chunk refers to"))?;
                let (state, head, _) = compose_delta_chunk(before, record.content, &windows)?;
                if last_uses.get(&reference) == Some(&place) {
                    states.remove(&reference);
                }
                (state, head.t0, head.t1)
            }
            _ => continue,
        };
        check_streamed_population(place, from, until, &state)?;
        if sequence.is_none() {
            let (Some(header), Some(quantization)) = (header.clone(), quantization.clone()) else {
                return Err(missing("Header or Quantization record"));
            };
            sequence = Some(DecodedSequence { header, quantization, windows: windows.clone(), chunks: vec![] });
        }
        if let Some(sequence) = &sequence {
            times.push(from);
            timesteps.push(gaussians_of(
                &rows(sequence, &state, from),
                &Layout::base(),
                sequence.quantization.step_alpha,
            ));
        }
        if last_uses.contains_key(&place) {
            states.insert(place, state);
        }
    }
    let header = header.ok_or_else(|| missing("Header record"))?;
    Ok(States { header, times, timesteps })
}

fn missing(what: &str) -> Error {
    Error::Malformed(format!("there is no {what}"))
}

/// The Gaussians of a state that live at a time.
fn rows(sequence: &DecodedSequence, state: &State, time: f64) -> Vec<Row> {
    let found = reconstruct_at(sequence, state, time);
    let steps = &sequence.quantization;
    let index_of: BTreeMap<i64, usize> = state.ids.iter().enumerate().map(|(i, id)| (*id, i)).collect();
    let bins =
        |attribute: u8, index: usize, count: usize| &state.bins[&attribute].values[count * index..count * (index + 1)];
    let row = |(i, id): (usize, &i64)| {
        let index = index_of[id];
        let rotation = bins(opcode::A_ROTATION, index, 3);
        Row {
            index,
            mean: std::array::from_fn(|c| found.centers[3 * i + c] as f32),
            rotation: dequantize_rotation(bins(opcode::A_ROTATION_INDEX, index, 1)[0], rotation, steps.step_rot),
            scale: std::array::from_fn(|c| found.scales[3 * i + c] as f32),
            color: rct_inverse(bins(opcode::A_COLOR, index, 3)).map(|bin| (bin as f64 * steps.step_rgb) as f32),
            opacity: found.opacity[i],
        }
    };
    found.ids.iter().enumerate().map(row).collect()
}
