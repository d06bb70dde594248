//! Quantisation inside the optimisation: learned step sizes (LSQ, Esser et al. 2020) and offsets.
//!
//! One step and one offset per attribute channel and bit width. Widths differ between Gaussians.

use multiversion::multiversion;
use rayon::prelude::*;
use tcgs_codec::{BitMap, BitMapping, BitSettings, CompressError, Quantizer, Quantizers};
use tcgs_core::{Attribute, Column, GaussianGrads, Gaussians, Layout};

use crate::adam::Moments;
use crate::config::{BitMapKind, TrainConfig};

/// Smallest share of its initial value to which a quantizer's step may fall.
pub(crate) const MIN_STEP_SHARE: f32 = 0.1;

/// Gaussians that one task handles; fixed, so that sums over them are.
const CHUNK: usize = 1 << 12;

/// A group of fewer Gaussians than this takes its first quantizers from the values of all Gaussians. Its own values do
/// not show where they will move, and the range of a single value would pin that value for good.
const MIN_FITTED: usize = 32;

/// Quantises and dequantises one value: the value that a decoder will read from the file.
#[inline(always)]
pub fn fake_quant(x: f32, q: &Quantizer) -> f32 {
    q.dequantize(q.quantize(x))
}

/// VJP of [`fake_quant`]: `(v_x, v_step, v_offset)`.
///
/// Straight-through: rounding is differentiated as the identity, clamping as itself. Inside the
/// range the offset cancels; beyond it the value is `step * end + offset`. Esser et al. 2020, Eq. 3
/// and 5; the offset as in LSQ+ (Bhalgat et al. 2020, Eq. 7).
///
/// - `x`: stored value
/// - `v_y`: gradient to the quantised value
/// - returns: none of them scaled; see [`step_gradient_scale`]
#[inline(always)]
pub fn fake_quant_vjp(x: f32, q: &Quantizer, v_y: f32) -> (f32, f32, f32) {
    let scaled = (x - q.offset) / q.step;
    let (low, high) = (q.min_code() as f32, q.max_code() as f32);
    if scaled <= low {
        (if scaled < low { 0.0 } else { v_y }, v_y * low, v_y)
    } else if scaled >= high {
        (if scaled > high { 0.0 } else { v_y }, v_y * high, v_y)
    } else {
        (v_y, v_y * (scaled.round() - scaled), 0.0)
    }
}

/// Scale of a step's gradient: `1 / sqrt(Q_P * numel)`, `Q_P = 2^(bits-1) - 1`. Esser et al. 2020, §2.2.
///
/// - `bits`: 1 to 16; one bit has `Q_P = 0`, which counts as 1
/// - `numel`: values of the whole tensor, all channels
pub fn step_gradient_scale(bits: u8, numel: usize) -> f32 {
    let high = f64::from((1_u32 << (bits - 1)) - 1).max(1.0);
    (1.0 / (high * numel.max(1) as f64).sqrt()) as f32
}

/// The settings of a run's mixed-precision quantisation ([`TrainConfig::quantize`]) as the codec takes them. Positions
/// have the codec's default width; they are quantised after training.
pub fn bit_settings(config: &TrainConfig) -> BitSettings {
    let q = &config.quantize;
    BitSettings {
        min_bits: q.min_bits,
        max_bits: q.max_bits,
        mean_bits: q.mean_bits,
        mapping: match q.bit_map {
            BitMapKind::Log => BitMapping::Log,
            BitMapKind::Linear => BitMapping::Linear,
        },
        ..BitSettings::default()
    }
}

/// The columns that are quantised during training. Positions and harmonics are quantised by compression. It decides on
/// the bands of each Gaussian and their bit widths, so rounding here would move zero bands away from zero.
pub(crate) fn quantized(layout: &Layout) -> impl Iterator<Item = Attribute> {
    let harmonics = layout.harmonics();
    let is_quantized = move |column: &&Column| column.quantized && !harmonics.contains(&column.attribute);
    layout.columns().iter().filter(is_quantized).map(|column| column.attribute)
}

