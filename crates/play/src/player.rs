//! From a source to the segment and timestep that are to be drawn.
//!
//! The state machine: the start of the file, what all segments share, the segment that is needed now, those needed
//! next as long as there is room. One range is under way at a time. Nothing here blocks or waits: [`Player::update`]
//! does what can be done now.

use std::ops::Range;
use std::sync::Arc;

use tcgs_codec::{Archive, DecodeLimits, Eviction, Opening, Playback, Segment, SegmentCache};

use crate::clock::Clock;
use crate::error::PlayError;
use crate::source::{Piece, Source, SourceError};

/// How a player spends.
#[derive(Clone, Debug, PartialEq)]
pub struct PlayerSettings {
    /// Bytes of decoded segments; the one on show is held even if it is larger. Default 256 MiB.
    pub max_segment_bytes: usize,
    /// What a file may ask for. Default: a gibibyte, for the memory of a browser's tab.
    pub limits: DecodeLimits,
    /// Bytes of the first request; enough for the tables of most files, and less than their first segment.
    /// Default 16 KiB.
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
/// Milliseconds before the first of these; each next one waits twice as long.
const RETRY_MS: f64 = 250.0;

/// What applications put before the shared part is fetched with it if it is no longer than this.
const MAX_APPLICATION_BYTES: u64 = 1 << 18;

/// A part of the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part {
    /// Tables, up to so many bytes.
    Start,
    /// What all segments share.
    Shared,
    Segment(usize),
}

/// A request.
#[derive(Debug)]
struct Fetch {
    part: Part,
    /// Of the file; what `bytes` will hold.
    range: Range<u64>,
    bytes: Vec<u8>,
    /// When the source is asked again, if the connection broke.
    retry_at_ms: Option<f64>,
}

/// Plays a scene from a source.
#[derive(Debug)]
pub struct Player<S> {
    source: S,
    settings: PlayerSettings,
    /// The first bytes of the file.
    start: Vec<u8>,
    /// Whether the file ends with them.
    start_is_all: bool,
    opened: Option<Opened>,
    fetch: Option<Fetch>,
    num_retries: u32,
    /// Shown first.
    first_timestep: usize,
    bytes_loaded: u64,
    failure: Option<PlayError>,
}

/// What is there once the tables are known.
#[derive(Debug)]
struct Opened {
    archive: Archive,
    cache: SegmentCache,
    clock: Clock,
    application_data: Vec<(String, Vec<u8>)>,
}

impl Opened {
    fn playback(&self) -> Playback {
        Playback {
            now: self.archive.segment_at(self.clock.timestep()),
            is_backwards: self.clock.is_backwards(),
            is_looping: self.clock.is_looping(),
        }
    }

    /// - `range`: of `bytes` in the file; to the end of what all segments share
    fn read_shared(&mut self, range: &Range<u64>, bytes: &[u8]) -> Result<(), PlayError> {
        let at = |position: u64| (position - range.start) as usize;
        let shared = self.archive.shared_range(self.archive.num_layers());
        for (index, data) in self.archive.application_ranges().into_iter().enumerate() {
            if range.start <= data.start && data.end <= shared.start {
                let (name, bytes) = self.archive.read_application(index, &bytes[at(data.start)..at(data.end)])?;
                self.application_data.push((name, bytes.to_vec()));
            }
        }
        self.archive.read_shared(&bytes[at(shared.start)..])?;
        Ok(())
    }

    fn current(&self) -> Option<(&Arc<Segment>, usize)> {
        let timestep = self.clock.timestep();
        self.cache.get(self.archive.segment_at(timestep)).map(|segment| (segment, timestep))
    }
}

impl<S: Source> Player<S> {
    /// - `first_timestep`: shown first; the last one if there are fewer
    pub fn new(source: S, settings: PlayerSettings, first_timestep: usize) -> Self {
        Self {
            source,
            settings,
            start: Vec::new(),
            start_is_all: false,
            opened: None,
            fetch: None,
            num_retries: 0,
            first_timestep,
            bytes_loaded: 0,
            failure: None,
        }
    }

    /// The file, once its tables are known.
    pub fn archive(&self) -> Option<&Archive> {
        self.opened.as_ref().map(|opened| &opened.archive)
    }

    /// Names and bytes that applications put between the tables and the shared part, once the latter is known.
    pub fn application_data(&self) -> &[(String, Vec<u8>)] {
        self.opened.as_ref().map_or(&[], |opened| &opened.application_data)
    }

    /// The clock, once the tables are known.
    pub fn clock(&self) -> Option<&Clock> {
        self.opened.as_ref().map(|opened| &opened.clock)
    }

    /// The clock, to be set.
    pub fn clock_mut(&mut self) -> Option<&mut Clock> {
        self.opened.as_mut().map(|opened| &mut opened.clock)
    }

    /// What to draw: the timestep that is due and the segment that holds it, if that is here.
    pub fn current(&self) -> Option<(&Arc<Segment>, usize)> {
        self.opened.as_ref().and_then(Opened::current)
    }

    /// Bytes that arrived so far, those that arrived twice included.
    pub fn bytes_loaded(&self) -> u64 {
        self.bytes_loaded
    }

    /// Memory of decoded segments.
    pub fn segment_bytes(&self) -> usize {
        self.opened.as_ref().map_or(0, |opened| opened.cache.bytes())
    }

