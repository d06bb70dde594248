//! Decoding of a whole file at once.

use std::ops::Range;

use tcgs_core::Attribute;

use super::archive::{Archive, Opening};
use super::cohort::Cohort;
use super::neighbors::NONE;
use super::section::Cursor;
use super::segment::Segment;
use crate::compact::{CompactScene, SceneInfo, Tracks};
use crate::error::{DecodeError, ENDS_EARLY};
use crate::limits::DecodeLimits;
use crate::parallel;

/// Decodes a whole `.tcgs` file of one cohort: the inverse of [`encode`](crate::encode()).
///
/// - `file`: all bytes of the file
/// - `limits`: bounds on memory and counts
///
/// ```
/// use tcgs_codec::{BitMap, CompressSettings, DecodeLimits, SceneInfo, compress, decode, encode};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
/// let file = encode(&compact)?;
///
/// let decoded = decode(&file, &DecodeLimits::default())?;
/// assert_eq!(decoded.at(0).num_gaussians(), 3);
/// assert!(decode(&file[..file.len() - 1], &DecodeLimits::default()).is_err()); // truncated
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// - [`DecodeError::Format`] if the file is truncated, damaged, followed by other bytes, or breaks a rule of the
///   format; also unless it holds exactly one cohort: [`decode_cohorts`] decodes the others
/// - [`DecodeError::Version`] if the file is of another version
/// - [`DecodeError::Limit`] if decoding exceeds `limits`
pub fn decode(file: &[u8], limits: &DecodeLimits) -> Result<CompactScene, DecodeError> {
    let (_, mut cohorts) = decode_cohorts(file, limits)?;
    match cohorts.pop() {
        Some(cohort) if cohorts.is_empty() => Ok(cohort),
        _ => Err(Cursor::new("cohorts", 0, &[]).invalid("number of cohorts", "not one")),
    }
}

/// Decodes a whole `.tcgs` file of any number of cohorts: the inverse of [`encode_cohorts`](crate::encode_cohorts()).
///
/// - `file`: all bytes of the file
/// - `limits`: bounds on memory and counts
/// - returns: the description of the whole scene, and the cohorts by ascending [`CompactScene::start`]. The only cohort
///   of a file of version 1 is the whole scene
///
/// # Errors
/// As [`decode`].
pub fn decode_cohorts(file: &[u8], limits: &DecodeLimits) -> Result<(SceneInfo, Vec<CompactScene>), DecodeError> {
    let (archive, cohorts) = decode_archive(file, limits)?;
    Ok((archive.info().clone(), cohorts))
}

/// [`decode_cohorts`] with everything from the start of the file.
pub(crate) fn decode_archive(file: &[u8], limits: &DecodeLimits) -> Result<(Archive, Vec<CompactScene>), DecodeError> {
    let mut archive = open_whole(file, limits)?;
    archive.check_optional(0, file)?;
    let cohorts = open_cohorts(&mut archive, file)?;
    if archive.version() > 1 {
        check_cover(&archive, &cohorts, file.len() as u64)?;
    }
    let cohorts = parallel::map(cohorts, |mut cohort| decode_cohort(&mut cohort, file));
    Ok((archive, cohorts.into_iter().collect::<Result<_, _>>()?))
}

/// All cohorts of a file, without their layers.
pub(super) fn open_cohorts(archive: &mut Archive, file: &[u8]) -> Result<Vec<Cohort>, DecodeError> {
    let num_cohorts = archive.num_cohorts();
    let open = |cohort| {
        let head = archive.head_range(cohort);
        archive.open_cohort(cohort, file.get(head.start as usize..head.end as usize).unwrap_or(&[]))
    };
    let cohorts: Vec<Cohort> = (0..num_cohorts).map(open).collect::<Result<_, _>>()?;
    let is_other = |pair: &[Cohort]| !pair[0].has_attributes_of(&pair[1]);
    if let Some(at) = cohorts.windows(2).position(is_other) {
        return Err(other_attributes(archive.head_range(at + 1).start));
    }
    Ok(cohorts)
}

fn decode_cohort(cohort: &mut Cohort, file: &[u8]) -> Result<CompactScene, DecodeError> {
    let bytes = |range: Range<u64>| {
        let early = || end_of_file(file.len() as u64, ENDS_EARLY);
        file.get(range.start as usize..range.end as usize).ok_or_else(early)
    };
    let layers = cohort.num_layers();
    cohort.read_shared(bytes(cohort.shared_range(layers))?)?;
    let segments = parallel::map((0..cohort.num_segments()).collect(), |segment| {
        cohort.read_segment(segment, bytes(cohort.segment_range(segment, layers))?)
    });
    let segments = segments.into_iter().collect::<Result<Vec<Segment>, _>>()?;
    join(cohort, &segments)
}

/// Refuses a file of version 2 whose parts leave gaps, overlap, or are not in the order in which playback needs them.
fn check_cover(archive: &Archive, cohorts: &[Cohort], length: u64) -> Result<(), DecodeError> {
    let mut pieces: Vec<(usize, usize, usize, Range<u64>)> = Vec::new();
    for (index, cohort) in cohorts.iter().enumerate() {
        let shared = cohort.shared_range(cohort.num_layers());
        let start = archive.head_range(index).start..shared.end.max(archive.head_range(index).end);
        pieces.push((cohort.timesteps().start, index, 0, start));
        if cohort.has_segments() {
            for segment in 0..cohort.num_segments() {
                let range = cohort.segment_range(segment, cohort.num_layers());
                pieces.push((cohort.timesteps_of(segment).start, index, 1 + segment, range));
            }
        }
    }
    pieces.sort_by_key(|piece| (piece.0, piece.1, piece.2));
    let mut ranges: Vec<Range<u64>> = pieces.into_iter().map(|piece| piece.3).collect();
    if !ranges.is_sorted_by_key(|range| range.start) {
        return Err(end_of_file(0, "parts come in another order than that in which they are needed"));
    }
    ranges.extend(archive.entries().iter().map(|entry| entry.range.clone()));
    ranges.sort_by_key(|range| (range.start, range.end));
    let mut end = archive.header_bytes();
    for range in ranges {
        if range.start != end {
            return Err(end_of_file(end, "parts leave a gap or overlap"));
        }
        end = range.end;
    }
    if end == length { Ok(()) } else { Err(end_of_file(end, "bytes are left over")) }
}

