//! The shared layers (`docs/FORMAT.md`, "Shared layers"), which all segments need: widths, which tracks move, and the
//! first code of every track.

use std::ops::Range;

use tcgs_core::Attribute;

use super::coder::{Coder, SymbolModel};
use super::neighbors::{NONE, Neighbors};
use super::number::{Codes, Numbers, floor, unzigzag, wrap, zigzag};
use crate::bits::BitMap;
use crate::morton;
use crate::quantize::{MAX_BITS, Quantizer, Quantizers};

/// Most components of a column of version 1 of the format, those of a rotation.
pub(super) const MAX_COMPONENTS: usize = 4;

const _: () = {
    let mut index = 0;
    while index < Attribute::BASE.len() {
        assert!(Attribute::BASE[index].components() <= MAX_COMPONENTS, "a column of version 1 of more components");
        index += 1;
    }
};

/// How a scene's tracks are described, the same for all layers.
#[derive(Clone, Debug, Default)]
pub(super) struct Plan {
    /// Whether an attribute varies with time.
    pub(super) varies: [bool; 5],
    /// Whether the components of an attribute share their keypoint times.
    pub(super) joint: [bool; 5],
    pub(super) quantizers: Quantizers,
    /// By attribute: how first codes are predicted.
    pub(super) predictors: [Vec<Predictor>; 5],
}

impl Plan {
    /// Components of a unit of an attribute: those that share their times.
    pub(super) fn channels(&self, attribute: Attribute) -> usize {
        if self.joint[attribute.index()] { attribute.components() } else { 1 }
    }

    /// Memory that a Gaussian takes in what all segments share.
    pub(super) fn bytes_per_gaussian(&self) -> usize {
        let attributes = Attribute::BASE.map(|attribute| {
            let components = attribute.components();
            let varying = components * size_of::<bool>() + components / self.channels(attribute) * size_of::<u32>();
            let varies = usize::from(self.varies[attribute.index()]);
            size_of::<u8>() + components * size_of::<i16>() + varies * varying
        });
        attributes.into_iter().sum::<usize>() + Neighbors::BYTES_PER_GAUSSIAN
    }
}

/// How the first codes of a component are coded.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Predictor {
    pub(super) mode: Mode,
    /// Weights of the features: 1, the values of the nearest neighbour, the values of the second neighbour, the
    /// components before.
    pub(super) weights: Vec<f32>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Mode {
    /// The code, in the context of its prediction.
    #[default]
    Code = 0,
    /// The difference to its prediction.
    Difference = 1,
    /// The code, in the context of the length that the components before leave of one.
    Length = 2,
}

impl Mode {
    pub(super) const ALL: [Self; 3] = [Self::Code, Self::Difference, Self::Length];
}

/// Weights of a component's predictor.
pub(super) fn num_weights(components: usize, channel: usize) -> usize {
    1 + 2 * components + channel
}

/// First codes and what is needed to read them, of the layers so far.
#[derive(Clone, Debug, Default)]
pub(super) struct Shared {
    pub(super) bit_map: BitMap,
    /// By attribute, `[N * components]`: whether a track has more than one keypoint.
    pub(super) moves: [Vec<bool>; 5],
    /// By attribute, `[N * components]`
    pub(super) first_codes: [Vec<i16>; 5],
    /// By attribute, for each Gaussian, or for each of its tracks where components do not share their
    /// times: which of the units that move it is; [`NONE`] if it does not.
    pub(super) units: [Vec<u32>; 5],
    pub(super) num_units: [u32; 5],
    pub(super) neighbors: Neighbors,
}

impl Shared {
    /// Number of Gaussians of the layers that were read so far.
    pub(super) fn num_gaussians(&self) -> usize {
        self.bit_map.num_gaussians()
    }

    /// Extends all arrays to the Gaussians of a layer.
    pub(super) fn extend(&mut self, plan: &Plan, layer: &Range<usize>) {
        for attribute in Attribute::BASE {
            let (a, components) = (attribute.index(), attribute.components());
            self.bit_map.widths[a].resize(layer.end, 1);
            self.first_codes[a].resize(layer.end * components, 0);
            if plan.varies[a] {
                self.moves[a].resize(layer.end * components, false);
            }
        }
    }