/// The learned quantizers, and the bit width of each Gaussian's attributes, which selects a quantizer.
#[derive(Clone, Debug, PartialEq)]
pub struct FakeQuantizers {
    /// Bit width of every attribute of every Gaussian.
    pub bit_map: BitMap,
    /// The pairs of attribute and bit width that are in use. Each group has one quantizer per channel of the attribute.
    pub groups: Vec<(Attribute, u8)>,
    /// `[quantizers]`, ordered by group, then by channel.
    pub quantizers: Vec<Quantizer>,
    /// `[quantizers]`, the initial step of each quantizer, to which the learning rates are relative.
    pub initial_steps: Vec<f32>,
    /// Whether offsets are learned.
    pub learned_offset: bool,
    /// `[columns]` bit width of Gaussians that are born: the largest of any Gaussian of the first timestep. The
    /// sensitivity of their parameters is unknown.
    pub(crate) newborn_widths: Vec<u8>,
    /// By attribute and width: position of the first channel in `quantizers`.
    first: Vec<[u16; 17]>,
    /// Scale of each step's gradient.
    pub(crate) gradient_scales: Vec<f32>,
}

impl FakeQuantizers {
    /// Initial quantizers, fitted to the values that they will quantise.
    ///
    /// - `bit_map`: bit widths of `N` Gaussians
    /// - `gaussians`: `[N]`, stored form
    /// - `learned_offset`: whether offsets are learned; without them quantizers are symmetric, and their steps start
    ///   from LSQ's formula (Esser et al. 2020)
    ///
    /// # Errors
    /// [`CompressError`] if a value is not finite, or a step that covers the values of a channel is no `f32`.
    pub fn new(bit_map: BitMap, gaussians: &Gaussians, learned_offset: bool) -> Result<Self, CompressError> {
        let histogram = bit_map.histogram();
        let groups: Vec<(Attribute, u8)> = quantized(gaussians.layout())
            .flat_map(|a| histogram[a.index()].keys().map(move |&width| (a, width)))
            .collect();
        let mut quantizers = Vec::new();
        for &(attribute, width) in &groups {
            let components = attribute.components();
            let widths = &bit_map.widths[attribute.index()];
            let few = histogram[attribute.index()][&width] < MIN_FITTED;
            let values = gaussians.values(attribute);
            for channel in 0..components {
                let own: Vec<f32> = (0..widths.len())
                    .filter(|&i| few || widths[i] == width)
                    .map(|i| values[i * components + channel])
                    .collect();
                let quantizer = if learned_offset {
                    Quantizer::fit(&own, width)
                } else {
                    let step = tcgs_codec::lsq_step(&own, width)?;
                    // Not `max`, which would take the step of values that are not finite for a small one.
                    Quantizer::new(if step < 1e-6 { 1e-6 } else { step }, 0.0, width)
                };
                quantizers.push(quantizer?);
            }
        }
        let initial_steps = quantizers.iter().map(|q| q.step).collect();
        Ok(Self::restore(bit_map, groups, quantizers, initial_steps, learned_offset))
    }

    /// Quantizers of the first timestep from saved fields; the fields of this struct describe the arguments.
    ///
    /// # Panics
    /// If `quantizers` and `initial_steps` do not have one entry for each channel of each group.
    pub fn restore(
        bit_map: BitMap,
        groups: Vec<(Attribute, u8)>,
        quantizers: Vec<Quantizer>,
        initial_steps: Vec<f32>,
        learned_offset: bool,
    ) -> Self {
        let histogram = bit_map.histogram();
        let mut first = vec![[u16::MAX; 17]; bit_map.widths.len()];
        let mut gradient_scales = Vec::new();
        for &(attribute, width) in &groups {
            first[attribute.index()][usize::from(width)] = gradient_scales.len() as u16;
            let components = attribute.components();
            let count = histogram[attribute.index()].get(&width).copied().unwrap_or(0);
            gradient_scales.extend(vec![step_gradient_scale(width, count * components); components]);
        }
        assert_eq!([quantizers.len(), initial_steps.len()], [gradient_scales.len(); 2], "quantizers against groups");
        // Without Gaussians there are no widths, and any width will do.
        let largest = |widths: &Vec<u8>| widths.iter().copied().max().unwrap_or(16);
        let newborn_widths = bit_map.widths.iter().map(largest).collect();
        Self { bit_map, groups, quantizers, initial_steps, learned_offset, newborn_widths, first, gradient_scales }
    }

