//! From a source of bytes to the segment and timestep to draw.
//!
//! A state machine fetches in this order:
//! - the tables at the start of the file;
//! - the first layer of each cohort that lives at the due timestep, for a first picture;
//! - the other layers of these cohorts;
//! - as prefetch, later timesteps in the order of playback, while there is room.
//!
//! One request is under way at a time. Nothing here blocks: [`Player::update`] uses the bytes that have arrived.

use std::collections::BTreeMap;
use std::ops::Range;

use tcgs_codec::{Archive, DecodeLimits, Light, MAGIC, Opening, SegmentCache, read_light, read_times, read_views};
use tcgs_core::Camera;

use crate::clock::Clock;
use crate::error::PlayError;
use crate::holdings::{Holdings, Moment, Part};
use crate::source::{Piece, RangeSource, SourceError};
use crate::start_view::{StartView, start_view};
use crate::viewer::Feed;

/// A player's memory, and its first request.
#[derive(Clone, Debug, PartialEq)]
pub struct PlayerSettings {
    /// Bound on the memory of decoded segments, bytes, and of the Gaussians that do not live at the due timestep. Due
    /// data are held even if they alone exceed the bound. Default 256 MiB.
    pub max_segment_bytes: usize,
    /// Limits beyond which a file is refused. Default: 1 GiB of memory, which a browser's tab has, and otherwise
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

/// Number of times in a row that a request is sent again after the connection broke.
const MAX_RETRIES: u32 = 4;
/// Milliseconds before the first retry; each further one waits twice as long (exponential backoff).
const RETRY_MS: f64 = 250.0;

/// Application data are read if they lie within this many bytes of the start of the file.
const MAX_APPLICATION_BYTES: u64 = 1 << 18;

/// A request that is under way.
#[derive(Debug)]
struct Fetch {
    part: Part,
    /// Where the part lies in the file.
    range: Range<u64>,
    /// The bytes of the range that have arrived.
    bytes: Vec<u8>,
    /// Time of the next request, if the connection broke.
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

/// The tables at the start of a file, and the data of applications behind them.
#[derive(Debug)]
pub(crate) struct Tables {
    pub(crate) archive: Archive,
    pub(crate) clock: Clock,
    pub(crate) application_data: Vec<(String, Vec<u8>)>,
    pub(crate) light: Light,
}

impl Tables {
    /// - `start`: the first bytes of the file
    /// - `first_timestep`: where the clock stands; the last timestep of the scene if it has fewer
    /// - returns: `None` as long as `start` lacks application data
    pub(crate) fn read(archive: Archive, start: &[u8], first_timestep: usize) -> Result<Option<Self>, PlayError> {
        let mut application_data = Vec::new();
        for (index, range) in application_ranges(&archive) {
            let Some(data) = start.get(range.start as usize..range.end as usize) else { return Ok(None) };
            let read = archive.read_application(index, data)?;
            application_data.extend(read.map(|(name, bytes)| (name, bytes.to_vec())));
        }
        let info = archive.info();
        let mut clock = Clock::new(info.num_timesteps as usize, info.frame_rate.into());
        if let Some(times) = read_times(&application_data, info.num_timesteps as usize) {
            clock = clock.with_times(times);
        }
        clock.seek(first_timestep);
        let light = read_light(&application_data);
        Ok(Some(Self { archive, clock, application_data, light }))
    }
}

/// A file whose tables have arrived.
#[derive(Debug)]
struct OpenFile {
    archive: Archive,
    holdings: Holdings,
    clock: Clock,
    application_data: Vec<(String, Vec<u8>)>,
    light: Light,
    /// Segments of which only the first layers were fetched, keyed by offset in the file.
    begun: BTreeMap<u64, Vec<u8>>,
}

impl OpenFile {
    /// Where a part lies in the file.
    fn range(&self, part: Part) -> Range<u64> {
        match part {
            Part::Tables => 0..0,
            Part::Head(cohort) => self.archive.head_range(cohort),
            Part::Start(cohort) => self.archive.start_range(cohort),
            Part::Shared(cohort, layers) => {
                self.holdings.cohort(cohort).map_or(0..0, |cohort| cohort.shared_range(layers))
            }
            Part::Segment { cohort, segment, layers } => {
                self.holdings.cohort(cohort).map_or(0..0, |cohort| cohort.segment_range(segment, layers))
            }
        }
    }

