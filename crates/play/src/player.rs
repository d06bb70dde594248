//! From a source of bytes to the segment and timestep that are to be drawn.
//!
//! A state machine fetches in this order: the tables at the start of the file, what all segments share, the segment that
//! is due, and as prefetch the segments that are due next, as long as there is room. One request is under way at a time.
//! Nothing here blocks: [`Player::update`] does what can be done with the bytes that have arrived.

use std::ops::Range;
use std::sync::Arc;

use tcgs_codec::{Archive, Cohort, DecodeLimits, Eviction, MAGIC, Opening, Playback, Segment, SegmentCache};

use crate::clock::Clock;
use crate::error::PlayError;
use crate::source::{Piece, RangeSource, SourceError};

/// How much memory a player uses, and how it begins.
#[derive(Clone, Debug, PartialEq)]
pub struct PlayerSettings {
    /// Bound on the memory of decoded segments, bytes. The due segment is held even if it alone is larger.
    /// Default 256 MiB.
    pub max_segment_bytes: usize,
    /// What a file may ask for before it is refused. Default: 1 GiB of memory, which a browser's tab has, and otherwise
    /// [`DecodeLimits::default`].
    pub limits: DecodeLimits,
    /// Length of the first request, bytes. The default of 16 KiB holds the tables of most files and is less than their
    /// first segment.
    pub opening_bytes: u64,
}

impl Default for PlayerSettings {
    fn default() -> Self {
        Self {
            max_segment_bytes: SegmentCache::DEFAULT_BYTES,
            limits: DecodeLimits { max_bytes: 1 << 30, ..DecodeLimits::default() },
            opening_bytes: 1 << 14,
        }
    }
}

/// How often in a row a request is sent again after the connection broke.
const MAX_RETRIES: u32 = 4;
/// Milliseconds before the first repetition; each further one waits twice as long (exponential backoff).
const RETRY_MS: f64 = 250.0;

/// Data of applications that lie before the shared part are fetched together with it if they are no longer than this.
const MAX_APPLICATION_BYTES: u64 = 1 << 18;

/// A part of the file that is fetched as one range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum FilePart {
    /// The tables at the start of the file.
    Tables,
    /// What all segments share.
    Shared,
    /// The segment of this index.
    Segment(usize),
}

/// A request that is under way.
#[derive(Debug)]
struct Fetch {
    part: FilePart,
    /// Where the part lies in the file.
    range: Range<u64>,
    /// What has arrived of the range.
    bytes: Vec<u8>,
    /// When the source is asked again, if the connection broke.
    retry_at_ms: Option<f64>,
}

/// Plays a scene from a source: fetches, decodes and keeps time. It draws nothing.
#[derive(Debug)]
pub struct Player<S> {
    source: S,
    settings: PlayerSettings,
    /// The first bytes of the file.
    start: Vec<u8>,
    /// Whether the whole file is in `start`.
    start_is_all: bool,
    file: Option<OpenFile>,
    fetch: Option<Fetch>,
    num_retries: u32,
    first_timestep: usize,
    bytes_loaded: u64,
    failure: Option<PlayError>,
}

/// A file whose tables have arrived.
#[derive(Debug)]
struct OpenFile {
    archive: Archive,
    cohort: Cohort,
    cache: SegmentCache,
    clock: Clock,
    application_data: Vec<(String, Vec<u8>)>,
}

impl OpenFile {
    fn playback(&self) -> Playback {
        Playback {
            now: self.cohort.segment_at(self.clock.timestep()),
            is_backwards: self.clock.is_backwards(),
            is_looping: self.clock.is_looping(),
        }
    }

    /// Reads what all segments share, and the data of applications that came with it.
    ///
    /// - `range`: where `bytes` lie in the file; it ends where the shared part ends
    fn read_shared(&mut self, range: &Range<u64>, bytes: &[u8]) -> Result<(), PlayError> {
        let at = |position: u64| (position - range.start) as usize;
        let shared = self.cohort.shared_range(self.cohort.num_layers());
        for (index, data) in self.archive.application_ranges().into_iter().enumerate() {
            if range.start <= data.start && data.end <= shared.start {
                let read = self.archive.read_application(index, &bytes[at(data.start)..at(data.end)])?;
                self.application_data.extend(read.map(|(name, bytes)| (name, bytes.to_vec())));
            }
        }
        self.cohort.read_shared(&bytes[at(shared.start)..])?;
        Ok(())
    }

    fn current(&self) -> Option<(&Arc<Segment>, usize)> {
        let timestep = self.clock.timestep();
        self.cache.get(self.cohort.segment_at(timestep)).map(|segment| (segment, timestep))
    }
}

