//! Bytes to symbols.
//!
//! Here only what is needed to go on is checked: that counts are within limits and that nothing reaches
//! past an end. Whether the result is a scene, `CompactScene::check` decides.

use tcgs_core::Attribute;

use super::container::{self, Part};
use super::residual::{Neighbor, Transform};
use super::section::{self, Cursor};
use super::{FIRST_CODES, LATER_CODES, along_curve, bytes_of_bits, bytes_of_time, groups_by_width, stream};
use crate::bits::BitMap;
use crate::compact::{CompactScene, SceneInfo, Tracks};
use crate::error::DecodeError;
use crate::limits::{Budget, DecodeLimits};
use crate::morton;
use crate::quantize::{MAX_BITS, Quantizer, Quantizers};

const PLAIN: [Transform; 1] = [Transform::Plain];

/// The scene in a `.tcgs` file.
///
/// - `file`: all of it
///
/// # Errors
/// [`DecodeError`] if the file is truncated, damaged, followed by other bytes, of another version, breaks
/// a rule of the format, or asks for more than `limits` allow.
pub fn decode(file: &[u8], limits: &DecodeLimits) -> Result<CompactScene, DecodeError> {
    let parts = container::read(file)?;
    for part in &parts {
        if !part.checksum_ok {
            return Err(part.cursor().invalid("checksum", "the section is damaged"));
        }
    }
    read_scene(&parts, limits)
}

