//! The container of version 2: a header, sections that describe the whole scene, and the pieces of cohorts in the order
//! in which playback needs them.

use std::collections::BTreeMap;
use std::io::{Read, Seek, SeekFrom, Write};
use std::sync::Arc;

use super::super::archive::{Archive, Opening, Place};
use super::super::cohort::Cohort;
use super::super::head::{Head, Info, read_info_2, read_layers, write_info_2, write_layers};
use super::super::plan::{Plan, read_plan_2, write_plan_2};
use super::super::section::{COHORTS, Cursor, Entry, INFO, MAPS, SHARED, Tag};
use super::{MAGIC, agrees};
use crate::error::{CompressError, DecodeError, NEWER};
use crate::limits::DecodeLimits;

/// Magic, version, number of sections, length of the file, checksum.
pub(super) const FIXED_BYTES: usize = 20;
/// Tag, checksum, offset, length.
const ENTRY_BYTES: usize = 24;
/// An entry of `COHO`.
const PLACE_BYTES: usize = 36;
/// Offset of the header's checksum.
const CHECKSUM_AT: usize = 16;
/// Largest number of cohorts.
const MAX_COHORTS: usize = 1 << 20;
/// Flag of a cohort in which Gaussians have lives of their own.
const HAS_LIVES: u8 = 1;
/// Flag of a cohort: drawn with antialiasing, like all others of the file.
const IS_ANTIALIASED: u8 = 2;
/// Problem of a file in which only some cohorts are antialiased.
pub const MIXED: &str = "antialiased, unlike another cohort, or the other way round";

/// Length of the header; `None` if the bytes end before it.
///
/// - `cursor`: after the version
/// - `found`: number of bytes available
pub(super) fn length_of_header(mut cursor: Cursor<'_>, found: usize) -> Result<Option<usize>, DecodeError> {
    if found < FIXED_BYTES {
        return Ok(None);
    }
    Ok(Some(header_bytes(cursor.u16("number of sections")?.into())))
}

pub fn header_bytes(num_sections: usize) -> usize {
    FIXED_BYTES + num_sections * ENTRY_BYTES
}

/// CRC-32 of the header without its checksum field.
fn header_checksum(header: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&header[..CHECKSUM_AT]);
    hasher.update(&header[FIXED_BYTES..]);
    hasher.finalize()
}

/// Opens a file from its first bytes.
///
/// - `header`: its length is that of [`length_of_header`]
pub fn open(header: &[u8], start: &[u8], limits: &DecodeLimits) -> Result<Opening, DecodeError> {
    let mut cursor = Cursor::new("header", 0, header);
    cursor.take("header", 8)?;
    let length = cursor.u64("length of the file")?;
    let checksum = cursor.u32("checksum")?;
    if !agrees(checksum, header_checksum(header)) {
        return Err(cursor.invalid("checksum", "the header is damaged"));
    }
    let mut entries = Vec::new();
    let mut end = header.len() as u64;
    while entries.len() < (header.len() - FIXED_BYTES) / ENTRY_BYTES {
        let (tag, checksum) = (cursor.tag("tag")?, cursor.u32("checksum")?);
        let (offset, bytes) = (cursor.u64("offset")?, cursor.u64("length")?);
        if offset < end || offset.checked_add(bytes).is_none_or(|end| end > length) {
            return Err(cursor.invalid("offset", "not after the section before, or beyond the end of the file"));
        }
        end = offset + bytes;
        let entry = Entry { tag, segment: SHARED, layer: 0, range: offset..end, checksum };
        if ![INFO, COHORTS].contains(&tag) && !entry.is_optional() {
            return Err(cursor.invalid("tag", NEWER));
        }
        entries.push(entry);
    }
    let mut needed = entries.iter().filter(|e| !e.is_optional());
    let mut next = |tag: Tag| {
        let due = || Cursor::new("header", FIXED_BYTES as u64, &[]).invalid("tag", "not the section that is due");
        needed.next().filter(|e| e.tag == tag).ok_or_else(due)
    };
    let (info, cohorts) = (next(INFO)?, next(COHORTS)?);
    if needed.next().is_some() {
        return Err(Cursor::new("header", FIXED_BYTES as u64, &[]).invalid("tag", "a section too many"));
    }
    if cohorts.range.end > start.len() as u64 {
        return Ok(Opening::More(cohorts.range.end));
    }
    let bytes = |entry: &Entry| &start[entry.range.start as usize..entry.range.end as usize];
    let info = read_info_2(info.open(bytes(info))?, limits)?;
    let places = read_places(cohorts.open(bytes(cohorts))?, &info, cohorts.range.end, length)?;
    Ok(Opening::Ready(Box::new(Archive::of_many(length, entries, info, places, limits))))
}