impl<S: RangeSource> Player<S> {
    /// A player that has asked for nothing yet.
    ///
    /// - `first_timestep`: the timestep that is shown first; the last one of the scene if it has fewer
    pub fn new(source: S, settings: PlayerSettings, first_timestep: usize) -> Self {
        Self {
            source,
            settings,
            start: Vec::new(),
            start_is_all: false,
            file: None,
            fetch: None,
            num_retries: 0,
            first_timestep,
            bytes_loaded: 0,
            failure: None,
        }
    }

    /// Tables of the file, once they have arrived.
    pub fn archive(&self) -> Option<&Archive> {
        self.file.as_ref().map(|file| &file.archive)
    }

    /// Names and bytes of the data that applications put between the tables and the shared part; empty before the shared
    /// part has arrived.
    pub fn application_data(&self) -> &[(String, Vec<u8>)] {
        self.file.as_ref().map_or(&[], |file| &file.application_data)
    }

    /// The clock, once the tables of the file have arrived.
    pub fn clock(&self) -> Option<&Clock> {
        self.file.as_ref().map(|file| &file.clock)
    }

    /// The clock, to be started, stopped and set, once the tables of the file have arrived.
    pub fn clock_mut(&mut self) -> Option<&mut Clock> {
        self.file.as_mut().map(|file| &mut file.clock)
    }

    /// What to draw: the due timestep and the segment that holds it, if that segment has arrived.
    pub fn current(&self) -> Option<(&Arc<Segment>, usize)> {
        self.file.as_ref().and_then(OpenFile::current)
    }

    /// Number of bytes that have arrived; bytes that arrived twice count twice.
    pub fn bytes_loaded(&self) -> u64 {
        self.bytes_loaded
    }

    /// Memory of the decoded segments, bytes.
    pub fn segment_bytes(&self) -> usize {
        self.file.as_ref().map_or(0, |file| file.cache.bytes())
    }

    /// Lets time pass, takes the bytes that have arrived, decodes, and requests what is needed next.
    ///
    /// One call decodes at most one segment, so that no picture waits for the decoding of segments that are due later.
    /// Time stands still while the due segment is missing.
    ///
    /// - `now_ms`: real time, milliseconds since an origin that never changes
    ///
    /// # Errors
    /// [`PlayError`] if the scene does not play. Every later call returns the same error.
    pub fn update(&mut self, now_ms: f64) -> Result<(), PlayError> {
        if let Some(failure) = &self.failure {
            return Err(failure.clone());
        }
        if let Some(file) = &mut self.file {
            if file.current().is_some() { file.clock.advance(now_ms) } else { file.clock.hold(now_ms) }
        }
        let result = self.work(now_ms);
        if let Err(error) = &result {
            self.failure = Some(error.clone());
        }
        result
    }

    fn work(&mut self, now_ms: f64) -> Result<(), PlayError> {
        loop {
            self.ask()?;
            let Some(fetch) = &mut self.fetch else { return Ok(()) };
            if let Some(at) = fetch.retry_at_ms {
                if now_ms < at {
                    return Ok(());
                }
                fetch.retry_at_ms = None;
                self.source.request(fetch.range.start + fetch.bytes.len() as u64..fetch.range.end);
            }
            let needed = (fetch.range.end - fetch.range.start) as usize;
            while fetch.bytes.len() < needed {
                match self.source.poll() {
                    Ok(Piece::Waiting) => return Ok(()),
                    Ok(Piece::Bytes(bytes)) => {
                        self.bytes_loaded += bytes.len() as u64;
                        self.num_retries = 0;
                        fetch.bytes.extend_from_slice(&bytes);
                    }
                    Ok(Piece::End) => break,
                    Err(error @ SourceError::Interrupted { .. }) if self.num_retries < MAX_RETRIES => {
                        fetch.retry_at_ms = Some(now_ms + RETRY_MS * f64::from(1 << self.num_retries));
                        self.num_retries += 1;
                        // A person who opens a file should hear of a broken connection at once.
                        if self.file.is_none() { return Err(error.into()) } else { return Ok(()) }
                    }
                    Err(error) => return Err(error.into()),
                }
            }
            let Some(mut fetch) = self.fetch.take() else { return Ok(()) };
            let is_short = fetch.bytes.len() < needed;
            fetch.bytes.truncate(needed);
            if is_short && fetch.part != FilePart::Tables {
                let found = fetch.range.start + fetch.bytes.len() as u64;
                let expected = self.archive().map_or(fetch.range.end, Archive::file_bytes);
                return Err(PlayError::Truncated { found: self.source.length().unwrap_or(found), expected });
            }
            match fetch.part {
                FilePart::Tables => self.read_tables(&fetch.bytes, is_short, now_ms)?,
                FilePart::Shared => {
                    if let Some(file) = &mut self.file {
                        file.read_shared(&fetch.range, &fetch.bytes)?;
                    }
                }
                FilePart::Segment(segment) => {
                    self.read_segment(segment, &fetch.bytes)?;
                    // The next segment is requested now and decoded in a later call.
                    return self.ask();
                }
            }
        }
    }