    /// Lets time pass, takes what has arrived, decodes, and asks for what is needed next.
    ///
    /// At most one segment is decoded in a call, so that pictures need not wait for what is needed later. Time stands
    /// still while the segment that is due is missing.
    ///
    /// - `now_ms`: milliseconds since anything, as long as it is always the same
    ///
    /// # Errors
    /// [`PlayError`]: from then on always the same one.
    pub fn update(&mut self, now_ms: f64) -> Result<(), PlayError> {
        if let Some(failure) = &self.failure {
            return Err(failure.clone());
        }
        if let Some(opened) = &mut self.opened {
            if opened.current().is_some() { opened.clock.advance(now_ms) } else { opened.clock.hold(now_ms) }
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
                        // Somebody who opens a file wants to know at once.
                        if self.opened.is_none() { return Err(error.into()) } else { return Ok(()) }
                    }
                    Err(error) => return Err(error.into()),
                }
            }
            let Some(mut fetch) = self.fetch.take() else { return Ok(()) };
            let is_short = fetch.bytes.len() < needed;
            fetch.bytes.truncate(needed);
            if is_short && fetch.part != Part::Start {
                let found = fetch.range.start + fetch.bytes.len() as u64;
                let expected = self.archive().map_or(fetch.range.end, Archive::file_bytes);
                return Err(PlayError::Truncated { found: self.source.length().unwrap_or(found), expected });
            }
            match fetch.part {
                Part::Start => self.read_start(&fetch.bytes, is_short, now_ms)?,
                Part::Shared => {
                    if let Some(opened) = &mut self.opened {
                        opened.read_shared(&fetch.range, &fetch.bytes)?;
                    }
                }
                Part::Segment(segment) => {
                    self.read_segment(segment, &fetch.bytes)?;
                    // The next one is asked for now, and decoded some other time.
                    return self.ask();
                }
            }
        }
    }

    fn read_start(&mut self, bytes: &[u8], is_all: bool, now_ms: f64) -> Result<(), PlayError> {
        self.start.extend_from_slice(bytes);
        self.start_is_all = is_all;
        let Opening::Ready(archive) = Archive::open(&self.start, &self.settings.limits)? else { return Ok(()) };
        let (expected, found) = (archive.file_bytes(), self.source.length());
        if let Some(found) = found.filter(|&found| found < expected) {
            return Err(PlayError::Truncated { found, expected });
        }
        let info = archive.info();
        let mut clock = Clock::new(info.num_timesteps as usize, info.frame_rate.into());
        clock.seek(self.first_timestep);
        clock.hold(now_ms);
        let cache = SegmentCache::new(archive.num_segments(), self.settings.max_segment_bytes);
        self.opened = Some(Opened { archive: *archive, cache, clock, application_data: Vec::new() });
        Ok(())
    }

    fn read_segment(&mut self, segment: usize, bytes: &[u8]) -> Result<(), PlayError> {
        let Some(opened) = &mut self.opened else { return Ok(()) };
        let eviction = Eviction::FarthestAhead(opened.playback());
        opened.cache.make_room(segment, eviction);
        let segment = opened.archive.read_segment(segment, bytes)?;
        opened.cache.insert(Arc::new(segment), eviction);
        Ok(())
    }

    /// Sees to it that what is needed most is under way.
    fn ask(&mut self) -> Result<(), PlayError> {
        let Some((part, range)) = self.next_part()? else {
            // Whatever is under way is not needed any more.
            return Ok(());
        };
        if let Some(fetch) = &self.fetch {
            // A segment that is needed later goes on, unless another one is needed now.
            let is_needed_now = self.opened.as_ref().is_some_and(|opened| part == Part::Segment(opened.playback().now));
            if fetch.part == part || !is_needed_now {
                return Ok(());
            }
        }
        // What the first request brought of it need not come again.
        let known = self.start.get(range.start as usize..).unwrap_or_default();
        let bytes = known[..known.len().min((range.end - range.start) as usize)].to_vec();
        let rest = range.start + bytes.len() as u64..range.end;
        if !rest.is_empty() {
            self.source.request(rest);
        }
        self.fetch = Some(Fetch { part, range, bytes, retry_at_ms: None });
        Ok(())
    }

    /// The part that is needed most, if any is, and where it lies.
    fn next_part(&self) -> Result<Option<(Part, Range<u64>)>, PlayError> {
        let Some(Opened { archive, cache, .. }) = &self.opened else {
            let known = self.start.len() as u64;
            let needed = match Archive::open(&self.start, &self.settings.limits)? {
                Opening::More(needed) => needed,
                Opening::Ready(_) => known,
            };
            if self.start_is_all {
                return Err(PlayError::Truncated { found: known, expected: needed });
            }
            let end = if known == 0 { self.settings.opening_bytes.max(needed) } else { needed };
            return Ok(Some((Part::Start, known..end)));
        };
        let layers = archive.num_layers();
        if archive.layers_read() < layers {
            let mut range = archive.shared_range(layers);
            // What lies between the tables and it comes along.
            let before = archive.application_ranges().into_iter().map(|data| data.start).min();
            if let Some(before) =
                before.filter(|before| (1..=MAX_APPLICATION_BYTES).contains(&(range.start.saturating_sub(*before))))
            {
                range.start = before;
            }
            return Ok(Some((Part::Shared, range)));
        }
        let playback = self.opened.as_ref().map(Opened::playback);
        let segment = playback.and_then(|playback| cache.prefetch(playback));
        Ok(segment.map(|segment| (Part::Segment(segment), archive.segment_range(segment, layers))))
    }
}
