//! Decoding of a whole file at once, into one [`CompactScene`].

use tcgs_core::{Attribute, Layout};

use super::archive::{Archive, Opening};
use super::neighbors::NONE;
use super::section::Cursor;
use super::segment::Segment;
use crate::compact::{CompactScene, Tracks};
use crate::error::{DecodeError, ENDS_EARLY};
use crate::limits::DecodeLimits;
use crate::parallel;

/// Decodes a whole `.tcgs` file: the inverse of [`encode`](crate::encode()).
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
/// - [`DecodeError::Format`] if the file is truncated, damaged, followed by other bytes, or breaks a rule of the format
/// - [`DecodeError::Version`] if the file is of another version
/// - [`DecodeError::Limit`] if decoding exceeds `limits`
pub fn decode(file: &[u8], limits: &DecodeLimits) -> Result<CompactScene, DecodeError> {
    let mut archive = open_whole(file, limits)?;
    let bytes = |range: std::ops::Range<u64>| &file[range.start as usize..range.end as usize];
    archive.check_optional(0, file)?;
    let layers = archive.num_layers();
    archive.read_shared(bytes(archive.shared_range(layers)))?;
    let segments = parallel::map((0..archive.num_segments()).collect(), |segment| {
        archive.read_segment(segment, bytes(archive.segment_range(segment, layers)))
    });
    let segments = segments.into_iter().collect::<Result<Vec<Segment>, _>>()?;
    join(&archive, &segments)
}

/// Opens a file of which all bytes are given; refuses a file that is truncated or followed by other bytes.
pub(super) fn open_whole(file: &[u8], limits: &DecodeLimits) -> Result<Archive, DecodeError> {
    let invalid = |problem| end_of_file(file.len() as u64, problem);
    match Archive::open(file, limits)? {
        Opening::Ready(archive) if archive.file_bytes() == file.len() as u64 => Ok(*archive),
        Opening::Ready(archive) if archive.file_bytes() < file.len() as u64 => Err(invalid("bytes are left over")),
        _ => Err(invalid(ENDS_EARLY)),
    }
}

/// Error at the end of a file.
pub(crate) fn end_of_file(length: u64, problem: &'static str) -> DecodeError {
    Cursor::new("file", length, &[]).invalid("end", problem)
}

/// Joins all segments of a file into one scene, and checks the rules of the format.
pub(super) fn join(archive: &Archive, segments: &[Segment]) -> Result<CompactScene, DecodeError> {
    let (head, shared) = (archive.head(), archive.shared());
    let attributes = parallel::map(Attribute::BASE.to_vec(), |a| join_tracks(archive, segments, a));
    let tracks = attributes.into_iter().collect::<Result<Vec<_>, _>>()?;
    let scene = CompactScene {
        info: head.info.clone(),
        bit_map: shared.bit_map.clone(),
        quantizers: head.plan.quantizers.clone(),
        varies: head.plan.varies.to_vec(),
        layers: head.layers.clone(),
        segment_length: head.segment_length,
        tracks,
        layout: Layout::base(),
    };
    scene.check().map(|()| scene).map_err(|violation| {
        Cursor::new(violation.attribute.map_or("info", Attribute::name), 0, &[])
            .invalid(violation.field, violation.problem)
    })
}

/// Joins the keypoints of an attribute over all segments; a keypoint that two segments share must be the same in both.
fn join_tracks(archive: &Archive, segments: &[Segment], attribute: Attribute) -> Result<Tracks<i16>, DecodeError> {
    let (a, components) = (attribute.index(), attribute.components());
    let (plan, shared) = (&archive.head().plan, archive.shared());
    let channels = plan.channels(attribute);
    let first_codes = &shared.first_codes[a];
    let num_keypoints: usize = segments.iter().map(|s| s.tracks(attribute).num_keypoints() * channels).sum();
    let budget = archive.budget();
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
            // What straddles an end is in both segments.
            let known = times.partition_point(|t| *t < more_times[0]);
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
        for channel in 0..channels {
            of_channel.clear();
            of_channel.extend(codes.iter().skip(channel).step_by(channels));
            tracks.push(&times, &of_channel);
        }
    }
    debug_assert_eq!(tracks.len(), archive.head().info.num_gaussians as usize * components);
    Ok(tracks)
}
