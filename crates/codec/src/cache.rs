//! Decoded segments within a bound on their memory.
//!
//! One cache for two kinds of readers. Who reads timesteps in any order evicts the segment that was used longest ago
//! (LRU). Who plays knows what comes next: the cache evicts the segment whose next use is farthest away (Bélády's
//! rule) and says which segment to prefetch.

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
    /// The one that was used longest ago, for reads in no known order.
    LeastRecentlyUsed,
    /// The one that playback reaches last. A new segment that playback reaches later than all those held evicts
    /// none.
    FarthestAhead(Playback),
}

/// In which order playback reaches the segments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Playback {
    /// The segment that is needed now.
    pub now: usize,
    /// Whether time runs backwards.
    pub is_backwards: bool,
    /// Whether playback goes on from the other end after an end.
    pub is_looping: bool,
}

impl SegmentCache {
    /// A bound that holds several segments of a large scene: 256 MiB.
    pub const DEFAULT_BYTES: usize = 256 << 20;

    /// An empty cache.
    ///
    /// - `num_segments`: of the file
    /// - `max_bytes`: [`Segment::bytes`] of all segments held together; a single larger segment is held all the same
    pub fn new(num_segments: usize, max_bytes: usize) -> Self {
        Self { max_bytes, num_segments, held: BTreeMap::new(), largest: 0, num_uses: 0 }
    }

    /// A segment, if it is held. Does not count as a use.
    pub fn get(&self, segment: usize) -> Option<&Arc<Segment>> {
        self.held.get(&segment).map(|held| &held.segment)
    }

    /// A segment, if it is held. Counts as a use for [`Eviction::LeastRecentlyUsed`].
    pub fn recall(&mut self, segment: usize) -> Option<&Arc<Segment>> {
        let held = self.held.get_mut(&segment)?;
        self.num_uses += 1;
        held.last_use = self.num_uses;
        Some(&held.segment)
    }

    /// Memory of all segments held, in bytes.
    pub fn bytes(&self) -> usize {
        self.held.values().map(|held| held.segment.bytes()).sum()
    }

    /// The segment to prefetch: of those not held the one that playback reaches first, if it is expected to fit beside
    /// the segments reached before it.
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

    /// Evicts before a segment is decoded, so that decoding it does not exceed the bound: as much as the largest
    /// segment seen so far takes.
    pub fn make_room(&mut self, segment: usize, eviction: Eviction) {
        self.evict(segment, self.largest, eviction);
    }

    /// Takes a segment, and evicts others if all together exceed the bound.
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