/// Reads the section `COHO`.
///
/// - `start`: offset of the first piece
/// - `length`: of the file
fn read_places(mut cursor: Cursor<'_>, info: &Info, start: u64, length: u64) -> Result<Vec<Place>, DecodeError> {
    let num_cohorts = cursor.u32("number of cohorts")? as usize;
    if num_cohorts > MAX_COHORTS {
        return Err(cursor.invalid("number of cohorts", "more than 1048576"));
    }
    let mut places: Vec<Place> = Vec::new();
    let mut num_gaussians = 0_u64;
    for index in 0..num_cohorts {
        let place = Place {
            start: cursor.u32("start")?,
            num_timesteps: cursor.u32("num_timesteps")?,
            num_gaussians: cursor.u32("num_gaussians")?,
            plan: cursor.u32("plan")?,
            head_bytes: cursor.u32("bytes of the head")?,
            head_checksum: cursor.u32("checksum of the head")?,
            shared_bytes: cursor.u32("bytes of the shared layers")?,
            offset: cursor.u64("offset")?,
        };
        let before = places.last();
        if before.is_some_and(|before| before.start > place.start) {
            return Err(cursor.invalid("start", "not ascending"));
        }
        let end = u64::from(place.start) + u64::from(place.num_timesteps);
        if !(1..=1 << 16).contains(&place.num_timesteps) || end > u64::from(info.scene.num_timesteps) {
            return Err(cursor.invalid("num_timesteps", "not within 1 to 65536, or beyond the end of the scene"));
        }
        if place.num_gaussians == 0 {
            return Err(cursor.invalid("num_gaussians", "none"));
        }
        let plan = place.plan as usize;
        let has_plan = plan == index || plan < index && places[plan].plan as usize == plan;
        if !has_plan {
            return Err(cursor.invalid("plan", "that of a cohort without one of its own"));
        }
        let bytes = u64::from(place.head_bytes) + u64::from(place.shared_bytes);
        let earliest = before.map_or(start, |b| b.offset + u64::from(b.head_bytes) + u64::from(b.shared_bytes));
        if place.offset < earliest || place.offset.checked_add(bytes).is_none_or(|end| end > length) {
            return Err(cursor.invalid("offset", "not after the cohort before, or beyond the end of the file"));
        }
        num_gaussians += u64::from(place.num_gaussians);
        places.push(place);
    }
    if num_gaussians != u64::from(info.scene.num_gaussians) {
        return Err(cursor.invalid("num_gaussians", "not as many Gaussians as the scene"));
    }
    cursor.finish()?;
    Ok(places)
}

fn write_places(places: &[Place]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(4 + places.len() * PLACE_BYTES);
    bytes.extend((places.len() as u32).to_le_bytes());
    for place in places {
        let Place { start, num_timesteps, num_gaussians, plan, head_bytes, head_checksum, shared_bytes, .. } = *place;
        for field in [start, num_timesteps, num_gaussians, plan, head_bytes, head_checksum, shared_bytes] {
            bytes.extend(field.to_le_bytes());
        }
        bytes.extend(place.offset.to_le_bytes());
    }
    bytes
}

