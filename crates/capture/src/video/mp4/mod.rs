//! The video track of an MP4 file (ISO/IEC 14496-12): its coding, and the places and presentation times of its frames.
//!
//! What lives here: [`read`], which trusts no number of a file. It refuses boxes that do not nest, tables of another
//! length than their boxes, and frames outside the file. `boxes` reads numbers, `tables` and `fragments` list frames.
//! What does not: decoding.
//!
//! Published readers of MP4 loop for ever at a box of size 0, or panic at tables that contradict each other.

mod boxes;
mod fragments;
mod tables;

use std::io::{self, BufReader, Read, Seek};
use std::ops::Range;

use self::boxes::{Body, HEAD_BYTES};
use self::fragments::Fragments;

/// Most frames of a video: 19 hours at 30 a second. A run of equal frames takes no bytes of a file.
const MAX_FRAMES: usize = 1 << 21;
/// Most bytes of the boxes that list frames: about twice the size for [`MAX_FRAMES`]. They are read whole.
const MAX_LIST_BYTES: u64 = 1 << 26;
/// Most boxes of a file.
const MAX_BOXES: usize = 1 << 22;

/// One coded frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sample {
    pub bytes: Range<u64>,
    /// Presentation time, in units of the track's clock, before edits.
    pub composed: i64,
    /// Whether it can be decoded without the frames before it.
    pub begins: bool,
}

/// The first video track of a file.
#[derive(Debug)]
pub(super) struct Track {
    /// Four letters that name the codec, such as `avc1`.
    pub codec: String,
    /// For `avc1` alone.
    pub avc: Option<Avc>,
    /// Units a second of the track's clock, and of the movie's.
    pub timescale: u32,
    pub movie_timescale: u32,
    /// In units of the track's clock; 0 if unknown.
    pub duration: u64,
    /// `a` and `b` of the players' transformation matrix.
    pub matrix: [i32; 2],
    pub edits: Vec<Edit>,
    /// In decoding order; for `avc1` alone.
    pub samples: Vec<Sample>,
}

/// A stretch of time in the presentation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Edit {
    /// In units of the movie's clock.
    pub duration: u64,
    /// Start in the track, in units of its clock; `None` shows nothing.
    pub begin: Option<u64>,
}

/// Storage of H.264. ISO/IEC 14496-15, 5.3.3.
#[derive(Debug)]
pub(super) struct Avc {
    pub width: u16,
    pub height: u16,
    /// Length in bytes of the size before each unit.
    pub length_bytes: usize,
    pub sequence_sets: Vec<Vec<u8>>,
    pub picture_sets: Vec<Vec<u8>>,
}

/// Why a file cannot be read.
#[derive(Debug)]
pub(super) enum Mp4Error {
    Io(io::Error),
    /// The file's content is invalid.
    Format(String),
}

impl From<io::Error> for Mp4Error {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::UnexpectedEof => Self::Format("ends inside the head of a box".into()),
            _ => Self::Io(error),
        }
    }
}

impl From<String> for Mp4Error {
    fn from(problem: String) -> Self {
        Self::Format(problem)
    }
}

/// Reads everything but the frames.
///
/// - `file`: at its start, `file_bytes` long
/// - returns: `None` if there is no video track. In a truncated file frames may end beyond the file
pub(super) fn read(mut file: BufReader<impl Read + Seek>, file_bytes: u64) -> Result<Option<Track>, Mp4Error> {
    let mut at = 0;
    let mut found: Option<(Option<Track>, Fragments)> = None;
    for _ in 0..MAX_BOXES {
        let Some((kind, range)) = next_box(&mut file, at, file_bytes)? else {
            let (track, fragments) = found.ok_or_else(|| "has no box moov".to_owned())?;
            return Ok(track.map(|mut track| {
                if track.duration == 0 {
                    track.duration = fragments.duration;
                }
                track
            }));
        };
        if [*b"moov", *b"moof"].contains(&kind) {
            let bytes = read_box(&mut file, kind, &range, file_bytes)?;
            let body = Body::new(kind, &bytes);
            match &mut found {
                None if kind == *b"moov" => found = Some(of_movie(body)?),
                None => return Err("has a box moof before its box moov".to_owned().into()),
                Some((Some(track), fragments)) if kind == *b"moof" && track.avc.is_some() => {
                    fragments.read(body, at, &mut track.samples)?;
                }
                Some(_) => {}
            }
        } else if range.end <= file_bytes {
            skip(&mut file, range.end - range.start)?;
        }
        at = range.end;
    }
    Err(format!("has more than {MAX_BOXES} boxes").into())
}

