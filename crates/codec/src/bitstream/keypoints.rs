//! Coding of the keypoints of one attribute within one segment (`docs/FORMAT.md`, "Segments"), for both directions.

use std::ops::Range;

use tcgs_core::Attribute;

use super::coder::{Coder, SymbolModel};
use super::neighbors::NONE;
use super::number::{Numbers, floor, unzigzag, wrap, zigzag};
use super::plan::{MAX_COMPONENTS, Plan};
use super::segment::Keypoints;
use super::shared::{Shared, place_of_width};
use crate::compact::Tracks;
use crate::error::DecodeError;
use crate::limits::Budget;

/// Keypoints of units. A unit is a group of tracks with common keypoint times, if it moves: all components of an
/// attribute of a Gaussian if they share their times, else one track.
#[derive(Clone, Debug, Default)]
pub(super) struct UnitTracks {
    /// Number of components of a unit.
    pub(super) channels: usize,
    /// `[units + 1]`
    starts: Vec<u32>,
    times: Vec<u16>,
    /// `[keypoints, channels]`
    codes: Vec<i16>,
}

impl UnitTracks {
    pub(super) fn new(channels: usize) -> Self {
        Self { channels, starts: vec![0], ..Self::default() }
    }

    pub(super) fn num_units(&self) -> usize {
        self.starts.len() - 1
    }

    pub(super) fn num_keypoints(&self) -> usize {
        self.times.len()
    }

    /// Reserves space for one more unit of `num_keypoints` keypoints. Arrays grow by 25 %, not 100 %, to bound peak
    /// memory while decoding.
    fn reserve(&mut self, num_keypoints: usize) {
        fn reserve<V>(values: &mut Vec<V>, more: usize) {
            if values.capacity() - values.len() < more {
                values.reserve_exact(more.max(values.len() / 4).max(64));
            }
        }
        reserve(&mut self.starts, 1);
        reserve(&mut self.times, num_keypoints);
        reserve(&mut self.codes, num_keypoints * self.channels);
    }

    /// Frees the space that was reserved and not used.
    pub(super) fn shrink(&mut self) {
        self.starts.shrink_to_fit();
        self.times.shrink_to_fit();
        self.codes.shrink_to_fit();
    }

    fn bytes_per_keypoint(&self) -> usize {
        size_of::<u16>() + self.channels * size_of::<i16>()
    }

    /// Memory of all units, in bytes.
    pub(super) fn bytes(&self) -> usize {
        self.starts.len() * size_of::<u32>() + self.times.len() * self.bytes_per_keypoint()
    }

    /// Times and codes of a unit, `[keypoints]` and `[keypoints, channels]`; empty if the Gaussian does not live in the
    /// segment.
    pub(super) fn unit(&self, unit: usize) -> (&[u16], &[i16]) {
        let range = self.starts[unit] as usize..self.starts[unit + 1] as usize;
        (&self.times[range.clone()], &self.codes[range.start * self.channels..range.end * self.channels])
    }

    /// The public view of these units.
    pub(super) fn as_keypoints(&self) -> Keypoints<'_> {
        Keypoints { channels: self.channels, starts: &self.starts, times: &self.times, codes: &self.codes }
    }

    /// Code of a channel at a time: linear between keypoints, constant beyond them.
    ///
    /// Predicts the codes of other units while decoding. FORMAT.md makes this form normative, in f64 and in this order
    /// of operations. Another form, such as `keypoints::lerp` in f32, would predict other codes and so misread the
    /// symbols.
    fn at(&self, unit: usize, channel: usize, time: u16) -> f64 {
        let (times, codes) = self.unit(unit);
        let code = |k: usize| f64::from(codes[k * self.channels + channel]);
        let after = times.partition_point(|&t| t <= time);
        if after == 0 || after == times.len() {
            return code(after.saturating_sub(1));
        }
        let (a, b) = (code(after - 1), code(after));
        let [start, end] = [times[after - 1], times[after]].map(f64::from);
        a + (b - a) * (f64::from(time) - start) / (end - start)
    }
}