/// The scene in sections whose checksums were seen to.
pub(super) fn read_scene(parts: &[Part<'_>], limits: &DecodeLimits) -> Result<CompactScene, DecodeError> {
    let mut budget = Budget::new(limits);
    let cursor = |section: section::Section| {
        // The container holds every section.
        parts.iter().find(|p| p.section == section).map_or_else(|| Cursor::new(section.name, 0, &[]), Part::cursor)
    };
    let (info, varies) = read_info(cursor(section::INFO), limits)?;
    let bit_map = read_bit_map(cursor(section::BITS), &mut budget, &info)?;
    let quantizers = read_quantizers(cursor(section::QNTZ))?;
    let mut tracks: [Tracks<i16>; 5] = Default::default();
    for attribute in Attribute::ALL {
        let widths = &bit_map.widths[attribute.index()];
        let cursor = cursor(section::of_attribute(attribute));
        let num_timesteps = varies[attribute.index()].then_some(info.num_timesteps as usize);
        tracks[attribute.index()] = read_tracks(cursor, &mut budget, attribute, widths, num_timesteps)?;
    }
    let scene = CompactScene { info, bit_map, quantizers, varies, tracks };
    match scene.check() {
        Ok(()) => Ok(scene),
        Err(violation) => {
            let section = violation.attribute.map_or(section::INFO, section::of_attribute);
            Err(cursor(section).invalid(violation.field, violation.problem))
        }
    }
}

/// Counts and provenance, and which attributes vary.
fn read_info(mut cursor: Cursor<'_>, limits: &DecodeLimits) -> Result<(SceneInfo, [bool; 5]), DecodeError> {
    let num_gaussians = cursor.u32("num_gaussians")?;
    let num_timesteps = cursor.u32("num_timesteps")?;
    let counts =
        [("Gaussians", num_gaussians, limits.max_gaussians), ("timesteps", num_timesteps, limits.max_timesteps)];
    for (unit, needed, limit) in counts {
        if needed > limit {
            return Err(DecodeError::Limit { what: "scene", unit, needed: needed.into(), limit: limit.into() });
        }
    }
    let first_frame = cursor.u32("first_frame")?;
    let downscale = cursor.u32("downscale")?;
    let frame_rate = cursor.f32("frame_rate")?;
    let length = cursor.u16("name")?;
    let name = std::str::from_utf8(cursor.take("name", length.into())?);
    let name = name.map_err(|_| cursor.invalid("name", "not UTF-8"))?.to_owned();
    let varies = cursor.u8("varying attributes")?;
    if varies >> Attribute::ALL.len() > 0 {
        return Err(cursor.invalid("varying attributes", "more attributes than there are"));
    }
    let info = SceneInfo { num_gaussians, num_timesteps, first_frame, frame_rate, downscale, name };
    info.check().map_err(|violation| cursor.invalid(violation.field, violation.problem))?;
    cursor.finish()?;
    Ok((info, Attribute::ALL.map(|attribute| varies >> attribute.index() & 1 > 0)))
}

fn read_bit_map(mut cursor: Cursor<'_>, budget: &mut Budget, info: &SceneInfo) -> Result<BitMap, DecodeError> {
    let mut bit_map = BitMap::default();
    for widths in &mut bit_map.widths {
        let n = budget.reserve("bit widths", info.num_gaussians.into(), 1)?;
        let uniform = cursor.u8("width")?;
        if uniform > 0 {
            *widths = vec![uniform; n];
        } else {
            let (_, symbols) = stream::read(&mut cursor, budget, "bit widths", &PLAIN, n, 1)?;
            *widths = (0..n).map(|i| symbols.get(i) as u8).collect();
        }
        if widths.iter().any(|w| !(1..=MAX_BITS).contains(w)) {
            return Err(cursor.invalid("bit widths", "not within 1 to 16"));
        }
    }
    cursor.finish()?;
    Ok(bit_map)
}

fn read_quantizers(mut cursor: Cursor<'_>) -> Result<Quantizers, DecodeError> {
    let mut quantizers = Quantizers::default();
    for attribute in Attribute::ALL {
        let by_width = &mut quantizers.attributes[attribute.index()];
        for _ in 0..cursor.u8("number of widths")? {
            let bits = cursor.u8("width")?;
            if by_width.last_key_value().is_some_and(|(&last, _)| last >= bits) {
                return Err(cursor.invalid("width", "not ascending"));
            }
            let mut channels = Vec::with_capacity(attribute.components());
            for _ in 0..attribute.components() {
                channels.push(Quantizer { step: cursor.f32("step")?, offset: cursor.f32("offset")?, bits });
            }
            by_width.insert(bits, channels);
        }
    }
    cursor.finish()?;
    Ok(quantizers)
}

/// Keypoints of one attribute.
///
/// - `widths`: `[N]`, each within 1 to 16
/// - `num_timesteps`: none if the attribute does not vary
fn read_tracks(
    mut cursor: Cursor<'_>,
    budget: &mut Budget,
    attribute: Attribute,
    widths: &[u8],
    num_timesteps: Option<usize>,
) -> Result<Tracks<i16>, DecodeError> {
    let components = attribute.components();
    let num_tracks = budget.reserve("tracks", (widths.len() * components) as u64 + 1, size_of::<usize>())? - 1;
    let (starts, times) = if let Some(num_timesteps) = num_timesteps {
        read_times(&mut cursor, budget, num_tracks, num_timesteps)?
    } else {
        budget.reserve("keypoint times", num_tracks as u64, size_of::<u16>())?;
        ((0..=num_tracks).collect(), vec![0; num_tracks])
    };
    budget.reserve("codes", times.len() as u64, size_of::<i16>())?;
    let mut tracks = Tracks::with_times(starts, times, 0_i16);

    budget.reserve("groups", widths.len() as u64, size_of::<usize>())?;
    for (width, gaussians) in groups_by_width(widths) {
        if along_curve(attribute) {
            read_curve_gaps(&mut cursor, budget, &gaussians, width, &mut tracks)?;
        }
        for channel in 0..components {
            let symbol_bytes = bytes_of_bits(width.into());
            if !along_curve(attribute) {
                let (transform, symbols) =
                    stream::read(&mut cursor, budget, "first codes", &FIRST_CODES, gaussians.len(), symbol_bytes)?;
                let mut before = 0;
                for (i, g) in gaussians.iter().enumerate() {
                    before = transform.code(symbol(&cursor, symbols.get(i), width)?, before.into(), width);
                    tracks.track_mut(g * components + channel).1[0] = before;
                }
            }
            if num_timesteps.is_some() {
                let count = gaussians.iter().map(|g| tracks.track(g * components + channel).0.len() - 1).sum();
                let (transform, symbols) =
                    stream::read(&mut cursor, budget, "later codes", &LATER_CODES, count, symbol_bytes)?;
                let mut neighbor = Neighbor::default();
                let mut next = 0;
                for g in &gaussians {
                    let (times, codes) = tracks.track_mut(g * components + channel);
                    for k in 1..codes.len() {
                        let symbol = symbol(&cursor, symbols.get(next), width)?;
                        let prediction = neighbor.predict(transform, codes[k - 1], times[k - 1], times[k]);
                        codes[k] = transform.code(symbol, prediction, width);
                        next += 1;
                    }
                    neighbor.replace(times, codes);
                }
            }
        }
    }
    cursor.finish()?;
    Ok(tracks)
}

/// Starts of tracks and times of all keypoints.
fn read_times(
    cursor: &mut Cursor<'_>,
    budget: &mut Budget,
    num_tracks: usize,
    num_timesteps: usize,
) -> Result<(Vec<usize>, Vec<u16>), DecodeError> {
    let symbol_bytes = bytes_of_time(num_timesteps);
    let (_, counts) = stream::read(cursor, budget, "keypoint counts", &PLAIN, num_tracks, symbol_bytes)?;
    let count = |track| counts.get(track) as usize + 1;
    if (0..num_tracks).any(|track| count(track) > num_timesteps) {
        return Err(cursor.invalid("keypoint counts", "exceeds the number of timesteps"));
    }
    let total: u64 = (0..num_tracks).map(|track| count(track) as u64).sum();
    let num_inner = (0..num_tracks).map(|track| count(track).saturating_sub(2)).sum();
    let (_, gaps) = stream::read(cursor, budget, "keypoint times", &PLAIN, num_inner, symbol_bytes)?;
    let mut times = Vec::with_capacity(budget.reserve("keypoint times", total, size_of::<u16>())?);
    let mut starts = Vec::with_capacity(num_tracks + 1);
    let mut next = 0;
    for track in 0..num_tracks {
        starts.push(times.len());
        let mut time = 0;
        times.push(0);
        for _ in 2..count(track) {
            time += gaps.get(next) as usize + 1;
            next += 1;
            if time >= num_timesteps {
                return Err(cursor.invalid("keypoint times", "past the last timestep"));
            }
            times.push(time as u16);
        }
        if count(track) > 1 {
            times.push((num_timesteps - 1) as u16);
        }
    }
    starts.push(times.len());
    Ok((starts, times))
}

fn read_curve_gaps(
    cursor: &mut Cursor<'_>,
    budget: &mut Budget,
    gaussians: &[usize],
    width: u8,
    tracks: &mut Tracks<i16>,
) -> Result<(), DecodeError> {
    let bits = 3 * u32::from(width);
    let (_, symbols) = stream::read(cursor, budget, "first codes", &PLAIN, gaussians.len(), bytes_of_bits(bits))?;
    let mut key = 0_u64;
    for (i, g) in gaussians.iter().enumerate() {
        let gap = symbols.get(i);
        if gap >> bits > 0 {
            return Err(cursor.invalid("first codes", "a gap longer than the curve"));
        }
        key = key.wrapping_add(gap) & ((1 << bits) - 1);
        for (channel, coordinate) in morton::deinterleave(key).into_iter().enumerate() {
            tracks.track_mut(3 * g + channel).1[0] = Transform::Plain.code(coordinate, 0, width);
        }
    }
    Ok(())
}

fn symbol(cursor: &Cursor<'_>, symbol: u64, width: u8) -> Result<u16, DecodeError> {
    if symbol >> width > 0 { Err(cursor.invalid("codes", "a code outside its width")) } else { Ok(symbol as u16) }
}
