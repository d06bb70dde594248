//! The parts of a file that a player holds: cohorts with their shared layers, and decoded segments, within a memory
//! bound.
//!
//! The order of playback is known. Missing parts are fetched in that order, and the part that playback reaches last is
//! evicted first (Bélády's rule). Nothing here fetches or decodes.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use tcgs_codec::{Archive, Cohort, Segment};
use tcgs_core::{Gaussians, Layout};

use crate::clock::Clock;

/// A timestep that is to be drawn.
#[derive(Clone, Debug)]
pub struct Moment {
    /// Timestep of the scene.
    pub timestep: usize,
    /// The segment of each cohort that lives at the timestep, by ascending cohort.
    pub segments: Vec<Arc<Segment>>,
    /// Whether the segments have all their layers. The first layers alone give a coarser picture.
    pub is_whole: bool,
}

impl Moment {
    /// Whether the scene is drawn with antialiasing ([`Layout::is_antialiased`]).
    pub fn is_antialiased(&self) -> bool {
        self.segments.first().is_some_and(|segment| segment.layout().is_antialiased())
    }

    /// The Gaussians that live at the timestep, as floats in stored form, with the columns of the first cohort.
    pub fn gaussians(&self) -> Gaussians {
        let of_segment = |segment: &Arc<Segment>| {
            let all = segment.at(self.timestep);
            segment.alive(self.timestep).map_or_else(|| all.clone(), |alive| all.select(&alive))
        };
        let parts: Vec<Gaussians> = self.segments.iter().map(of_segment).collect();
        let layout = parts.first().map_or_else(Layout::base, |part| Arc::clone(part.layout()));
        Gaussians::concat(&layout, &parts)
    }
}

/// A part of the file that is fetched as one range.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    /// The tables at the start of the file, and the data of applications behind them.
    Tables,
    /// The head of a cohort.
    Head(usize),
    /// The head of a cohort and its shared layers.
    Start(usize),
    /// The shared layers of a cohort that are not read yet, up to this number of layers.
    Shared(usize, usize),
    /// A segment.
    Segment {
        /// Index of the cohort.
        cohort: usize,
        /// Index of the segment in the cohort.
        segment: usize,
        /// Number of its layers.
        layers: usize,
    },
}

/// A cohort's start of at most this many bytes is fetched and decoded before anything is shown. The first layer of a
/// longer one is shown while the others arrive. This many bytes take a second at 1 Mbit/s, and one core decodes them in
/// about 25 ms.
const QUICK_BYTES: u64 = 1 << 17;

/// Number of steps from one set of segments to the next that the prefetch looks ahead.
const MAX_SPANS: usize = 64;

/// Expected memory of a Gaussian in a cohort until a cohort has been read, bytes.
const FIRST_GUESS: usize = 100;

/// Cohorts and segments within a bound.
#[derive(Debug)]
pub(crate) struct Holdings {
    max_bytes: usize,
    cohorts: BTreeMap<usize, Cohort>,
    /// Keyed by cohort and index within it.
    segments: BTreeMap<(usize, usize), Arc<Segment>>,
    /// Bytes of the largest segment so far: the expected size of the next one.
    largest_segment: usize,
    /// Largest memory per Gaussian of a cohort so far, bytes.
    bytes_per_gaussian: usize,
}

impl Holdings {
    /// - `max_bytes`: bound on the memory of all segments, and of the cohorts that do not live at the due timestep. Due
    ///   data are held even if they alone exceed the bound
    pub(crate) fn new(max_bytes: usize) -> Self {
        Self {
            max_bytes,
            cohorts: BTreeMap::new(),
            segments: BTreeMap::new(),
            largest_segment: 0,
            bytes_per_gaussian: FIRST_GUESS,
        }
    }

    /// Memory of all segments, bytes.
    pub(crate) fn segment_bytes(&self) -> usize {
        self.segments.values().map(|segment| segment.bytes()).sum()
    }