/// Prediction of a code from the preceding codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Motion {
    /// The preceding code.
    Still = 0,
    /// The preceding code plus the change of the neighbour's code.
    Neighbor = 1,
    /// Linear extrapolation from the two keypoints before.
    Line = 2,
    /// The mean of [`Self::Neighbor`] and [`Self::Line`].
    Mean = 3,
}

impl Motion {
    pub(super) const ALL: [Self; 4] = [Self::Still, Self::Neighbor, Self::Line, Self::Mean];
}

/// The keypoints in one section: one attribute, one layer, one segment.
pub(super) struct Scope<'a> {
    pub(super) plan: &'a Plan,
    pub(super) shared: &'a Shared,
    pub(super) attribute: Attribute,
    /// Gaussians of the layer.
    pub(super) layer: Range<usize>,
    /// Timesteps of the segment, counted from the first of the cohort.
    pub(super) span: Range<usize>,
    /// Number of timesteps of the cohort.
    pub(super) num_timesteps: usize,
    /// Budget for the memory of keypoints.
    pub(super) budget: &'a Budget,
}

/// The reason why keypoints cannot be decoded.
#[derive(Debug)]
pub(super) enum Problem {
    /// The bytes end early or contradict the format.
    Damaged,
    /// More keypoints than the limits allow.
    TooMany(DecodeError),
}

/// Number of contexts by time since the preceding keypoint, in powers of two.
const NUM_GAPS: usize = 4;
/// Number of contexts by size of the preceding difference, in powers of two.
const NUM_SIZES: usize = 6;
/// Number of contexts by number of inner keypoints.
const NUM_COUNTS: usize = 6;
/// Number of contexts of a gap by the share of timesteps that are keypoints.
const NUM_DENSITIES: usize = 8;
/// Symbol of a unit that is constant within the segment.
const HELD: u32 = 0;
/// Symbol of 14 or more inner keypoints.
const MANY: u32 = 15;

/// Models of an attribute's keypoints.
#[derive(Clone)]
pub(super) struct KeypointModels {
    /// Index of each width among the widths that have quantizers; contexts use it.
    place_of_width: [usize; 17],
    num_widths: usize,
    /// Number of inner keypoints plus one, or [`HELD`].
    counts: Vec<SymbolModel>,
    more: Numbers,
    before: Numbers,
    after: Numbers,
    gaps: Numbers,
    first: Numbers,
    later: Numbers,
}

impl KeypointModels {
    pub(super) fn new(plan: &Plan, attribute: Attribute) -> Self {
        let components = attribute.components();
        let widths = &plan.quantizers.attributes[attribute.index()];
        let num_widths = widths.len();
        Self {
            place_of_width: place_of_width(widths.keys()),
            num_widths,
            counts: vec![SymbolModel::new(16); components * NUM_COUNTS * NUM_COUNTS],
            more: Numbers::new(1),
            before: Numbers::new(1),
            after: Numbers::new(1),
            gaps: Numbers::new(NUM_DENSITIES),
            first: Numbers::new(components * num_widths * NUM_SIZES),
            later: Numbers::new(components * num_widths * NUM_SIZES * NUM_GAPS * 2),
        }
    }

    fn context(&self, channel: usize, width: u8) -> usize {
        channel * self.num_widths + self.place_of_width[usize::from(width)]
    }