    /// Counts the units of a layer that move.
    pub(super) fn count_units(&mut self, plan: &Plan, layer: &Range<usize>) {
        for attribute in Attribute::BASE {
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

    /// The nearest two of a Gaussian's neighbours.
    pub(super) fn neighbors(&self, gaussian: usize) -> [u32; 2] {
        self.neighbors.of(gaussian)
    }

    /// First positions of a layer as 16-bit coordinates, whatever their widths.
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

/// Models of widths and of which tracks move.
#[derive(Debug)]
pub(super) struct MapModels {
    widths: Vec<SymbolModel>,
    moves: Vec<SymbolModel>,
}

impl MapModels {
    pub(super) fn new() -> Self {
        Self {
            widths: vec![SymbolModel::new(16); Attribute::BASE.len() * 17 * 17],
            moves: vec![SymbolModel::new(2); Attribute::BASE.len() * MAX_COMPONENTS * 8],
        }
    }

    /// Codes widths and moves of a layer in place; their arrays reach to its end.
    pub(super) fn code<C: Coder>(&mut self, coder: &mut C, plan: &Plan, layer: Range<usize>, shared: &mut Shared) {
        for g in layer {
            if coder.exhausted() {
                return;
            }
            let mut other = 0;
            for a in 0..Attribute::BASE.len() {
                let widths = &mut shared.bit_map.widths[a];
                let before = if g > 0 { widths[g - 1] } else { 0 };
                let model = &mut self.widths[(a * 17 + usize::from(before)) * 17 + usize::from(other)];
                widths[g] = 1 + coder.symbol(model, u32::from(widths[g]).wrapping_sub(1) & 15) as u8;
                other = if a == 0 { 0 } else { widths[g] };
            }
            let mut other = false;
            for attribute in Attribute::BASE {
                let a = attribute.index();
                if !plan.varies[a] {
                    continue;
                }
                let components = attribute.components();
                let moves = &mut shared.moves[a];
                for channel in 0..components {
                    let at = g * components + channel;
                    if plan.joint[a] && channel > 0 {
                        moves[at] = moves[at - 1];
                        continue;
                    }
                    let before = |n: usize| usize::from(g >= n && moves[at - n * components]);
                    let context = ((a * MAX_COMPONENTS + channel) * 2 + before(1)) * 2 + before(2);
                    let model = &mut self.moves[context * 2 + usize::from(other)];
                    moves[at] = coder.symbol(model, u32::from(moves[at])) & 1 == 1;
                    other = moves[at];
                }
            }
        }
    }
}

/// Models of first positions, as steps along the curve.
#[derive(Debug)]
pub(super) struct CurveModels {
    /// Exponent of a gap, divided by 4, after the one before.
    high: Vec<SymbolModel>,
    /// The rest of it.
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
#[derive(Debug)]
pub(super) struct FirstModels {
    attribute: Attribute,
    codes: Codes,
    differences: Numbers,
}

/// Contexts of a code by its prediction.
const NUM_BINS: usize = 16;
/// Contexts of a difference by how much the neighbours disagree.
const NUM_SPREADS: usize = 8;

impl FirstModels {
    pub(super) fn new(attribute: Attribute) -> Self {
        let classes = attribute.components() * 17;
        Self {
            attribute,
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
        for g in layer {
            if coder.exhausted() {
                return;
            }
            let width = widths[g];
            let quantizers = table[usize::from(width)];
            let mut features = Features::new(components);
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
                let class = channel * 17 + usize::from(width);
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

/// Features of the linear prediction of a first value.
pub(super) struct Features {
    components: usize,
    values: [f64; 3 * MAX_COMPONENTS + 1],
    len: usize,
}

impl Features {
    pub(super) fn new(components: usize) -> Self {
        let mut values = [0.0; 3 * MAX_COMPONENTS + 1];
        values[0] = 1.0;
        Self { components, values, len: 1 + 2 * components }
    }

    pub(super) fn set_neighbor(&mut self, place: usize, channel: usize, value: f64) {
        self.values[1 + place * self.components + channel] = value;
    }

    fn neighbor(&self, place: usize, channel: usize) -> f64 {
        self.values[1 + place * self.components + channel]
    }

    /// The component just coded.
    pub(super) fn push(&mut self, value: f64) {
        self.values[self.len] = value;
        self.len += 1;
    }

    pub(super) fn values(&self) -> &[f64] {
        &self.values[..self.len]
    }

    fn predict(&self, weights: &[f32]) -> f64 {
        let mut sum = 0.0;
        for (value, &weight) in self.values().iter().zip(weights) {
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