    /// The due timestep, if every cohort that lives at it has a decoded segment.
    pub(crate) fn moment(&self, archive: &Archive, timestep: usize) -> Option<Moment> {
        let mut moment = Moment { timestep, segments: Vec::new(), is_whole: true };
        for index in archive.cohorts_at(timestep) {
            let cohort = self.cohorts.get(&index)?;
            let segment = self.segments.get(&(index, cohort.segment_at(timestep)))?;
            moment.is_whole &= segment.num_layers() == cohort.num_layers();
            moment.segments.push(Arc::clone(segment));
        }
        Some(moment)
    }

    /// An open cohort.
    pub(crate) fn cohort(&self, cohort: usize) -> Option<&Cohort> {
        self.cohorts.get(&cohort)
    }

    /// Takes a cohort out, to be read further and inserted again.
    pub(crate) fn take_cohort(&mut self, cohort: usize) -> Option<Cohort> {
        self.cohorts.remove(&cohort)
    }

    /// Inserts a cohort, whose shared layers may have been read. Evicts the parts that playback reaches later, or the
    /// cohort itself if playback reaches it last.
    pub(crate) fn insert_cohort(&mut self, archive: &Archive, clock: &Clock, index: usize, cohort: Cohort) {
        let of_gaussian = cohort.bytes() / cohort.num_gaussians().max(1);
        self.bytes_per_gaussian = self.bytes_per_gaussian.max(of_gaussian);
        self.cohorts.insert(index, cohort);
        self.evict(archive, clock, 0);
    }

    /// Evicts segments before the next one is decoded, whose expected size is that of the largest one so far.
    pub(crate) fn make_room(&mut self, archive: &Archive, clock: &Clock) {
        self.evict(archive, clock, self.largest_segment);
    }

    /// Inserts a segment. Evicts the parts that playback reaches later, or the segment itself if playback reaches it
    /// last.
    pub(crate) fn insert_segment(&mut self, archive: &Archive, clock: &Clock, segment: Segment) {
        self.largest_segment = self.largest_segment.max(segment.bytes());
        self.segments.insert((segment.cohort(), segment.index()), Arc::new(segment));
        self.evict(archive, clock, 0);
    }

    /// Evicts the part that playback reaches last until there is room, or until only due parts are left.
    fn evict(&mut self, archive: &Archive, clock: &Clock, room: usize) {
        let due: Vec<usize> = archive.cohorts_at(clock.timestep()).collect();
        loop {
            let of_cohorts: usize =
                self.cohorts.iter().filter(|(index, _)| !due.contains(index)).map(|(_, cohort)| cohort.bytes()).sum();
            if self.segment_bytes() + of_cohorts + room <= self.max_bytes {
                return;
            }
            // A cohort is evicted after its segments, because playback never reaches them before the cohort.
            let segments = self
                .segments
                .iter()
                .map(|(&(cohort, segment), held)| (distance(&held.timesteps(), archive, clock), Some(segment), cohort));
            let cohorts = self
                .cohorts
                .keys()
                .map(|&cohort| (distance(&archive.timesteps_of(cohort), archive, clock), None, cohort));
            match segments.chain(cohorts).max() {
                None | Some((0, _, _)) => return,
                Some((_, Some(segment), cohort)) => drop(self.segments.remove(&(cohort, segment))),
                Some((_, None, cohort)) => drop(self.cohorts.remove(&cohort)),
            }
        }
    }

    /// The part to fetch next, and whether the due timestep lacks it; `None` if there is nothing to fetch.
    pub(crate) fn next_part(&self, archive: &Archive, clock: &Clock) -> Option<(Part, bool)> {
        let now = clock.timestep();
        let due: Vec<usize> = archive.cohorts_at(now).collect();
        let first =
            due.iter().find_map(|&cohort| self.missing(archive, cohort, now, |cohort| cohort.num_layers().min(1)));
        let all = || due.iter().find_map(|&cohort| self.missing(archive, cohort, now, Cohort::num_layers));
        if let Some(part) = first.or_else(all) {
            return Some((part, true));
        }
        self.prefetch(archive, clock).map(|part| (part, false))
    }

