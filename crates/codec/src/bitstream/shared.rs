//! The shared layers (`docs/FORMAT.md`, "Shared layers"), which all segments need: widths, flags of moving tracks, and
//! the first code of every track.

use std::ops::Range;

use tcgs_core::{Attribute, Life, Lives};

use super::coder::{Coder, SymbolModel};
use super::neighbors::{NONE, Neighbors};
use super::number::{Codes, Numbers, floor, unzigzag, wrap, zigzag};
use super::plan::{MAX_COMPONENTS, Mode, Plan, RECENT};
use crate::bits::BitMap;
use crate::morton;
use crate::quantize::{MAX_BITS, Quantizer};

/// First codes of the layers read so far, and the data needed to decode them.
#[derive(Clone, Debug)]
pub(super) struct Shared {
    /// Bit widths; 0 for an attribute that a Gaussian lacks.
    pub(super) bit_map: BitMap,
    /// `[N]` lives, counted from the first timestep of the cohort; `None` if all live in all of its timesteps.
    pub(super) lives: Option<Lives>,
    /// By attribute, `[N * components]`: whether a track has more than one keypoint.
    pub(super) moves: Vec<Vec<bool>>,
    /// By attribute, `[N * components]` first codes.
    pub(super) first_codes: Vec<Vec<i16>>,
    /// By attribute: the index among the moving units, or [`NONE`] if the unit is constant. One entry for each
    /// Gaussian, or for each of its tracks if components do not share their times.
    pub(super) units: Vec<Vec<u32>>,
    pub(super) num_units: Vec<u32>,
    pub(super) neighbors: Neighbors,
}

impl Shared {
    /// Creates the state before the first layer.
    ///
    /// - `has_lives`: whether Gaussians have lives of their own
    pub(super) fn new(plan: &Plan, has_lives: bool) -> Self {
        let num_columns = plan.layout.columns().len();
        Self {
            bit_map: BitMap::uniform_of(&plan.layout, 0, 1, 1),
            lives: has_lives.then(Lives::default),
            moves: vec![Vec::new(); num_columns],
            first_codes: vec![Vec::new(); num_columns],
            units: vec![Vec::new(); num_columns],
            num_units: vec![0; num_columns],
            neighbors: Neighbors::default(),
        }
    }

    /// Number of Gaussians of the layers read so far.
    pub(super) fn num_gaussians(&self) -> usize {
        self.bit_map.num_gaussians()
    }

    /// Extends all arrays by the Gaussians of a layer.
    pub(super) fn extend(&mut self, plan: &Plan, layer: &Range<usize>) {
        if let Some(lives) = &mut self.lives {
            lives.0.resize(layer.end, Life { birth: 0, death: 1 });
        }
        for attribute in plan.layout.attributes() {
            let (a, components) = (attribute.index(), attribute.components());
            self.bit_map.widths[a].resize(layer.end, 1);
            self.first_codes[a].resize(layer.end * components, 0);
            if plan.varies[a] {
                self.moves[a].resize(layer.end * components, false);
            }
        }
    }

    /// Numbers the moving units of a layer.
    pub(super) fn count_units(&mut self, plan: &Plan, layer: &Range<usize>) {
        for attribute in plan.layout.attributes() {
            let (a, components) = (attribute.index(), attribute.components());
            if plan.varies[a] {
                let step = if plan.joint[a] { components } else { 1 };
                for track in (layer.start * components..layer.end * components).step_by(step) {
                    let moves = self.moves[a][track];
                    self.units[a].push(if moves { self.num_units[a] } else { NONE });
                    self.num_units[a] += u32::from(moves);
                }
            }
        }
    }

    /// The two nearest neighbours of a Gaussian.
    pub(super) fn neighbors(&self, gaussian: usize) -> [u32; 2] {
        self.neighbors.of(gaussian)
    }

    /// First positions of a layer as 16-bit coordinates, independent of their widths.
    pub(super) fn points(&self, layer: Range<usize>) -> impl Iterator<Item = [u16; 3]> {
        let index = Attribute::Mean.index();
        layer.map(move |g| {
            let width = self.bit_map.widths[index][g];
            [0, 1, 2].map(|c| coordinate(self.first_codes[index][3 * g + c], width))
        })
    }
}

fn coordinate(code: i16, width: u8) -> u16 {
    ((i32::from(code) + (1 << (width - 1))) << (MAX_BITS - width)) as u16
}