    /// Codes the keypoints of all moving units of a layer.
    ///
    /// - `source`: when encoding, all tracks of the attribute over all timesteps
    /// - `out`: the units of the layers before; the units of this layer are appended
    pub(super) fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        place: &Scope<'_>,
        motion: Motion,
        source: Option<&Tracks<i16>>,
        out: &mut UnitTracks,
    ) -> Result<(), Problem> {
        let a = place.attribute.index();
        let components = place.attribute.components();
        let units = components / out.channels;
        let mut count_before = 0;
        for g in place.layer.clone() {
            let life = place.shared.lives.as_ref().map(|lives| [lives[g].birth, lives[g].death].map(|t| t as usize));
            let [birth, death] = life.unwrap_or([0, place.num_timesteps]);
            let span = place.span.start.max(birth)..place.span.end.min(death);
            for unit in 0..units {
                if place.shared.units[a][g * units + unit] == NONE {
                    continue;
                }
                if span.is_empty() {
                    place.budget.reserve("keypoints", 1, size_of::<u32>()).map_err(Problem::TooMany)?;
                    out.starts.push(out.times.len() as u32);
                    continue;
                }
                let neighbors = place.shared.neighbors(g);
                let neighbor = neighbors.into_iter().find_map(|n| {
                    let index = if n == NONE { NONE } else { place.shared.units[a][n as usize * units + unit] };
                    let moves_here = index != NONE && !out.unit(index as usize).0.is_empty();
                    moves_here.then_some((n as usize, index as usize))
                });
                let unit = Unit {
                    place,
                    span: span.clone(),
                    birth,
                    death,
                    motion,
                    gaussian: g,
                    channel: unit * out.channels,
                    neighbor,
                    source: source
                        .map(|tracks| UnitKeypoints::new(tracks, g * components + unit * out.channels, &span)),
                };
                count_before = self.code_unit(coder, &unit, count_before, out)?;
                if coder.exhausted() {
                    return Err(Problem::Damaged);
                }
            }
        }
        Ok(())
    }

    /// - returns: number of inner keypoints
    fn code_unit<C: Coder>(
        &mut self,
        coder: &mut C,
        unit: &Unit<'_>,
        count_before: usize,
        out: &mut UnitTracks,
    ) -> Result<usize, Problem> {
        let place = unit.place;
        let (first, last) = (unit.span.start, unit.span.end - 1);
        let channels = out.channels;
        let start = out.times.len();
        let time_of = |k: usize| unit.source.as_ref().map_or(0, |s| usize::from(s.times[k]));

        let bytes = out.bytes_per_keypoint() + size_of::<u32>();
        place.budget.reserve("keypoints", 1, bytes).map_err(Problem::TooMany)?;
        out.reserve(2);
        let mut time = first;
        if first > unit.birth {
            let before = self.before.code(coder, 0, first.wrapping_sub(time_of(0)) as u32) as usize;
            time = first.checked_sub(before).filter(|&time| time >= unit.birth).ok_or(Problem::Damaged)?;
        }
        out.times.push(time as u16);
        self.code_start(coder, unit, out);
        let alone = first == last && time == first;
        let mut inner = 0;
        if !alone {
            let counts_of = |(_, index): (usize, usize)| out.unit(index).0.len().saturating_sub(2);
            let near = unit.neighbor.map_or(0, |n| bucket(counts_of(n)));
            let context = (unit.channel * NUM_COUNTS + near) * NUM_COUNTS + bucket(count_before);
            let source = unit.source.as_ref();
            let inner_of_source = source.map_or(0, |s| s.times.len().wrapping_sub(2));
            let held = source.is_some_and(|s| s.is_held(channels));
            let symbol = if held { HELD } else { (inner_of_source as u32 + 1).min(MANY) };
            let symbol = coder.symbol(&mut self.counts[context], symbol);
            inner = symbol.saturating_sub(1) as usize;
            if symbol == MANY {
                inner += self.more.code(coder, 0, inner_of_source.wrapping_sub(inner) as u32) as usize;
            }
            // Number of free timesteps strictly inside.
            let mut free = last.saturating_sub(first + 1);
            if inner > free {
                return Err(Problem::Damaged);
            }
            let bytes = out.bytes_per_keypoint();
            place.budget.reserve("keypoints", inner as u64 + 1, bytes).map_err(Problem::TooMany)?;
            out.reserve(inner + 1);
            let mut inner_time = first;
            for k in 0..inner {
                let rest = inner - k;
                let mut gap = 0;
                if free > rest {
                    let density = (2 * free / rest).ilog2().min(NUM_DENSITIES as u32) as usize - 1;
                    gap = self.gaps.code(coder, density, time_of(k + 1).wrapping_sub(inner_time + 1) as u32) as usize;
                    if gap > free - rest {
                        return Err(Problem::Damaged);
                    }
                }
                inner_time += gap + 1;
                free -= gap + 1;
                out.times.push(inner_time as u16);
            }
            let mut end = last;
            if last + 1 < unit.death {
                let source_end = source.map_or(0, |s| usize::from(s.times[s.times.len() - 1]));
                end += self.after.code(coder, 0, source_end.wrapping_sub(last) as u32) as usize;
                if end >= unit.death {
                    return Err(Problem::Damaged);
                }
            }
            out.times.push(end as u16);
            if symbol == HELD {
                out.codes.extend_from_within(start * channels..);
            } else {
                self.code_later(coder, unit, start, out);
            }
        }
        out.starts.push(out.times.len() as u32);
        Ok(inner)
    }

    /// Codes every channel at a unit's first keypoint, whose time is known.
    fn code_start<C: Coder>(&mut self, coder: &mut C, unit: &Unit<'_>, out: &mut UnitTracks) {
        let place = unit.place;
        let a = place.attribute.index();
        let components = place.attribute.components();
        let time = out.times[out.times.len() - 1];
        let mut size = 0;
        for c in 0..out.channels {
            let channel = unit.channel + c;
            let anchor = place.shared.first_codes[a][unit.gaussian * components + channel];
            let mut code = anchor;
            if unit.span.start > unit.birth {
                let width = unit.width();
                let shift = unit.neighbor.map_or(0.0, |(n, index)| {
                    let first = f64::from(place.shared.first_codes[a][n * components + channel]);
                    unit.scaled(n, channel, out.at(index, c, time) - first)
                });
                let near = i32::from(anchor) + rounded(shift);
                let source = unit.source.as_ref().map_or(0, |s| i32::from(s.code(0, c)));
                let context = self.context(channel, width) * NUM_SIZES + size;
                let coded = self.first.code(coder, context, zigzag(wrap(source.wrapping_sub(near), width)));
                size = size_of_difference(coded);
                code = wrap(near.wrapping_add(unzigzag(coded)), width) as i16;
            }
            out.codes.push(code);
        }
    }

    /// Codes all keypoints but the first; their times are known.
    ///
    /// - `start`: index of the first keypoint
    fn code_later<C: Coder>(&mut self, coder: &mut C, unit: &Unit<'_>, start: usize, out: &mut UnitTracks) {
        let channels = out.channels;
        let width = unit.width();
        let mut sizes = [0_u8; MAX_COMPONENTS];
        for at in start + 1..out.times.len() {
            let (time_before, time) = (out.times[at - 1], out.times[at]);
            let gap = (time - time_before).max(1).ilog2().min(NUM_GAPS as u32 - 1) as usize;
            for c in 0..channels {
                let channel = unit.channel + c;
                let before = out.codes[(at - 1) * channels + c];
                let neighbor = unit
                    .neighbor
                    .map(|(n, index)| unit.scaled(n, channel, out.at(index, c, time) - out.at(index, c, time_before)));
                let line = (at > start + 1).then(|| {
                    let step = f64::from(before) - f64::from(out.codes[(at - 2) * channels + c]);
                    let [t0, t1, t2] = [out.times[at - 2], time_before, time].map(f64::from);
                    step * (t2 - t1) / (t1 - t0)
                });
                let shift = match (unit.motion, neighbor, line) {
                    (Motion::Neighbor | Motion::Mean, Some(shift), None) | (Motion::Neighbor, Some(shift), _) => shift,
                    (Motion::Line | Motion::Mean, None, Some(shift)) | (Motion::Line, _, Some(shift)) => shift,
                    (Motion::Mean, Some(a), Some(b)) => (a + b) * 0.5,
                    _ => 0.0,
                };
                let near = i32::from(before) + rounded(shift);
                let source = unit.source.as_ref().map_or(0, |s| i32::from(s.code(at - start, c)));
                let size = if c > 0 { sizes[c - 1] } else { sizes[0] };
                let context = (self.context(channel, width) * NUM_SIZES + usize::from(size)) * NUM_GAPS + gap;
                let context = 2 * context + usize::from(neighbor.is_some());
                let coded = self.later.code(coder, context, zigzag(wrap(source.wrapping_sub(near), width)));
                sizes[c] = size_of_difference(coded) as u8;
                out.codes.push(wrap(near.wrapping_add(unzigzag(coded)), width) as i16);
            }
        }
    }
}