    /// The part of a cohort that a timestep lacks.
    ///
    /// - `layers`: least number of layers needed
    fn missing(
        &self,
        archive: &Archive,
        index: usize,
        timestep: usize,
        layers: impl Fn(&Cohort) -> usize,
    ) -> Option<Part> {
        let Some(cohort) = self.cohorts.get(&index) else {
            let start = archive.start_range(index);
            let is_quick = start.end - start.start <= QUICK_BYTES;
            let part = if is_quick { Part::Start(index) } else { Part::Head(index) };
            return Some(archive.needs_before(index).map_or(part, Part::Head));
        };
        let layers = layers(cohort);
        if cohort.layers_read() < layers {
            return Some(Part::Shared(index, layers));
        }
        let segment = cohort.segment_at(timestep);
        let has = self.segments.get(&(index, segment)).map(|segment| segment.num_layers());
        let is_there = has.is_some_and(|has| has >= layers);
        (!is_there).then(|| Part::Segment { cohort: index, segment, layers: cohort.layers_read() })
    }

    /// The first missing part in the order of playback, unless it is not expected to fit beside the parts that playback
    /// reaches earlier.
    fn prefetch(&self, archive: &Archive, clock: &Clock) -> Option<Part> {
        let num_timesteps = archive.info().num_timesteps as usize;
        let mut timestep = clock.timestep();
        let mut first: Option<Range<usize>> = None;
        let (mut bytes, mut counted) = (0, BTreeSet::new());
        for _ in 0..MAX_SPANS {
            let mut span = archive.span_at(timestep);
            for index in archive.cohorts_at(timestep) {
                let is_due = archive.timesteps_of(index).contains(&clock.timestep());
                if let Some(part) = self.missing(archive, index, timestep, Cohort::num_layers) {
                    let of_segment = matches!(part, Part::Segment { .. });
                    let of_cohort = self.bytes_per_gaussian * archive.num_gaussians_of(index);
                    let expected = if of_segment { self.largest_segment } else { of_cohort };
                    let is_new = of_segment && !is_due && counted.insert((index, None));
                    let room = if is_new { expected + of_cohort } else { expected };
                    return (bytes + room <= self.max_bytes).then_some(part);
                }
                let cohort = self.cohorts.get(&index)?;
                let segment = cohort.segment_at(timestep);
                let of_segment = cohort.timesteps_of(segment);
                span = span.start.max(of_segment.start)..span.end.min(of_segment.end);
                if !is_due && counted.insert((index, None)) {
                    bytes += cohort.bytes();
                }
                if counted.insert((index, Some(segment))) {
                    bytes += self.segments.get(&(index, segment)).map_or(0, |segment| segment.bytes());
                }
            }
            let next = if clock.is_backwards() { span.start.checked_sub(1) } else { Some(span.end) };
            let around = if clock.is_backwards() { num_timesteps - 1 } else { 0 };
            timestep = match next.filter(|&next| next < num_timesteps) {
                Some(next) => next,
                None if clock.is_looping() => around,
                None => return None,
            };
            if first.get_or_insert(span).contains(&timestep) {
                return None;
            }
        }
        None
    }
}

/// Number of timesteps that playback passes before it reaches a range. A range that playback reaches only by looping
/// comes last.
fn distance(timesteps: &Range<usize>, archive: &Archive, clock: &Clock) -> usize {
    let (now, len) = (clock.timestep(), archive.info().num_timesteps as usize);
    if timesteps.contains(&now) {
        0
    } else if clock.is_backwards() {
        (now + len - (timesteps.end - 1)) % len
    } else {
        (timesteps.start + len - now) % len
    }
}