/// Models of lives, widths and flags of moving tracks.
#[derive(Clone, Debug)]
pub(super) struct MapModels {
    births: Numbers,
    /// Timesteps from the death to the end of the cohort.
    deaths: Numbers,
    /// Whether a Gaussian has an attribute.
    present: Vec<SymbolModel>,
    widths: Vec<SymbolModel>,
    moves: Vec<SymbolModel>,
    /// Largest number of components of an attribute that varies.
    components: usize,
}

impl MapModels {
    pub(super) fn new(plan: &Plan) -> Self {
        let num_columns = plan.layout.columns().len();
        let components = plan.varying().map(Attribute::components).max().unwrap_or(0);
        Self {
            births: Numbers::new(1),
            deaths: Numbers::new(2),
            present: vec![SymbolModel::new(2); num_columns * 4],
            widths: vec![SymbolModel::new(16); num_columns * 17 * 17],
            moves: vec![SymbolModel::new(2); num_columns * components * 8],
            components,
        }
    }

    /// Codes lives, widths and moves of a layer in place; the arrays already include the layer.
    ///
    /// - `num_timesteps`: of the cohort
    /// - returns: whether all lives lie within the cohort
    pub(super) fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        plan: &Plan,
        num_timesteps: usize,
        layer: Range<usize>,
        shared: &mut Shared,
    ) -> bool {
        // A decoder has already refused `num_timesteps` 0.
        let num_timesteps = num_timesteps as u32;
        for g in layer {
            if coder.exhausted() {
                return true;
            }
            if let Some(lives) = &mut shared.lives {
                let birth = self.births.code(coder, 0, lives[g].birth);
                let from_end = num_timesteps.wrapping_sub(lives[g].death);
                let from_end = self.deaths.code(coder, usize::from(birth > 0), from_end);
                if birth + from_end >= num_timesteps {
                    return false;
                }
                lives.0[g] = Life { birth, death: num_timesteps - from_end };
            }
            let (mut other, mut other_present) = (0, false);
            for a in 0..plan.layout.columns().len() {
                let widths = &mut shared.bit_map.widths[a];
                let before = if g > 0 { widths[g - 1] } else { 0 };
                if plan.sparse[a] {
                    let context = (a * 2 + usize::from(before > 0)) * 2 + usize::from(other_present);
                    other_present = coder.symbol(&mut self.present[context], u32::from(widths[g] > 0)) & 1 == 1;
                    if !other_present {
                        (widths[g], other) = (0, 0);
                        continue;
                    }
                }
                let model = &mut self.widths[(a * 17 + usize::from(before)) * 17 + usize::from(other)];
                widths[g] = 1 + coder.symbol(model, u32::from(widths[g]).wrapping_sub(1) & 15) as u8;
                other = if a == 0 { 0 } else { widths[g] };
            }
            let mut other = false;
            for attribute in plan.layout.attributes() {
                let a = attribute.index();
                if !plan.varies[a] {
                    continue;
                }
                let components = attribute.components();
                let moves = &mut shared.moves[a];
                if shared.bit_map.widths[a][g] == 0 {
                    moves[g * components..][..components].fill(false);
                    continue;
                }
                for channel in 0..components {
                    let at = g * components + channel;
                    if plan.joint[a] && channel > 0 {
                        moves[at] = moves[at - 1];
                        continue;
                    }
                    let before = |n: usize| usize::from(g >= n && moves[at - n * components]);
                    let context = ((a * self.components + channel) * 2 + before(1)) * 2 + before(2);
                    let model = &mut self.moves[context * 2 + usize::from(other)];
                    moves[at] = coder.symbol(model, u32::from(moves[at])) & 1 == 1;
                    other = moves[at];
                }
            }
        }
        true
    }
}

/// Models of first positions, coded as gaps along the Morton curve.
#[derive(Clone, Debug)]
pub(super) struct CurveModels {
    /// Exponent of a gap divided by 4, in the context of that of the preceding gap.
    high: Vec<SymbolModel>,
    /// Remainder of that division.
    low: Vec<SymbolModel>,
    /// Highest three bits below the leading one, by exponent.
    leading: Vec<SymbolModel>,
    exponent: usize,
}

impl CurveModels {
    pub(super) fn new() -> Self {
        Self {
            high: vec![SymbolModel::new(13); 13],
            low: vec![SymbolModel::new(4); 13],
            leading: vec![SymbolModel::new(8); 49],
            exponent: 0,
        }
    }