/// Reads the head of a cohort: its division, its plan, and the positions of its sections.
///
/// - `index`: of the cohort
/// - `shared`: the plan that it shares with another cohort; `None` if it has its own
/// - `bytes`: start at the head
/// - `length`: of the file
pub fn read_head(
    index: usize,
    place: &Place,
    info: Arc<Info>,
    shared: Option<Arc<Plan>>,
    bytes: &[u8],
    length: u64,
    limits: &DecodeLimits,
) -> Result<(Head, Vec<Entry>), DecodeError> {
    let at = |bytes| Cursor::new("cohort", place.offset, bytes);
    let bytes = bytes.get(..place.head_bytes as usize).ok_or_else(|| at(&[]).invalid("length", "ends early"))?;
    let mut cursor = at(bytes);
    if !agrees(place.head_checksum, crc32fast::hash(bytes)) {
        return Err(cursor.invalid("checksum", "the head of the cohort is damaged"));
    }
    if place.num_gaussians > limits.max_gaussians {
        let (needed, limit) = (place.num_gaussians.into(), limits.max_gaussians.into());
        return Err(DecodeError::Limit { what: "cohort", unit: "Gaussians", needed, limit });
    }
    let flags = cursor.u8("flags")?;
    if flags & !(HAS_LIVES | IS_ANTIALIASED) > 0 {
        return Err(cursor.invalid("flags", NEWER));
    }
    let is_antialiased = flags & IS_ANTIALIASED > 0;
    if shared.as_ref().is_some_and(|plan| plan.layout.is_antialiased() != is_antialiased) {
        return Err(cursor.invalid("flags", MIXED));
    }
    let segment_length = cursor.u32("segment_length")?;
    let layers = read_layers(&mut cursor)?;
    let plan = match shared {
        Some(plan) => plan,
        None => {
            let mut plan = read_plan_2(&mut cursor)?;
            plan.layout = plan.layout.antialiased(is_antialiased);
            Arc::new(plan)
        }
    };
    let head = Head {
        index,
        info,
        plan,
        start: place.start as usize,
        num_timesteps: place.num_timesteps as usize,
        num_gaussians: place.num_gaussians as usize,
        has_lives: flags & HAS_LIVES > 0,
        layers,
        segment_length,
    };
    head.check().map_err(|violation| cursor.invalid(violation.field, violation.problem))?;
    let num_layers = head.layers.len();
    // The rest of the head has eight bytes per section, and eight more per segment.
    let of_shared: Vec<Tag> = head.plan.listed().map(|listed| listed.tag()).collect();
    let varying: Vec<Tag> = head.plan.listed_varying().map(|listed| listed.tag()).collect();
    let has_segments = !varying.is_empty();
    let left = place.head_bytes as u64 - cursor.position();
    let needed = 8 * (Cohort::num_sections(&head) as u64 + u64::from(has_segments) * head.num_segments() as u64);
    if left != needed {
        return Err(cursor.invalid("sections", "not as many as layers, segments and attributes make"));
    }
    let mut sections = Vec::with_capacity(Cohort::num_sections(&head));
    let mut offset = place.offset + u64::from(place.head_bytes);
    let mut entry = |cursor: &mut Cursor<'_>, tag: Tag, segment: usize, layer: usize, offset: &mut u64| {
        let start = *offset;
        *offset = start.saturating_add(u64::from(cursor.u32("length")?));
        let checksum = cursor.u32("checksum")?;
        sections.push(Entry { tag, segment: segment as u16, layer: layer as u16, range: start..*offset, checksum });
        Ok::<(), DecodeError>(())
    };
    for layer in 0..num_layers {
        entry(&mut cursor, MAPS, SHARED.into(), layer, &mut offset)?;
        for &tag in &of_shared {
            entry(&mut cursor, tag, SHARED.into(), layer, &mut offset)?;
        }
    }
    if offset != place.offset + u64::from(place.head_bytes) + u64::from(place.shared_bytes) {
        return Err(cursor.invalid("length", "not as many bytes of shared layers as the table of cohorts says"));
    }
    for segment in 0..if has_segments { head.num_segments() } else { 0 } {
        let start = cursor.u64("offset of a segment")?;
        if start < offset {
            return Err(cursor.invalid("offset of a segment", "not after the one before"));
        }
        offset = start;
        for layer in 0..num_layers {
            for &tag in &varying {
                entry(&mut cursor, tag, segment, layer, &mut offset)?;
            }
        }
        if offset > length {
            return Err(cursor.invalid("offset of a segment", "beyond the end of the file"));
        }
    }
    cursor.finish()?;
    Ok((head, sections))
}

/// An encoded cohort without a position in the file.
pub struct Encoded {
    pub head: Head,
    /// The shared layers, section by section.
    pub shared: Vec<Vec<u8>>,
    /// Every segment, section by section; empty if nothing varies.
    pub segments: Vec<Vec<Vec<u8>>>,
}

/// Sort key of a piece in the file: the first timestep at which it is needed, the cohort, and the segment. `None` is
/// the head, which precedes the cohort's segments.
type PieceKey = (usize, usize, Option<usize>);

/// A cohort's head whose segments do not all have offsets yet.
struct OpenHead {
    bytes: Vec<u8>,
    /// Positions in `bytes` of the offset fields of the segments.
    offsets_at: Vec<usize>,
    segments_left: usize,
}

/// Writes a file cohort by cohort. Memory holds the encoded segments that start after the cohort added last.
pub struct Writer<'a, W> {
    file: &'a mut W,
    /// Position of the file's first byte.
    start: u64,
    /// Bytes written so far.
    position: u64,
    info: Info,
    /// Sections at the start of the file.
    entries: Vec<Entry>,
    num_cohorts: usize,
    places: Vec<Place>,
    heads: Vec<Option<OpenHead>>,
    plans: Vec<Arc<Plan>>,
    waiting: BTreeMap<PieceKey, Vec<u8>>,
}