    /// Decodes a part.
    ///
    /// - `start`: where it lies in the file
    fn read(&mut self, part: Part, start: u64, bytes: Vec<u8>) -> Result<(), PlayError> {
        let Self { archive, holdings, clock, begun, .. } = self;
        match part {
            Part::Tables => {}
            Part::Head(index) => {
                let cohort = archive.open_cohort(index, &bytes)?;
                holdings.insert_cohort(archive, clock, index, cohort);
            }
            Part::Start(index) => {
                let mut cohort = archive.open_cohort(index, &bytes)?;
                let shared = cohort.shared_range(cohort.num_layers()).start - start;
                cohort.read_shared(&bytes[shared as usize..])?;
                holdings.insert_cohort(archive, clock, index, cohort);
            }
            Part::Shared(index, _) => {
                if let Some(mut cohort) = holdings.take_cohort(index) {
                    cohort.read_shared(&bytes)?;
                    holdings.insert_cohort(archive, clock, index, cohort);
                }
            }
            Part::Segment { cohort: index, segment, layers } => {
                holdings.make_room(archive, clock);
                if let Some(cohort) = holdings.cohort(index) {
                    let (decoded, all) = (cohort.read_segment(segment, &bytes)?, cohort.num_layers());
                    if layers < all {
                        begun.insert(start, bytes);
                    } else {
                        begun.remove(&start);
                    }
                    holdings.insert_segment(archive, clock, decoded);
                }
            }
        }
        Ok(())
    }

    fn current(&self) -> Option<Moment> {
        self.holdings.moment(&self.archive, self.clock.timestep())
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

    /// Names and bytes of the data that applications put near the start of the file, once its tables have arrived.
    pub fn application_data(&self) -> &[(String, Vec<u8>)] {
        self.file.as_ref().map_or(&[], |file| &file.application_data)
    }

    /// The first bytes of the file: its tables and the data of applications behind them, once these have arrived.
    #[cfg(feature = "webgl2")]
    pub(crate) fn start(&self) -> &[u8] {
        &self.start
    }

    /// Whether a request is under way, or its bytes are to be decoded.
    #[cfg(feature = "webgl2")]
    pub(crate) fn is_fetching(&self) -> bool {
        self.fetch.is_some()
    }

    /// Gains of red, green and blue at a timestep ([`Light`]); 1 before the file's tables have arrived.
    pub fn light(&self, timestep: usize) -> [f32; 3] {
        self.file.as_ref().map_or([1.0; 3], |file| file.light.at(timestep))
    }

    /// The clock, once the tables of the file have arrived.
    pub fn clock(&self) -> Option<&Clock> {
        self.file.as_ref().map(|file| &file.clock)
    }

    /// The clock, to be started, stopped and set, once the tables of the file have arrived.
    pub fn clock_mut(&mut self) -> Option<&mut Clock> {
        self.file.as_mut().map(|file| &mut file.clock)
    }

    /// The due timestep, if every cohort that lives at it has a decoded segment.
    pub fn current(&self) -> Option<Moment> {
        self.file.as_ref().and_then(OpenFile::current)
    }

    /// Number of bytes that have arrived; bytes that arrived twice count twice.
    pub fn bytes_loaded(&self) -> u64 {
        self.bytes_loaded
    }

    /// Memory of the decoded segments, bytes.
    pub fn segment_bytes(&self) -> usize {
        self.file.as_ref().map_or(0, |file| file.holdings.segment_bytes())
    }

    /// Lets time pass, takes the bytes that have arrived, decodes, and requests what is needed next.
    ///
    /// One call decodes at most one segment, so that no picture waits for the decoding of segments that are due later.
    /// Time stands still while something of the due timestep is missing.
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
            let is_whole = file.current().is_some_and(|moment| moment.is_whole);
            if is_whole { file.clock.advance(now_ms) } else { file.clock.hold(now_ms) }
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
                        // A broken connection is reported at once while a file is being opened.
                        if self.file.is_none() { return Err(error.into()) } else { return Ok(()) }
                    }
                    Err(error) => return Err(error.into()),
                }
            }
            let Some(mut fetch) = self.fetch.take() else { return Ok(()) };
            let is_short = fetch.bytes.len() < needed;
            fetch.bytes.truncate(needed);
            if is_short && fetch.part != Part::Tables {
                let found = fetch.range.start + fetch.bytes.len() as u64;
                let expected = self.archive().map_or(fetch.range.end, Archive::file_bytes);
                return Err(PlayError::Truncated { found: self.source.length().unwrap_or(found), expected });
            }
            match (&mut self.file, fetch.part) {
                (None, _) => self.read_tables(&fetch.bytes, is_short, now_ms)?,
                (Some(file), part) => {
                    file.read(part, fetch.range.start, fetch.bytes)?;
                    if matches!(part, Part::Segment { .. }) || file.current().is_some() {
                        // The next part is requested now and decoded in a later call.
                        return self.ask();
                    }
                }
            }
        }
    }

    fn read_tables(&mut self, bytes: &[u8], is_all: bool, now_ms: f64) -> Result<(), PlayError> {
        self.start.extend_from_slice(bytes);
        self.start_is_all = is_all;
        let Opening::Ready(archive) = self.open_archive()? else { return Ok(()) };
        let (expected, found) = (archive.file_bytes(), self.source.length());
        if let Some(found) = found.filter(|&found| found < expected) {
            return Err(PlayError::Truncated { found, expected });
        }
        let Some(tables) = Tables::read(*archive, &self.start, self.first_timestep)? else { return Ok(()) };
        let Tables { archive, mut clock, application_data, light } = tables;
        clock.hold(now_ms);
        let holdings = Holdings::new(self.settings.max_segment_bytes);
        self.file = Some(OpenFile { archive, holdings, clock, application_data, light, begun: BTreeMap::new() });
        Ok(())
    }

    /// Reads the tables in the first bytes of the file.
    fn open_archive(&self) -> Result<Opening, PlayError> {
        let known = self.start.len().min(MAGIC.len());
        if self.start[..known] != MAGIC[..known] {
            return Err(PlayError::NotTcgs);
        }
        Ok(Archive::open(&self.start, &self.settings.limits)?)
    }

    /// Makes sure that the most needed part is under way.
    fn ask(&mut self) -> Result<(), PlayError> {
        let Some((part, range, is_due)) = self.next_part()? else {
            // No part is needed any more.
            return Ok(());
        };
        if let Some(fetch) = &self.fetch {
            // A cohort's start, requested as prefetch, contains its head. Other prefetches continue unless a due part
            // is missing.
            let has_head = matches!((fetch.part, part), (Part::Start(a), Part::Head(b)) if a == b);
            if fetch.part == part || has_head || !is_due {
                return Ok(());
            }
        }
        // Earlier requests may have brought the beginning of the part, or all of it.
        let at_start = self.start.get(range.start as usize..).unwrap_or_default();
        let begun = self.file.as_ref().and_then(|file| file.begun.get(&range.start));
        let known = begun.map_or(at_start, |begun| begun);
        let bytes = known[..known.len().min((range.end - range.start) as usize)].to_vec();
        let rest = range.start + bytes.len() as u64..range.end;
        if !rest.is_empty() {
            self.source.request(rest);
        }
        self.fetch = Some(Fetch { part, range, bytes, retry_at_ms: None });
        Ok(())
    }

    /// The most needed part, its place in the file, and whether the due timestep lacks it; `None` if there is nothing
    /// to fetch.
    fn next_part(&self) -> Result<Option<(Part, Range<u64>, bool)>, PlayError> {
        if let Some(file) = &self.file {
            let next = file.holdings.next_part(&file.archive, &file.clock);
            return Ok(next.map(|(part, is_due)| (part, file.range(part), is_due)));
        }
        let known = self.start.len() as u64;
        let needed = match self.open_archive()? {
            Opening::More(needed) => needed,
            Opening::Ready(archive) => application_ranges(&archive).map(|(_, range)| range.end).max().unwrap_or(known),
        };
        if self.start_is_all {
            return Err(PlayError::Truncated { found: known, expected: needed });
        }
        let end = if known == 0 { self.settings.opening_bytes.max(needed) } else { needed };
        Ok(Some((Part::Tables, known..end, true)))
    }
}

