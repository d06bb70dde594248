//! The tables of a track: places, presentation times and key frames.
//!
//! ISO/IEC 14496-12, 8.6 and 8.7. Tables of runs are never longer than their box. Runs are unrolled only up to the
//! number of frames.

use std::iter::repeat_n;

use super::boxes::Body;
use super::{MAX_FRAMES, Sample, too_many};

/// The frames of a track in decoding order, and their total duration in units of the track's clock. A fragmented file
/// has no frames here.
///
/// - `table`: the box `stbl`
pub(super) fn samples(table: Body<'_>) -> Result<(Vec<Sample>, u64), String> {
    let sizes = Sizes::read(table.need(b"stsz")?)?;
    let count = sizes.count;
    if count == 0 {
        return Ok((Vec::new(), 0));
    }
    if count > MAX_FRAMES {
        return Err(too_many(count));
    }
    let mut samples = places(table, &sizes)?;
    let mut durations = table.need(b"stts")?;
    durations.version()?;
    let durations = durations.entries::<8>()?;
    let mut begin = 0;
    let mut num_timed = 0;
    for (sample, duration) in samples.iter_mut().zip(runs(durations)) {
        sample.composed = begin;
        begin += i64::from(duration);
        num_timed += 1;
    }
    if num_timed < count {
        return Err(format!("its table stts has the times of {num_timed} of {count} frames"));
    }
    if let Some(mut offsets) = table.find(b"ctts")? {
        offsets.version()?;
        let offsets = offsets.entries::<8>()?;
        let mut num_shifted = 0;
        // Version 0 has unsigned numbers, but some programs write negative ones.
        for (sample, offset) in samples.iter_mut().zip(runs(offsets)) {
            sample.composed += i64::from(offset.cast_signed());
            num_shifted += 1;
        }
        if num_shifted < count {
            return Err(format!("its table ctts has the times of {num_shifted} of {count} frames"));
        }
    }
    if let Some(mut begins) = table.find(b"stss")? {
        begins.version()?;
        samples.iter_mut().for_each(|sample| sample.begins = false);
        for &number in begins.entries::<4>()? {
            let place = (u32::from_be_bytes(number) as usize).checked_sub(1);
            if let Some(sample) = place.and_then(|place| samples.get_mut(place)) {
                sample.begins = true;
            }
        }
    }
    Ok((samples, begin.cast_unsigned()))
}

/// Size of each frame, bytes.
struct Sizes<'a> {
    count: usize,
    /// Size of every frame; 0: each has its own size in `listed`.
    all: u32,
    listed: &'a [[u8; 4]],
}

impl<'a> Sizes<'a> {
    fn read(mut table: Body<'a>) -> Result<Self, String> {
        table.version()?;
        let all = table.u32()?;
        if all > 0 {
            return Ok(Self { count: table.u32()? as usize, all, listed: &[] });
        }
        let listed = table.entries()?;
        Ok(Self { count: listed.len(), all, listed })
    }

    fn of(&self, frame: usize) -> u64 {
        self.listed.get(frame).map_or(self.all, |&size| u32::from_be_bytes(size)).into()
    }
}

/// The values of a table of runs, each `count, value`.
fn runs(table: &[[u8; 8]]) -> impl Iterator<Item = u32> {
    table.iter().flat_map(|&[a, b, c, d, value @ ..]| {
        repeat_n(u32::from_be_bytes(value), u32::from_be_bytes([a, b, c, d]) as usize)
    })
}

/// Places of the frames: one after another in chunks, whose places are listed.
fn places(table: Body<'_>, sizes: &Sizes<'_>) -> Result<Vec<Sample>, String> {
    let mut runs = table.need(b"stsc")?;
    runs.version()?;
    let runs = runs.entries::<12>()?;
    let number = |run: &[u8; 12], at: usize| u32::from_be_bytes([run[at], run[at + 1], run[at + 2], run[at + 3]]);
    let (first_chunk, per_chunk) = (|run| number(run, 0), |run| number(run, 4));
    let is_in_order = runs.is_sorted_by(|a, b| first_chunk(a) < first_chunk(b));
    if runs.first().map(first_chunk) != Some(1) || !is_in_order || runs.iter().any(|run| per_chunk(run) == 0) {
        return Err("its table stsc has no chunks, empty ones, or others than 1, 2, 3 … in this order".into());
    }
    let chunks = chunks(table)?;
    let mut samples = Vec::with_capacity(sizes.count);
    let mut run = 0;
    for (number, mut at) in (1..).zip(chunks) {
        while runs.get(run + 1).is_some_and(|next| first_chunk(next) <= number) {
            run += 1;
        }
        for _ in 0..per_chunk(&runs[run]) {
            if samples.len() == sizes.count {
                return Ok(samples);
            }
            let end = at.saturating_add(sizes.of(samples.len()));
            samples.push(Sample { bytes: at..end, composed: 0, begins: true });
            at = end;
        }
    }
    match samples.len() == sizes.count {
        true => Ok(samples),
        false => Err(format!("its chunks hold {} of {} frames", samples.len(), sizes.count)),
    }
}

/// Starts of the chunks, bytes from the start of the file.
fn chunks(table: Body<'_>) -> Result<Vec<u64>, String> {
    if let Some(mut places) = table.find(b"stco")? {
        places.version()?;
        return Ok(places.entries()?.iter().map(|&place| u32::from_be_bytes(place).into()).collect());
    }
    let mut places = table.need(b"co64")?;
    places.version()?;
    Ok(places.entries()?.iter().map(|&place| u64::from_be_bytes(place)).collect())
}
