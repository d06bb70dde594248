//! Decoded segments, within a bound on their memory.

use std::collections::BTreeMap;
use std::sync::Arc;

use tcgs_codec::Segment;

/// Decoded segments. Those that are needed soonest stay.
#[derive(Debug)]
pub struct Buffer {
    bound: usize,
    num_segments: usize,
    segments: BTreeMap<usize, Arc<Segment>>,
    /// Bytes of the largest segment seen: what another is expected to take.
    largest: usize,
}

/// In which order segments are needed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Order {
    /// The segment that is needed now.
    pub now: usize,
    /// Whether time runs backwards.
    pub is_backwards: bool,
    /// Whether the other end follows an end.
    pub is_looping: bool,
}

impl Buffer {
    /// - `bound`: bytes of all segments together; a single larger one is held all the same
    pub fn new(num_segments: usize, bound: usize) -> Self {
        Self { bound, num_segments, segments: BTreeMap::new(), largest: 0 }
    }

    /// A segment, if it is here.
    pub fn get(&self, segment: usize) -> Option<&Arc<Segment>> {
        self.segments.get(&segment)
    }

    /// Memory of all segments that are here.
    pub fn bytes(&self) -> usize {
        self.segments.values().map(|segment| segment.bytes()).sum()
    }

    /// The next segment to fetch: the one needed soonest that is not here, if it fits beside those needed before it.
    pub fn wanted(&self, order: Order) -> Option<usize> {
        let mut before = 0;
        for distance in 0..self.num_segments {
            let segment = self.at_distance(distance, order)?;
            match self.get(segment) {
                Some(held) => before += held.bytes(),
                None => return (distance == 0 || before + self.largest <= self.bound).then_some(segment),
            }
        }
        None
    }

    /// Makes room for a segment that is about to be decoded: those needed last go, until what is left and the largest
    /// one seen fit together.
    pub fn make_room(&mut self, segment: usize, order: Order) {
        self.evict(segment, self.largest, order);
    }

    /// Takes a segment; those needed last go if all together do not fit.
    pub fn insert(&mut self, segment: Arc<Segment>, order: Order) {
        let (index, bytes) = (segment.index(), segment.bytes());
        self.largest = self.largest.max(bytes);
        self.segments.remove(&index);
        self.evict(index, bytes, order);
        // What does not fit beside those needed before it is of no use.
        if self.bytes() + bytes <= self.bound || self.segments.is_empty() {
            self.segments.insert(index, segment);
        }
    }

    /// Drops those needed after `incoming`, the last ones first, until there is room for `bytes`.
    fn evict(&mut self, incoming: usize, bytes: usize, order: Order) {
        while self.bytes() + bytes > self.bound {
            let distance = |segment: usize| self.distance(segment, order);
            let last = self.segments.keys().copied().max_by_key(|&segment| distance(segment));
            match last {
                Some(last) if distance(last) > distance(incoming) => self.segments.remove(&last),
                _ => return,
            };
        }
    }

    /// How many segments are needed before this one; those that a walk without a loop never meets come last.
    fn distance(&self, segment: usize, order: Order) -> usize {
        let len = self.num_segments;
        let ahead = if order.is_backwards { order.now + len - segment } else { segment + len - order.now };
        ahead % len
    }

    fn at_distance(&self, distance: usize, order: Order) -> Option<usize> {
        let len = self.num_segments;
        let segment = if order.is_backwards { order.now + len - distance } else { order.now + distance };
        let around = if order.is_backwards { segment < len } else { segment >= len };
        (order.is_looping || distance == 0 || !around).then_some(segment % len)
    }
}