    /// The same quantizers for other Gaussians.
    fn set_bit_map(&mut self, bit_map: BitMap) {
        let newborn_widths = std::mem::take(&mut self.newborn_widths);
        *self = Self::restore(
            bit_map,
            std::mem::take(&mut self.groups),
            std::mem::take(&mut self.quantizers),
            std::mem::take(&mut self.initial_steps),
            self.learned_offset,
        );
        self.newborn_widths = newborn_widths;
    }

    /// Keeps the Gaussians at `indices`, in that order.
    pub fn select(&mut self, indices: &[usize]) {
        self.set_bit_map(self.bit_map.select(indices));
    }

    /// The bit map extended by Gaussians that were born; they have the largest widths of the first timestep.
    ///
    /// - `num_gaussians`: its new number of Gaussians, no smaller than the current one
    pub fn bit_map_of(&self, num_gaussians: usize) -> BitMap {
        let mut bit_map = self.bit_map.clone();
        for (widths, &largest) in bit_map.widths.iter_mut().zip(&self.newborn_widths) {
            widths.resize(num_gaussians, largest);
        }
        bit_map
    }

    /// Extends the quantizers to `count` more Gaussians, with the widths of [`Self::bit_map_of`].
    pub fn append(&mut self, count: usize) {
        self.set_bit_map(self.bit_map_of(self.bit_map.num_gaussians() + count));
    }

    /// The quantizers as the codec takes them, by attribute and bit width.
    pub fn table(&self) -> Quantizers {
        let mut table = Quantizers::none(self.bit_map.layout());
        for &(attribute, width) in &self.groups {
            let first = usize::from(self.first[attribute.index()][usize::from(width)]);
            let channels = self.quantizers[first..first + attribute.components()].to_vec();
            table.attributes[attribute.index()].insert(width, channels);
        }
        table
    }

    /// Quantised values of every attribute but the positions, which stay as they are.
    ///
    /// - `gaussians`: `[N]`, stored form
    pub fn forward(&self, gaussians: &Gaussians) -> Gaussians {
        let mut out = gaussians.clone();
        for attribute in quantized(gaussians.layout()) {
            let components = attribute.components();
            let (widths, first) = (&self.bit_map.widths[attribute.index()], &self.first[attribute.index()]);
            out.values_mut(attribute)
                .par_chunks_mut(CHUNK * components)
                .zip(widths.par_chunks(CHUNK))
                .for_each(|(rows, widths)| forward_rows(rows, components, widths, first, &self.quantizers));
        }
        out
    }

    /// Backward of [`Self::forward`]: overwrites `v_gaussians`, gradients to the quantised values, with
    /// those to the values themselves.
    ///
    /// - `gaussians`: as given to `forward`
    /// - returns: `(v_steps, v_offsets)`, each `[quantizers]`, scaled by [`step_gradient_scale`]
    pub fn backward(&self, gaussians: &Gaussians, v_gaussians: &mut GaussianGrads) -> (Vec<f32>, Vec<f32>) {
        let mut v_steps = vec![0.0_f64; self.quantizers.len()];
        let mut v_offsets = vec![0.0_f64; self.quantizers.len()];
        for attribute in quantized(gaussians.layout()) {
            let components = attribute.components();
            let (widths, first) = (&self.bit_map.widths[attribute.index()], &self.first[attribute.index()]);
            let values = gaussians.values(attribute);
            let sums: Vec<Vec<(f64, f64)>> = v_gaussians
                .values_mut(attribute)
                .par_chunks_mut(CHUNK * components)
                .zip(values.par_chunks(CHUNK * components))
                .zip(widths.par_chunks(CHUNK))
                .map(|((v_rows, rows), widths)| {
                    backward_rows(rows, components, widths, first, &self.quantizers, v_rows)
                })
                .collect();
            for chunk in sums {
                for (i, (v_step, v_offset)) in chunk.into_iter().enumerate() {
                    v_steps[i] += v_step;
                    v_offsets[i] += v_offset;
                }
            }
        }
        let scaled = |v: Vec<f64>| v.iter().zip(&self.gradient_scales).map(|(&v, &s)| v as f32 * s).collect();
        (scaled(v_steps), scaled(v_offsets))
    }