    /// Codes the first positions of a layer in place.
    pub(super) fn code<C: Coder>(&mut self, coder: &mut C, plan: &Plan, layer: Range<usize>, shared: &mut Shared) {
        let index = Attribute::Mean.index();
        let width = plan.quantizers.attributes[index].last_key_value().map_or(MAX_BITS, |(&width, _)| width);
        let shift = MAX_BITS - width;
        let mask = (1_u64 << (3 * width)) - 1;
        let mut before = 0;
        for g in layer {
            if coder.exhausted() {
                return;
            }
            let own_width = shared.bit_map.widths[index][g];
            let codes = &mut shared.first_codes[index][3 * g..3 * g + 3];
            let key = morton::interleave([0, 1, 2].map(|c| coordinate(codes[c], own_width) >> shift));
            let gap = self.gap(coder, key.wrapping_sub(before) & mask) & mask;
            before = before.wrapping_add(gap) & mask;
            for (code, x) in codes.iter_mut().zip(morton::deinterleave(before)) {
                let x = i32::from(x) << shift >> (MAX_BITS - own_width);
                *code = (x - (1 << (own_width - 1))) as i16;
            }
        }
    }

    fn gap<C: Coder>(&mut self, coder: &mut C, gap: u64) -> u64 {
        let exponent = u64::BITS - gap.leading_zeros();
        let high = coder.symbol(&mut self.high[self.exponent / 4], exponent / 4).min(12);
        let low = coder.symbol(&mut self.low[high as usize], exponent % 4) & 3;
        let exponent = (4 * high + low).min(48);
        self.exponent = exponent as usize;
        if exponent < 2 {
            return u64::from(exponent);
        }
        let mut bits = exponent - 1;
        let mut value = 1;
        let modelled = bits.min(3);
        bits -= modelled;
        let model = &mut self.leading[exponent as usize];
        let mask = (1 << modelled) - 1;
        value = value << modelled | u64::from(coder.symbol(model, (gap >> bits) as u32 & mask) & mask);
        while bits > 0 {
            let count = bits.min(15);
            bits -= count;
            let mask = (1_u32 << count) - 1;
            value = value << count | u64::from(coder.bits(count, (gap >> bits) as u32 & mask));
        }
        value
    }
}

/// Models of the first codes of an attribute other than means.
#[derive(Clone, Debug)]
pub(super) struct FirstModels {
    attribute: Attribute,
    /// Index of each width among the widths that have quantizers; contexts use it.
    place_of_width: [usize; 17],
    codes: Codes,
    differences: Numbers,
}

/// Number of contexts of a code by its prediction.
const NUM_BINS: usize = 16;
/// Number of contexts of a difference by the disagreement of the neighbours.
const NUM_SPREADS: usize = 8;

impl FirstModels {
    pub(super) fn new(plan: &Plan, attribute: Attribute) -> Self {
        let widths = &plan.quantizers.attributes[attribute.index()];
        let classes = attribute.components() * widths.len();
        Self {
            attribute,
            place_of_width: place_of_width(widths.keys()),
            codes: Codes::new(classes * NUM_BINS, NUM_BINS),
            differences: Numbers::new(classes * NUM_SPREADS),
        }
    }

    pub(super) fn attribute(&self) -> Attribute {
        self.attribute
    }

    /// Codes the first codes of a layer in place.
    pub(super) fn code<C: Coder>(
        &mut self,
        coder: &mut C,
        plan: &Plan,
        layer: Range<usize>,
        neighbors: &Neighbors,
        widths: &[u8],
        codes: &mut [i16],
    ) {
        let a = self.attribute.index();
        let components = self.attribute.components();
        let table = plan.quantizers.by_width(self.attribute);
        let num_widths = plan.quantizers.attributes[a].len();
        let mut features = Features::new(self.attribute);
        for g in layer {
            if coder.exhausted() {
                return;
            }
            let width = widths[g];
            if width == 0 {
                codes[g * components..][..components].fill(0);
                continue;
            }
            let quantizers = table[usize::from(width)];
            features.clear();
            let [first, second] = neighbors.of(g);
            for (place, neighbor) in [first, if second == NONE { first } else { second }].into_iter().enumerate() {
                if neighbor != NONE {
                    let neighbor = neighbor as usize;
                    let of_neighbor = table[usize::from(widths[neighbor])];
                    for (channel, quantizer) in of_neighbor.iter().enumerate() {
                        features.set_neighbor(place, channel, value(quantizer, codes[neighbor * components + channel]));
                    }
                }
            }
            let mut rest = 1.0;
            for (channel, quantizer) in quantizers.iter().enumerate() {
                let code = &mut codes[g * components + channel];
                let half = 1 << (width - 1);
                let class = channel * num_widths + self.place_of_width[usize::from(width)];
                let predictor = &plan.predictors[a][channel];
                match predictor.mode {
                    Mode::Code | Mode::Length => {
                        let near = if predictor.mode == Mode::Code {
                            nearest_code(quantizer, features.predict(&predictor.weights))
                        } else {
                            nearest_code(quantizer, f64::max(rest, 0.0).sqrt())
                        };
                        let bin = ((near + half) << 4 >> width) as usize;
                        let coded =
                            self.codes.code(coder, class * NUM_BINS + bin, width, (i32::from(*code) + half) as u32);
                        *code = (coded as i32 - half) as i16;
                    }
                    Mode::Difference => {
                        let near = nearest_code(quantizer, features.predict(&predictor.weights));
                        let [p, q] = [0, 1].map(|n| nearest_code(quantizer, features.neighbor(n, channel)));
                        let spread = (u32::BITS - p.abs_diff(q).leading_zeros()).min(NUM_SPREADS as u32 - 1) as usize;
                        let difference = zigzag(wrap(i32::from(*code) - near, width));
                        let coded = self.differences.code(coder, class * NUM_SPREADS + spread, difference);
                        *code = wrap(near + unzigzag(coded), width) as i16;
                    }
                }
                let x = value(quantizer, *code);
                rest -= x * x;
                features.push(x);
            }
        }
    }
}