/// Kind of a box, and the place of its body in the file.
type BoxHead = ([u8; 4], Range<u64>);

/// The head of the box that begins at a byte; `None` at the end of the file.
fn next_box(file: &mut impl Read, at: u64, file_bytes: u64) -> Result<Option<BoxHead>, Mp4Error> {
    if at.saturating_add(HEAD_BYTES as u64) > file_bytes {
        return Ok(None);
    }
    let mut head = [0; HEAD_BYTES];
    file.read_exact(&mut head)?;
    let [a, b, c, d, kind @ ..] = head;
    let (mut size, mut head_bytes) = (u64::from(u32::from_be_bytes([a, b, c, d])), HEAD_BYTES as u64);
    if size == 1 {
        let mut long = [0; 8];
        file.read_exact(&mut long)?;
        (size, head_bytes) = (u64::from_be_bytes(long), 16);
    } else if size == 0 {
        size = file_bytes - at;
    }
    if size < head_bytes {
        let kind = kind.escape_ascii();
        return Err(format!("its box {kind} at byte {at} has the size {size}, expected {head_bytes} or more").into());
    }
    Ok(Some((kind, at + head_bytes..at.saturating_add(size))))
}

fn read_box(file: &mut impl Read, kind: [u8; 4], range: &Range<u64>, file_bytes: u64) -> Result<Vec<u8>, Mp4Error> {
    let (kind, size) = (kind.escape_ascii(), range.end - range.start);
    if range.end > file_bytes {
        return Err(format!("ends inside its box {kind}").into());
    }
    if size > MAX_LIST_BYTES {
        return Err(format!("its box {kind} has {size} bytes, expected at most {MAX_LIST_BYTES}").into());
    }
    let mut bytes = vec![0; size as usize];
    file.read_exact(&mut bytes)?;
    Ok(bytes)
}

/// Skips bytes without dropping the buffer.
fn skip(file: &mut BufReader<impl Read + Seek>, bytes: u64) -> io::Result<()> {
    file.seek_relative(bytes.try_into().map_err(|_| io::ErrorKind::InvalidInput)?)
}

fn too_many(found: usize) -> String {
    format!("has {found} frames, expected at most {MAX_FRAMES}")
}