    /// One Adam step on steps and offsets, each at `rate` times its initial step. A step never falls below a tenth of
    /// its initial value.
    ///
    /// - `v_steps`, `v_offsets`: `[quantizers]`, as [`Self::backward`] returns them
    pub fn update(
        &mut self,
        v_steps: &[f32],
        v_offsets: &[f32],
        steps: &mut Moments,
        offsets: &mut Moments,
        rate: f32,
    ) {
        // Adam's update does not depend on the gradient's scale, so relative values give relative rates.
        let mut relative_steps: Vec<f32> =
            self.quantizers.iter().zip(&self.initial_steps).map(|(q, s)| q.step / s).collect();
        let mut relative_offsets: Vec<f32> =
            self.quantizers.iter().zip(&self.initial_steps).map(|(q, s)| q.offset / s).collect();
        steps.update(&mut relative_steps, v_steps, rate);
        if self.learned_offset {
            offsets.update(&mut relative_offsets, v_offsets, rate);
        }
        for (i, q) in self.quantizers.iter_mut().enumerate() {
            q.step = relative_steps[i].max(MIN_STEP_SHARE) * self.initial_steps[i];
            q.offset = relative_offsets[i] * self.initial_steps[i];
        }
    }
}

/// [`fake_quant`] of some rows of one attribute, in place. Compiled for AVX2 as well, which rounds by an instruction
/// rather than by a call; the bits are the same.
///
/// - `values`: `[rows, components]`
/// - `widths`: `[rows]`
/// - `first`: by width, position of the first channel in `quantizers`
#[multiversion(targets("x86_64+avx2"))]
fn forward_rows(values: &mut [f32], components: usize, widths: &[u8], first: &[u16; 17], quantizers: &[Quantizer]) {
    for (row, &width) in values.chunks_exact_mut(components).zip(widths) {
        let quantizers = &quantizers[usize::from(first[usize::from(width)])..];
        for (value, quantizer) in row.iter_mut().zip(quantizers) {
            *value = fake_quant(*value, quantizer);
        }
    }
}