impl<S: RangeSource> Feed for Player<S> {
    type Moment = Moment;

    fn update(&mut self, now_ms: f64) -> Result<(), PlayError> {
        self.update(now_ms)
    }

    fn current(&self) -> Option<Moment> {
        self.current()
    }

    fn start_view(&self, moment: &Moment) -> StartView {
        let up = self.archive().map(|archive| archive.info().up).unwrap_or_default().direction();
        let cameras: Vec<Camera> =
            read_views(self.application_data()).into_iter().map(|of_file| of_file.camera).collect();
        let (camera, pivot) = start_view(moment, &cameras, up);
        StartView { camera, up, pivot }
    }

    fn look(&mut self, _: &Camera) {}

    fn is_buffering(&self) -> bool {
        self.current().is_none_or(|moment| !moment.is_whole)
    }

    fn is_due(&self, moment: &Moment, _: &Camera) -> bool {
        moment.is_whole && self.clock().is_some_and(|clock| clock.timestep() == moment.timestep)
    }

    fn light(&self, moment: &Moment) -> [f32; 3] {
        self.light(moment.timestep)
    }

    fn archive(&self) -> Option<&Archive> {
        self.archive()
    }

    fn application_data(&self) -> &[(String, Vec<u8>)] {
        self.application_data()
    }

    fn clock(&self) -> Option<&Clock> {
        self.clock()
    }

    fn clock_mut(&mut self) -> Option<&mut Clock> {
        self.clock_mut()
    }

    fn bytes_loaded(&self) -> u64 {
        self.bytes_loaded()
    }
}

/// Index and range of the application data that are read with the start of the file: the first ones.
pub(crate) fn application_ranges(archive: &Archive) -> impl Iterator<Item = (usize, Range<u64>)> {
    let ranges = archive.application_ranges().into_iter().enumerate();
    ranges.take_while(|(_, range)| range.end <= MAX_APPLICATION_BYTES)
}