/// The first video track of a movie, and the state for its fragments.
fn of_movie(movie: Body<'_>) -> Result<(Option<Track>, Fragments), String> {
    let mut head = movie.need(b"mvhd")?;
    let (version, _) = head.version()?;
    head.bytes(if version == 1 { 16 } else { 8 })?;
    let movie_timescale = head.u32()?;
    let mut first: Option<(u32, Body<'_>)> = None;
    for found in movie.boxes() {
        let found = found?;
        if found.kind == *b"trak" && is_video(found)? {
            let number = number_and_matrix(found)?.0;
            first = first.filter(|(least, _)| *least <= number).or(Some((number, found)));
        }
    }
    let fragments = Fragments::new(movie, first.map_or(0, |(number, _)| number))?;
    Ok((first.map(|(_, track)| of_track(track, movie_timescale)).transpose()?, fragments))
}

fn is_video(track: Body<'_>) -> Result<bool, String> {
    let mut handler = track.need(b"mdia")?.need(b"hdlr")?;
    handler.version()?;
    handler.u32()?;
    Ok(handler.bytes(4)? == b"vide")
}

/// A track's number, and `a` and `b` of its matrix.
fn number_and_matrix(track: Body<'_>) -> Result<(u32, [i32; 2]), String> {
    let mut head = track.need(b"tkhd")?;
    let (version, _) = head.version()?;
    let clock_bytes = if version == 1 { 8 } else { 4 };
    head.bytes(2 * clock_bytes)?;
    let number = head.u32()?;
    // A reserved field and the duration; two more reserved fields, layer, group, volume, reserved.
    head.bytes(4 + clock_bytes + 8 + 8)?;
    Ok((number, [head.u32()?.cast_signed(), head.u32()?.cast_signed()]))
}

fn of_track(track: Body<'_>, movie_timescale: u32) -> Result<Track, String> {
    let media = track.need(b"mdia")?;
    let mut head = media.need(b"mdhd")?;
    let (version, _) = head.version()?;
    head.bytes(if version == 1 { 16 } else { 8 })?;
    let (timescale, duration) = (head.u32()?, head.long(version)?);
    // All ones mean unknown.
    let is_known = duration != u64::MAX && (version == 1 || duration != u64::from(u32::MAX));
    let table = media.need(b"minf")?.need(b"stbl")?;
    let mut entries = table.need(b"stsd")?;
    entries.version()?;
    entries.u32()?;
    let entry = entries.boxes().next().ok_or_else(|| "its box stsd is empty".to_owned())??;
    let avc = if entry.kind == *b"avc1" { Some(Avc::read(entry)?) } else { None };
    // Another program reads videos of other codecs, with their tables.
    let (samples, sum) = if avc.is_some() { tables::samples(table)? } else { Default::default() };
    Ok(Track {
        codec: entry.kind.escape_ascii().to_string(),
        avc,
        timescale,
        movie_timescale,
        duration: if is_known && duration > 0 { duration } else { sum },
        matrix: number_and_matrix(track)?.1,
        edits: edits(track)?,
        samples,
    })
}

fn edits(track: Body<'_>) -> Result<Vec<Edit>, String> {
    let list = track.find(b"edts")?.map_or(Ok(None), |edits| edits.find(b"elst"))?;
    let Some(mut list) = list else { return Ok(Vec::new()) };
    let (version, _) = list.version()?;
    let mut edits = Vec::new();
    for _ in 0..list.u32()? {
        let (duration, begin) = (list.long(version)?, list.long(version)?);
        list.u32()?; // rate
        // An empty edit begins at -1, in 32 or 64 bits.
        let is_empty = begin == u64::MAX || version != 1 && begin == u64::from(u32::MAX);
        edits.push(Edit { duration, begin: Some(begin).filter(|_| !is_empty) });
    }
    Ok(edits)
}

impl Avc {
    /// The fields of an entry `avc1` come before its boxes.
    fn read(mut entry: Body<'_>) -> Result<Self, String> {
        entry.bytes(24)?;
        let (width, height) = (entry.u16()?, entry.u16()?);
        entry.bytes(50)?;
        let mut head = entry.need(b"avcC")?;
        head.bytes(4)?; // version, profile, compatibility, level
        let length_bytes = usize::from(head.u8()? & 3) + 1;
        let sets = |count: u8, head: &mut Body<'_>| {
            let set = |_| {
                let length = head.u16()?.into();
                head.bytes(length).map(<[u8]>::to_vec)
            };
            (0..count).map(set).collect::<Result<Vec<_>, String>>()
        };
        let count = head.u8()? & 31;
        let sequence_sets = sets(count, &mut head)?;
        let count = head.u8()?;
        let picture_sets = sets(count, &mut head)?;
        Ok(Self { width, height, length_bytes, sequence_sets, picture_sets })
    }
}