impl<'a, W: Write + Seek> Writer<'a, W> {
    /// Reserves space for the header and the description of the scene, and writes further sections.
    ///
    /// - `info`: of the whole scene
    /// - `further`: tag and content of optional sections
    ///
    /// # Errors
    /// [`CompressError`] if there are too many cohorts or sections, or the file cannot be written.
    pub fn new(
        file: &'a mut W,
        info: Info,
        further: &[(Tag, Vec<u8>)],
        num_cohorts: usize,
    ) -> Result<Self, CompressError> {
        let count = |what: &str, found: usize, expected: usize| {
            let error = || CompressError::Count { what: what.into(), found, expected };
            if found > expected { Err(error()) } else { Ok(()) }
        };
        count("cohorts", num_cohorts, MAX_COHORTS)?;
        count("sections", further.len() + 2, u16::MAX.into())?;
        let start = file.stream_position()?;
        let mut position = header_bytes(2 + further.len()) as u64;
        let mut entries = Vec::new();
        let lengths = [(INFO, write_info_2(&info).len()), (COHORTS, 4 + num_cohorts * PLACE_BYTES)];
        for (tag, length) in lengths.into_iter().chain(further.iter().map(|(tag, bytes)| (*tag, bytes.len()))) {
            let range = position..position + length as u64;
            position = range.end;
            entries.push(Entry { tag, segment: SHARED, layer: 0, range, checksum: 0 });
        }
        let room = position - further.iter().map(|(_, bytes)| bytes.len() as u64).sum::<u64>();
        std::io::copy(&mut std::io::repeat(0).take(room), file)?;
        for ((_, bytes), entry) in further.iter().zip(&mut entries[2..]) {
            entry.checksum = crc32fast::hash(bytes);
            file.write_all(bytes)?;
        }
        Ok(Self {
            file,
            start,
            position,
            info,
            entries,
            num_cohorts,
            places: Vec::new(),
            heads: Vec::new(),
            plans: Vec::new(),
            waiting: BTreeMap::new(),
        })
    }

    /// Description of the whole scene.
    pub fn info(&self) -> &Info {
        &self.info
    }

    /// [`Self::info`] for changes before [`Self::finish`] writes it; its encoded length must stay the same.
    pub fn info_mut(&mut self) -> &mut Info {
        &mut self.info
    }

    /// Extends the bounding box of the scene to that of a cohort.
    pub fn extend_bounds(&mut self, [low, high]: [[f32; 3]; 2]) {
        let before = self.info.bounds;
        let is_first = self.places.is_empty();
        for i in 0..3 {
            self.info.bounds[0][i] = if is_first { low[i] } else { before[0][i].min(low[i]) };
            self.info.bounds[1][i] = if is_first { high[i] } else { before[1][i].max(high[i]) };
        }
    }

    /// The plans of the cohorts so far that have their own.
    pub fn plans(&self) -> impl Iterator<Item = &Arc<Plan>> {
        let own = self.places.iter().enumerate().filter(|(index, place)| place.plan as usize == *index);
        own.map(|(index, _)| &self.plans[index])
    }

    /// Adds a cohort. Cohorts come by ascending first timesteps.
    ///
    /// # Errors
    /// [`CompressError`] if a section is of 4 GiB or more, or the file cannot be written.
    ///
    /// # Panics
    /// If there are more cohorts than were announced to [`Self::new`], or one begins before the one added last.
    pub fn add(&mut self, cohort: Encoded) -> Result<(), CompressError> {
        let (head, index) = (cohort.head, self.places.len());
        assert!(index < self.num_cohorts, "cohort {index} of {}", self.num_cohorts);
        assert!(self.places.last().is_none_or(|last| last.start as usize <= head.start), "cohorts ascend");
        let has_own = |index: usize| self.places[index].plan as usize == index;
        let earlier = (0..index).find(|&earlier| has_own(earlier) && *self.plans[earlier] == *head.plan);
        let plan = earlier.unwrap_or(index);

        let is_antialiased = head.plan.layout.is_antialiased();
        if self.plans.first().is_some_and(|first| first.layout.is_antialiased() != is_antialiased) {
            return Err(CompressError::Scene { section: "cohort", field: "flags", problem: MIXED });
        }
        let flag = |is_set, flag: u8| if is_set { flag } else { 0 };
        let mut bytes = vec![flag(head.has_lives, HAS_LIVES) | flag(is_antialiased, IS_ANTIALIASED)];
        bytes.extend(head.segment_length.to_le_bytes());
        write_layers(&mut bytes, &head.layers);
        if plan == index {
            bytes.extend(write_plan_2(&head.plan));
        }
        let mut offsets_at = Vec::new();
        cohort.shared.iter().try_for_each(|section| write_entry(&mut bytes, section))?;
        for sections in &cohort.segments {
            offsets_at.push(bytes.len());
            bytes.extend([0; 8]);
            sections.iter().try_for_each(|section| write_entry(&mut bytes, section))?;
        }
        let shared = cohort.shared.concat();
        self.places.push(Place {
            start: head.start as u32,
            num_timesteps: head.num_timesteps as u32,
            num_gaussians: head.num_gaussians as u32,
            plan: plan as u32,
            head_bytes: length_of("head", bytes.len())?,
            shared_bytes: length_of("shared layers", shared.len())?,
            ..Place::default()
        });
        self.waiting.insert((head.start, index, None), [&bytes[..], &shared].concat());
        for (segment, sections) in cohort.segments.into_iter().enumerate() {
            let key = (head.start + head.span(segment).start, index, Some(segment));
            self.waiting.insert(key, sections.concat());
        }
        self.heads.push(Some(OpenHead { bytes, segments_left: offsets_at.len(), offsets_at }));
        self.plans.push(head.plan);
        // Later cohorts begin here or later.
        self.write_before(head.start)
    }