/// [`fake_quant_vjp`] of some rows of one attribute. Overwrites `v_values`; the rest as [`forward_rows`].
///
/// - returns: `[quantizers]` sums of the gradients to steps and offsets
#[multiversion(targets("x86_64+avx2"))]
fn backward_rows(
    values: &[f32],
    components: usize,
    widths: &[u8],
    first: &[u16; 17],
    quantizers: &[Quantizer],
    v_values: &mut [f32],
) -> Vec<(f64, f64)> {
    let mut sums = vec![(0.0, 0.0); quantizers.len()];
    for ((v_row, row), &width) in v_values.chunks_exact_mut(components).zip(values.chunks_exact(components)).zip(widths)
    {
        let first = usize::from(first[usize::from(width)]);
        for (channel, (v, &x)) in v_row.iter_mut().zip(row).enumerate() {
            let (v_x, v_step, v_offset) = fake_quant_vjp(x, &quantizers[first + channel], *v);
            *v = v_x;
            sums[first + channel].0 += f64::from(v_step);
            sums[first + channel].1 += f64::from(v_offset);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Central differences of the function that straight-through differentiates: the value with its rounding error
    /// held.
    #[test]
    fn gradients_are_those_of_the_value_with_its_rounding_held() {
        let (step, offset) = (0.3, 0.1);
        let quantizer = Quantizer::new(step as f32, offset as f32, 3).unwrap();
        let (low, high) = (f64::from(quantizer.min_code()), f64::from(quantizer.max_code()));
        for x in [-3.0, -1.2, -0.85, -0.2, 0.0, 0.13, 0.5, 0.7, 1.4, 9.0] {
            let scaled: f64 = (x - offset) / step;
            let rounding = scaled.round() - scaled;
            let held = |x: f64, step: f64, offset: f64| {
                let scaled = (x - offset) / step;
                let code = if (low..=high).contains(&scaled) { scaled + rounding } else { scaled.clamp(low, high) };
                code * step + offset
            };
            let slope = |at: &dyn Fn(f64) -> f64| 0.5 * (at(1e-6) - at(-1e-6)) / 1e-6;
            let expected = [
                slope(&|h| held(x + h, step, offset)),
                slope(&|h| held(x, step + h, offset)),
                slope(&|h| held(x, step, offset + h)),
            ];
            let (v_x, v_step, v_offset) = fake_quant_vjp(x as f32, &quantizer, 2.0);
            for (found, expected) in [v_x, v_step, v_offset].into_iter().zip(expected) {
                assert!((f64::from(found) - 2.0 * expected).abs() < 1e-4, "{x}: {found}, expected {}", 2.0 * expected);
            }
        }
    }

    #[test]
    fn the_newborn_have_the_largest_width_even_when_all_others_that_had_it_died() {
        let mut bit_map = BitMap::uniform(3, 16, 4);
        bit_map.widths[Attribute::LogScale.index()][1] = 8;
        let mut quantizers = FakeQuantizers::new(bit_map.clone(), &Gaussians::zeros(3), true).unwrap();
        quantizers.select(&[0, 2]);
        quantizers.append(2);
        let widths = |attribute: Attribute| &quantizers.bit_map.widths[attribute.index()];
        assert_eq!(widths(Attribute::LogScale), &[4, 4, 8, 8]);
        assert_eq!((widths(Attribute::Color), widths(Attribute::Mean)), (&vec![4; 4], &vec![16; 4]));
        // As from the initial quantizers and all identities.
        let first = FakeQuantizers::new(bit_map, &Gaussians::zeros(3), true).unwrap();
        assert_eq!(quantizers.bit_map, first.bit_map_of(5).select(&[0, 2, 3, 4]));
    }

    #[test]
    fn the_range_of_a_lone_gaussian_is_that_of_all() {
        let mut gaussians = Gaussians::zeros(100);
        gaussians.colors_mut().iter_mut().enumerate().for_each(|(i, color)| *color = [i as f32 / 100.0; 3]);
        let mut bit_map = BitMap::uniform(100, 16, 4);
        bit_map.widths[Attribute::Color.index()][50] = 8;
        let table = FakeQuantizers::new(bit_map, &gaussians, true).unwrap().table();
        let quantizer = table.get(Attribute::Color, 8, 0).expect("a width in use");
        assert!((fake_quant(0.1, quantizer) - 0.1).abs() < 0.01 && (fake_quant(0.9, quantizer) - 0.9).abs() < 0.01);
    }

    #[test]
    fn values_that_no_quantizer_holds_are_an_error() {
        let new = |value: f32, bits, learned_offset| {
            let mut gaussians = Gaussians::zeros(40);
            gaussians.colors_mut()[0] = [value; 3];
            gaussians.colors_mut()[1] = [-value; 3];
            FakeQuantizers::new(BitMap::uniform(40, 16, bits), &gaussians, learned_offset)
        };
        assert!(new(1.0, 4, true).is_ok() && new(1.0, 4, false).is_ok());
        for value in [f32::NAN, f32::INFINITY] {
            assert!(new(value, 4, true).is_err() && new(value, 4, false).is_err(), "{value}");
        }
        assert!(new(f32::MAX, 1, true).is_err(), "its step is no f32");
    }
}