fn bucket(count: usize) -> usize {
    ((count + 1).ilog2() as usize + usize::from(count > 0)).min(NUM_COUNTS - 1)
}

fn size_of_difference(zigzag: u32) -> usize {
    ((zigzag + 1).ilog2() as usize).min(NUM_SIZES - 1)
}

/// Nearest integer, halves upwards; clamped to ±10⁶.
fn rounded(shift: f64) -> i32 {
    floor((shift + 0.5).clamp(-1e6, 1e6))
}

/// A unit being coded, and the inputs of its prediction.
struct Unit<'a> {
    place: &'a Scope<'a>,
    /// Timesteps of the segment at which its Gaussian lives.
    span: Range<usize>,
    /// First timestep at which its Gaussian lives.
    birth: usize,
    /// First timestep at which its Gaussian no longer lives.
    death: usize,
    motion: Motion,
    gaussian: usize,
    /// First channel of the unit.
    channel: usize,
    /// The nearest neighbour that moves: Gaussian and unit.
    neighbor: Option<(usize, usize)>,
    source: Option<UnitKeypoints<'a>>,
}

impl Unit<'_> {
    fn width(&self) -> u8 {
        self.place.shared.bit_map.widths[self.place.attribute.index()][self.gaussian]
    }

    /// Converts a difference between codes of another Gaussian to steps of this one.
    fn scaled(&self, other: usize, channel: usize, difference: f64) -> f64 {
        let widths = &self.place.shared.bit_map.widths[self.place.attribute.index()];
        if widths[other] == self.width() {
            return difference;
        }
        let step = |width| {
            let quantizer = self.place.plan.quantizers.get(self.place.attribute, width, channel);
            quantizer.map_or(1.0, |q| f64::from(q.step))
        };
        difference * step(widths[other]) / step(self.width())
    }
}

