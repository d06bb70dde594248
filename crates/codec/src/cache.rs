//! Decoded segments of one cohort within a memory bound, for readers of timesteps in any order. A player knows which
//! segment it needs next, so it has a cache of its own (`play/src/holdings.rs`). The cache neither reads nor decodes;
//! its caller does.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::bitstream::Segment;

/// Decoded segments of one cohort, within a bound on their bytes: the least recently used one is evicted first (LRU).
///
/// ```
/// use std::sync::Arc;
/// use tcgs_codec::{CompressSettings, DecodeLimits, Decoder, Event, SceneInfo, SegmentCache};
/// use tcgs_codec::{BitMap, compress, encode};
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// let mut scene = DynamicGaussians::default();
/// scene.push(Gaussians::zeros(3));
/// let settings = CompressSettings::default();
/// let compact = compress(&scene, &BitMap::uniform(3, 16, 6), None, SceneInfo::of(&scene), &settings)?;
///
/// let mut cache = SegmentCache::new(1 << 20);
/// for event in Decoder::new(DecodeLimits::default()).push(&encode(&compact)?)? {
///     if let Event::Segment(segment) = event {
///         cache.insert(Arc::from(segment));
///     }
/// }
/// assert!(cache.recall(0).is_some());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct SegmentCache {
    max_bytes: usize,
    held: BTreeMap<usize, Held>,
    /// Bytes of the largest segment so far: the expected size of another one.
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

impl SegmentCache {
    /// Default bound on the memory of a cache, 256 MiB: several segments of a large scene.
    pub const DEFAULT_BYTES: usize = 256 << 20;

    /// An empty cache.
    ///
    /// - `max_bytes`: bound on the sum of [`Segment::bytes`] over all held segments; one segment alone may exceed the
    ///   bound
    pub fn new(max_bytes: usize) -> Self {
        Self { max_bytes, held: BTreeMap::new(), largest: 0, num_uses: 0 }
    }

    /// The segment with index `segment`, if the cache holds it.
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

    /// Evicts segments before another one is decoded, so that the held segments and the new one together keep the
    /// bound. The size of the new segment is unknown, so the cache assumes that of the largest segment so far.
    pub fn make_room(&mut self) {
        self.evict(self.largest);
    }

    /// Inserts a segment and evicts others until all keep the bound.
    pub fn insert(&mut self, segment: Arc<Segment>) {
        let (index, bytes) = (segment.index(), segment.bytes());
        self.largest = self.largest.max(bytes);
        self.held.remove(&index);
        self.evict(bytes);
        self.num_uses += 1;
        self.held.insert(index, Held { segment, last_use: self.num_uses });
    }

    /// Evicts segments until `bytes` fit, or none is left.
    fn evict(&mut self, bytes: usize) {
        while self.bytes() + bytes > self.max_bytes {
            let oldest = self.held.iter().min_by_key(|(_, held)| held.last_use).map(|(&index, _)| index);
            let Some(oldest) = oldest else { return };
            self.held.remove(&oldest);
        }
    }
}