/// Opens a file from all of its bytes; refuses a file that is truncated or followed by other bytes.
pub(super) fn open_whole(file: &[u8], limits: &DecodeLimits) -> Result<Archive, DecodeError> {
    let invalid = |problem| end_of_file(file.len() as u64, problem);
    match Archive::open(file, limits)? {
        Opening::Ready(archive) if archive.file_bytes() == file.len() as u64 => Ok(*archive),
        Opening::Ready(archive) if archive.file_bytes() < file.len() as u64 => Err(invalid("bytes are left over")),
        _ => Err(invalid(ENDS_EARLY)),
    }
}

/// Error of a cohort at `offset` with other attributes than the one before.
pub(crate) fn other_attributes(offset: u64) -> DecodeError {
    Cursor::new("cohort", offset, &[]).invalid("attributes", "others than those of the first cohort")
}

/// Error at the end of a file.
pub(crate) fn end_of_file(length: u64, problem: &'static str) -> DecodeError {
    Cursor::new("file", length, &[]).invalid("end", problem)
}

/// Joins all segments of a cohort, and checks the rules of the format.
fn join(cohort: &Cohort, segments: &[Segment]) -> Result<CompactScene, DecodeError> {
    let (head, shared) = (cohort.head(), cohort.shared());
    let attributes = head.plan.layout.attributes().collect();
    let tracks = parallel::map(attributes, |a| join_tracks(cohort, segments, a));
    let tracks = tracks.into_iter().collect::<Result<Vec<_>, _>>()?;
    let scene = CompactScene {
        info: SceneInfo {
            num_gaussians: head.num_gaussians as u32,
            num_timesteps: head.num_timesteps as u32,
            ..head.info.scene.clone()
        },
        start: head.start as u32,
        lives: shared.lives.clone(),
        bit_map: shared.bit_map.clone(),
        quantizers: head.plan.quantizers.clone(),
        varies: head.plan.varies.clone(),
        layers: head.layers.clone(),
        segment_length: head.segment_length,
        tracks,
        layout: head.plan.layout.clone(),
    };
    scene.check().map(|()| scene).map_err(|violation| {
        Cursor::new(violation.attribute.map_or("info", Attribute::name), 0, &[])
            .invalid(violation.field, violation.problem)
    })
}

/// Joins the keypoints of an attribute over all segments; a keypoint that two segments share must be the same in both.
fn join_tracks(cohort: &Cohort, segments: &[Segment], attribute: Attribute) -> Result<Tracks<i16>, DecodeError> {
    let (a, components) = (attribute.index(), attribute.components());
    let (plan, shared) = (&cohort.head().plan, cohort.shared());
    let channels = plan.channels(attribute);
    let first_codes = &shared.first_codes[a];
    let num_keypoints: usize = segments.iter().map(|s| s.tracks(attribute).num_keypoints() * channels).sum();
    let budget = cohort.budget();
    budget.reserve("tracks", first_codes.len() as u64 + 1, size_of::<usize>())?;
    budget.reserve("keypoints", (first_codes.len() + num_keypoints) as u64, size_of::<(u16, i16)>())?;

    let mut tracks = Tracks::default();
    let (mut times, mut codes, mut of_channel) = (Vec::new(), Vec::new(), Vec::new());
    for (place, group) in first_codes.chunks_exact(channels).enumerate() {
        let unit = if plan.varies[a] { shared.units[a][place] } else { NONE };
        if unit == NONE {
            group.iter().for_each(|&code| tracks.push(&[0], &[code]));
            continue;
        }
        times.clear();
        codes.clear();
        for segment in segments {
            let (more_times, more_codes) = segment.tracks(attribute).unit(unit as usize);
            // The Gaussian does not live in this segment.
            let Some(&first) = more_times.first() else { continue };
            // A keypoint interval across the border of two segments is stored in both.
            let known = times.partition_point(|t| *t < first);
            let shared = times.len() - known;
            let agree = shared <= more_times.len()
                && times[known..] == more_times[..shared]
                && codes[known * channels..] == more_codes[..shared * channels];
            if !agree {
                let cursor = Cursor::new(attribute.name(), 0, &[]);
                return Err(cursor.invalid("keypoints", "segments disagree on one that they share"));
            }
            times.extend_from_slice(&more_times[shared..]);
            codes.extend_from_slice(&more_codes[shared * channels..]);
        }
        // A moving track whose life is one timestep becomes a constant track, at timestep 0.
        if let [only] = &mut times[..] {
            *only = 0;
        }
        for channel in 0..channels {
            of_channel.clear();
            of_channel.extend(codes.iter().skip(channel).step_by(channels));
            tracks.push(&times, &of_channel);
        }
    }
    debug_assert_eq!(tracks.len(), cohort.num_gaussians() * components);
    Ok(tracks)
}