    /// Writes the pieces that are needed before a timestep.
    fn write_before(&mut self, timestep: usize) -> Result<(), CompressError> {
        let later = self.waiting.split_off(&(timestep, 0, None));
        for ((_, cohort, segment), bytes) in std::mem::replace(&mut self.waiting, later) {
            let head = self.heads[cohort].as_mut().expect("a head that waits for its segments");
            match segment {
                None => self.places[cohort].offset = self.position,
                Some(segment) => {
                    head.bytes[head.offsets_at[segment]..][..8].copy_from_slice(&self.position.to_le_bytes());
                    head.segments_left -= 1;
                }
            }
            self.file.write_all(&bytes)?;
            self.position += bytes.len() as u64;
            if head.segments_left == 0 {
                let place = &mut self.places[cohort];
                place.head_checksum = crc32fast::hash(&head.bytes);
                self.file.seek(SeekFrom::Start(self.start + place.offset))?;
                self.file.write_all(&head.bytes)?;
                self.file.seek(SeekFrom::Start(self.start + self.position))?;
                self.heads[cohort] = None;
            }
        }
        Ok(())
    }

    /// Writes the remaining pieces, and the start of the file; leaves the position at the end of the file.
    ///
    /// # Errors
    /// [`CompressError::Io`] if the file cannot be written.
    ///
    /// # Panics
    /// If there are fewer cohorts than were announced to [`Self::new`].
    pub fn finish(mut self) -> Result<(), CompressError> {
        assert_eq!(self.places.len(), self.num_cohorts, "cohorts");
        self.write_before(usize::MAX)?;
        let (info, cohorts) = (write_info_2(&self.info), write_places(&self.places));
        self.entries[0].checksum = crc32fast::hash(&info);
        self.entries[1].checksum = crc32fast::hash(&cohorts);
        let mut header = MAGIC.to_vec();
        header.extend(2_u16.to_le_bytes());
        header.extend((self.entries.len() as u16).to_le_bytes());
        header.extend(self.position.to_le_bytes());
        header.extend([0; 4]);
        for entry in &self.entries {
            header.extend(entry.tag);
            header.extend(entry.checksum.to_le_bytes());
            header.extend(entry.range.start.to_le_bytes());
            header.extend((entry.range.end - entry.range.start).to_le_bytes());
        }
        let checksum = header_checksum(&header);
        header[CHECKSUM_AT..FIXED_BYTES].copy_from_slice(&checksum.to_le_bytes());
        self.file.seek(SeekFrom::Start(self.start))?;
        self.file.write_all(&[header, info, cohorts].concat())?;
        self.file.seek(SeekFrom::Start(self.start + self.position))?;
        Ok(())
    }
}

fn length_of(what: &str, found: usize) -> Result<u32, CompressError> {
    let expected = u32::MAX as usize;
    u32::try_from(found).map_err(|_| CompressError::Count { what: format!("bytes of a {what}"), found, expected })
}

/// Appends length and checksum of a section to the head of a cohort.
fn write_entry(head: &mut Vec<u8>, section: &[u8]) -> Result<(), CompressError> {
    head.extend(length_of("section", section.len())?.to_le_bytes());
    head.extend(crc32fast::hash(section).to_le_bytes());
    Ok(())
}