/// Keypoints to encode.
struct UnitKeypoints<'a> {
    times: &'a [u16],
    /// Codes by channel.
    codes: [&'a [i16]; MAX_COMPONENTS],
}

impl<'a> UnitKeypoints<'a> {
    /// The part of the tracks from `track` on that a span needs: from the last keypoint at or before its first timestep
    /// to the first keypoint at or after its last.
    fn new(tracks: &'a Tracks<i16>, track: usize, span: &Range<usize>) -> Self {
        let (times, _) = tracks.track(track);
        let first = times.partition_point(|&t| usize::from(t) <= span.start) - 1;
        let last = first + times[first..].partition_point(|&t| usize::from(t) + 1 < span.end);
        let range = first..(last + 1).min(times.len());
        let codes = std::array::from_fn(|c| if track + c < tracks.len() { tracks.track(track + c).1 } else { &[] });
        Self { times: &times[range.clone()], codes: codes.map(|c: &[i16]| c.get(range.clone()).unwrap_or(&[])) }
    }

    fn code(&self, keypoint: usize, channel: usize) -> i16 {
        self.codes[channel][keypoint]
    }

    fn is_held(&self, channels: usize) -> bool {
        self.times.len() == 2 && self.codes[..channels].iter().all(|codes| codes[0] == codes[1])
    }
}