/// Rank of each width among some widths, ascending.
pub(super) fn place_of_width<'a>(widths: impl Iterator<Item = &'a u8>) -> [usize; 17] {
    let mut places = [0; 17];
    for (place, &width) in widths.enumerate() {
        places[usize::from(width)] = place;
    }
    places
}

/// Largest number of features of a predictor: that of the last component of a rotation.
pub(super) const MAX_FEATURES: usize = 1 + 2 * 4 + 3;

/// Features of the linear prediction of a first value.
///
/// - attributes of [`Attribute::BASE`]: 1, all values of the nearest neighbour, all values of the second neighbour, the
///   components before
/// - other attributes, which may have many components: 1, the values of this component of the two neighbours, up to
///   [`RECENT`] components before, the earliest first
pub(super) struct Features {
    components: usize,
    is_base: bool,
    /// 1, the values of the two neighbours, the components before.
    values: [f64; 3 * MAX_COMPONENTS + 1],
    len: usize,
}

impl Features {
    pub(super) fn new(attribute: Attribute) -> Self {
        let components = attribute.components();
        let mut values = [0.0; 3 * MAX_COMPONENTS + 1];
        values[0] = 1.0;
        let is_base = !matches!(attribute, Attribute::Extra { .. });
        Self { components, is_base, values, len: 1 + 2 * components }
    }

    /// Resets the features: all values of the neighbours are 0.
    pub(super) fn clear(&mut self) {
        self.len = 1 + 2 * self.components;
        self.values[1..self.len].fill(0.0);
    }

    pub(super) fn set_neighbor(&mut self, place: usize, channel: usize, value: f64) {
        self.values[1 + place * self.components + channel] = value;
    }

    fn neighbor(&self, place: usize, channel: usize) -> f64 {
        self.values[1 + place * self.components + channel]
    }

    /// Appends the component just coded.
    pub(super) fn push(&mut self, value: f64) {
        self.values[self.len] = value;
        self.len += 1;
    }

    /// The features of the next component.
    ///
    /// - `chosen`: buffer for the features of an attribute of many components
    pub(super) fn of_next<'a>(&'a self, chosen: &'a mut [f64; MAX_FEATURES]) -> &'a [f64] {
        if self.is_base {
            return &self.values[..self.len];
        }
        let channel = self.len - 1 - 2 * self.components;
        let recent = channel.min(RECENT);
        chosen[..3].copy_from_slice(&[1.0, self.neighbor(0, channel), self.neighbor(1, channel)]);
        chosen[3..3 + recent].copy_from_slice(&self.values[self.len - recent..self.len]);
        &chosen[..3 + recent]
    }

    fn predict(&self, weights: &[f32]) -> f64 {
        let mut sum = 0.0;
        for (value, &weight) in self.of_next(&mut [0.0; MAX_FEATURES]).iter().zip(weights) {
            sum += value * f64::from(weight);
        }
        sum
    }
}

/// Value of a code in f64, not rounded to f32.
pub(super) fn value(quantizer: &Quantizer, code: i16) -> f64 {
    f64::from(code) * f64::from(quantizer.step) + f64::from(quantizer.offset)
}

/// Nearest code to a value; halves upwards.
fn nearest_code(quantizer: &Quantizer, value: f64) -> i32 {
    let code = (value - f64::from(quantizer.offset)) / f64::from(quantizer.step) + 0.5;
    floor(code.clamp(f64::from(quantizer.min_code()), f64::from(quantizer.max_code())))
}
