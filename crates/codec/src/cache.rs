//! Decoded segments within a bound on their memory.
//!
//! [`SegmentCache`] serves two kinds of readers. A reader of timesteps in any order evicts the least recently used
//! segment (LRU). A player knows the order of playback: the cache evicts the segment whose next use is farthest away
//! (Bélády's rule) and names the segment to prefetch. The cache neither reads nor decodes; its caller does.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::bitstream::Segment;

/// Decoded segments of one file, within a bound on their bytes.
///
/// ```
/// use std::sync::Arc;
/// use tcgs_codec::{CompressSettings, DecodeLimits, Decoder, Event, Eviction, SceneInfo, SegmentCache};
/// use tcgs_codec::{BitMap, compress, encode};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
///
/// let mut cache = SegmentCache::new(1, 1 << 20);
/// for event in Decoder::new(DecodeLimits::default()).push(&encode(&compact)?)? {
///     if let Event::Segment(segment) = event {
///         cache.insert(Arc::from(segment), Eviction::LeastRecentlyUsed);
///     }
/// }
/// assert!(cache.get(0).is_some());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct SegmentCache {
    max_bytes: usize,
    num_segments: usize,
    held: BTreeMap<usize, Held>,
    /// Bytes of the largest segment seen: what another is expected to take.
    largest: usize,
    /// Calls of [`Self::recall`] and [`Self::insert`] so far.
    num_uses: u64,
}

#[derive(Debug)]
struct Held {
    segment: Arc<Segment>,
    /// [`SegmentCache::num_uses`] after the last use.
    last_use: u64,
}

/// Which segment a [`SegmentCache`] evicts first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Eviction {
    /// The least recently used segment (LRU), for reads in no known order.
    LeastRecentlyUsed,
    /// The segment that playback reaches last (Bélády's rule). A new segment that playback reaches later than all held
    /// segments evicts none of them.
    FarthestAhead(Playback),
}

/// Position and direction of playback, from which follows the order in which playback reaches the segments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Playback {
    /// Index of the segment that holds the timestep being shown.
    pub now: usize,
    /// Whether playback runs towards earlier timesteps.
    pub is_backwards: bool,
    /// Whether playback wraps around: from the last segment to the first, or backwards from the first to the last.
    pub is_looping: bool,
}

impl SegmentCache {
    /// Default bound on the memory of a cache, 256 MiB: several segments of a large scene.
    pub const DEFAULT_BYTES: usize = 256 << 20;

    /// An empty cache.
    ///
    /// - `num_segments`: number of segments of the file
    /// - `max_bytes`: bound on the sum of [`Segment::bytes`] over all held segments; one segment alone may exceed the
    ///   bound
    pub fn new(num_segments: usize, max_bytes: usize) -> Self {
        Self { max_bytes, num_segments, held: BTreeMap::new(), largest: 0, num_uses: 0 }
    }

    /// The segment of index `segment`, if the cache holds it. Does not count as a use.
    pub fn get(&self, segment: usize) -> Option<&Arc<Segment>> {
        self.held.get(&segment).map(|held| &held.segment)
    }

    /// The segment of index `segment`, if the cache holds it. Counts as a use for [`Eviction::LeastRecentlyUsed`].
    pub fn recall(&mut self, segment: usize) -> Option<&Arc<Segment>> {
        let held = self.held.get_mut(&segment)?;
        self.num_uses += 1;
        held.last_use = self.num_uses;
        Some(&held.segment)
    }

    /// Sum of [`Segment::bytes`] over all held segments.
    pub fn bytes(&self) -> usize {
        self.held.values().map(|held| held.segment.bytes()).sum()
    }

    /// Index of the segment to prefetch: the first segment in the order of playback that is not held. None if all
    /// segments ahead are held, or if the segment is not expected to fit beside the segments that playback reaches
    /// earlier. The segment is expected to be as large as the largest segment inserted so far. `playback.now` is named
    /// whether it fits or not.
    pub fn prefetch(&self, playback: Playback) -> Option<usize> {
        let mut before = 0;
        for distance in 0..self.num_segments {
            let segment = self.at_distance(distance, playback)?;
            match self.get(segment) {
                Some(held) => before += held.bytes(),
                None => return (distance == 0 || before + self.largest <= self.max_bytes).then_some(segment),
            }
        }
        None
    }

    /// Evicts segments before the segment of index `segment` is decoded, so that the held segments and the decoded one
    /// together keep the bound. Makes room for the largest segment inserted so far, since the size of the new one is
    /// not known yet.
    pub fn make_room(&mut self, segment: usize, eviction: Eviction) {
        self.evict(segment, self.largest, eviction);
    }

    /// Inserts a segment and evicts others until all keep the bound. The segment itself is dropped if it does not fit
    /// beside the segments that rank before it; an empty cache takes any segment.
    pub fn insert(&mut self, segment: Arc<Segment>, eviction: Eviction) {
        let (index, bytes) = (segment.index(), segment.bytes());
        self.largest = self.largest.max(bytes);
        self.held.remove(&index);
        self.evict(index, bytes, eviction);
        // A segment that does not fit beside those needed before it is of no use.
        if self.bytes() + bytes <= self.max_bytes || self.held.is_empty() {
            self.num_uses += 1;
            self.held.insert(index, Held { segment, last_use: self.num_uses });
        }
    }

    /// Evicts segments that rank behind `incoming`, the last ones first, until there is room for `bytes`.
    fn evict(&mut self, incoming: usize, bytes: usize, eviction: Eviction) {
        while self.bytes() + bytes > self.max_bytes {
            let rank = |segment: usize| self.rank(segment, eviction);
            let last = self.held.keys().copied().max_by_key(|&segment| rank(segment));
            match last {
                Some(last) if last != incoming && rank(last) > rank(incoming) => self.held.remove(&last),
                _ => return,
            };
        }
    }

    /// The higher, the sooner a segment is evicted; 0 for one that is not held and about to be used.
    fn rank(&self, segment: usize, eviction: Eviction) -> u64 {
        match eviction {
            Eviction::LeastRecentlyUsed => self.held.get(&segment).map_or(0, |held| self.num_uses + 1 - held.last_use),
            Eviction::FarthestAhead(playback) => self.distance(segment, playback) as u64,
        }
    }

    /// How many segments playback reaches before this one; those that a walk without a loop never reaches come last.
    fn distance(&self, segment: usize, playback: Playback) -> usize {
        let (len, now) = (self.num_segments, playback.now);
        let ahead = if playback.is_backwards { now + len - segment } else { segment + len - now };
        ahead % len
    }

    /// The segment that playback reaches after `distance` others.
    fn at_distance(&self, distance: usize, playback: Playback) -> Option<usize> {
        let (len, now) = (self.num_segments, playback.now);
        let segment = if playback.is_backwards { now + len - distance } else { now + distance };
        let around = if playback.is_backwards { segment < len } else { segment >= len };
        (playback.is_looping || distance == 0 || !around).then_some(segment % len)
    }
}