    fn read_tables(&mut self, bytes: &[u8], is_all: bool, now_ms: f64) -> Result<(), PlayError> {
        self.start.extend_from_slice(bytes);
        self.start_is_all = is_all;
        let Opening::Ready(mut archive) = self.open_archive()? else { return Ok(()) };
        if archive.version() > 1 {
            return Err(PlayError::NewerVersion { found: archive.version(), expected: 1 });
        }
        let (expected, found) = (archive.file_bytes(), self.source.length());
        if let Some(found) = found.filter(|&found| found < expected) {
            return Err(PlayError::Truncated { found, expected });
        }
        let info = archive.info();
        let mut clock = Clock::new(info.num_timesteps as usize, info.frame_rate.into());
        clock.seek(self.first_timestep);
        clock.hold(now_ms);
        let cohort = archive.open_cohort(0, &[])?;
        let cache = SegmentCache::new(cohort.num_segments(), self.settings.max_segment_bytes);
        self.file = Some(OpenFile { archive: *archive, cohort, cache, clock, application_data: Vec::new() });
        Ok(())
    }

    /// What the first bytes of the file say.
    fn open_archive(&self) -> Result<Opening, PlayError> {
        let known = self.start.len().min(MAGIC.len());
        if self.start[..known] != MAGIC[..known] {
            return Err(PlayError::NotTcgs);
        }
        Ok(Archive::open(&self.start, &self.settings.limits)?)
    }

    fn read_segment(&mut self, segment: usize, bytes: &[u8]) -> Result<(), PlayError> {
        let Some(file) = &mut self.file else { return Ok(()) };
        let eviction = Eviction::FarthestAhead(file.playback());
        file.cache.make_room(segment, eviction);
        let segment = file.cohort.read_segment(segment, bytes)?;
        file.cache.insert(Arc::new(segment), eviction);
        Ok(())
    }

    /// Makes sure that the part which is needed most is under way.
    fn ask(&mut self) -> Result<(), PlayError> {
        let Some((part, range)) = self.next_part()? else {
            // What is under way is not needed any more.
            return Ok(());
        };
        if let Some(fetch) = &self.fetch {
            // A prefetch goes on, unless the due segment is missing.
            let is_needed_now = self.file.as_ref().is_some_and(|file| part == FilePart::Segment(file.playback().now));
            if fetch.part == part || !is_needed_now {
                return Ok(());
            }
        }
        // The first request may have brought the beginning of the part, or all of it.
        let known = self.start.get(range.start as usize..).unwrap_or_default();
        let bytes = known[..known.len().min((range.end - range.start) as usize)].to_vec();
        let rest = range.start + bytes.len() as u64..range.end;
        if !rest.is_empty() {
            self.source.request(rest);
        }
        self.fetch = Some(Fetch { part, range, bytes, retry_at_ms: None });
        Ok(())
    }

    /// The part that is needed most, and where it lies in the file; none if there is nothing to fetch.
    fn next_part(&self) -> Result<Option<(FilePart, Range<u64>)>, PlayError> {
        let Some(OpenFile { archive, cohort, cache, .. }) = &self.file else {
            let known = self.start.len() as u64;
            let needed = match self.open_archive()? {
                Opening::More(needed) => needed,
                Opening::Ready(_) => known,
            };
            if self.start_is_all {
                return Err(PlayError::Truncated { found: known, expected: needed });
            }
            let end = if known == 0 { self.settings.opening_bytes.max(needed) } else { needed };
            return Ok(Some((FilePart::Tables, known..end)));
        };
        let layers = cohort.num_layers();
        if cohort.layers_read() < layers {
            let mut range = cohort.shared_range(layers);
            // The data of applications, which lie between the tables and the shared part, come along.
            let before = archive.application_ranges().into_iter().map(|data| data.start).min();
            if let Some(before) =
                before.filter(|before| (1..=MAX_APPLICATION_BYTES).contains(&(range.start.saturating_sub(*before))))
            {
                range.start = before;
            }
            return Ok(Some((FilePart::Shared, range)));
        }
        let playback = self.file.as_ref().map(OpenFile::playback);
        let segment = playback.and_then(|playback| cache.prefetch(playback));
        Ok(segment.map(|segment| (FilePart::Segment(segment), cohort.segment_range(segment, layers))))
    }
}
