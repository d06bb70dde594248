//! Uniform quantizers with an offset, which convert between floats and codes of 1 to 16 bits.
//!
//! One quantizer serves all values of one attribute, component and bit width. The paper's quantizer (LSQ, Esser et al.
//! 2020) has no offset; colours and opacities lie on one side of zero and would leave half of its signed range unused.
//! The width of each Gaussian is the subject of `bits`; training through a quantizer lives in the crate `tcgs-train`.

use std::collections::BTreeMap;

use tcgs_core::{Attribute, Layout};

use crate::error::CompressError;

/// Largest width of a code, in bits.
pub const MAX_BITS: u8 = 16;

/// A uniform quantizer: code `c` stands for `c * step + offset`, `c` in
/// `[-2^(bits-1), 2^(bits-1) - 1]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantizer {
    /// Distance between the values of neighbouring codes, in the unit of the attribute; finite and positive.
    pub step: f32,
    /// Value of code 0, in the unit of the attribute; finite.
    pub offset: f32,
    /// Width of a code in bits, 1 to 16.
    pub bits: u8,
}

/// Least step relative to the largest value: two units in its last place, so that every code stands for a different
/// float and `quantize(dequantize(c)) == c`.
const MIN_RELATIVE_STEP: f64 = 1.0 / (1 << 22) as f64;
/// The step if all values are zero.
const MIN_STEP: f64 = 1e-30;
/// Largest number of values on which [`Quantizer::fit`] judges its candidates, evenly sampled.
const FIT_SAMPLE: usize = 1 << 14;
/// Base of the ranges that [`Quantizer::fit`] tries: the distance of each bound to the median, times a power of this.
const SHRINK: f64 = 0.87;
/// Number of powers; the highest is 0.87^24 = 0.035.
const NUM_SHRINKS: usize = 25;
/// Rounds of assigning codes and solving for the best step and offset; more rounds gained below 0.1 %.
const NUM_REFITS: usize = 8;

impl Quantizer {
    /// A quantizer of a given step, offset (both in the unit of the attribute) and width in bits.
    ///
    /// # Errors
    /// [`CompressError::Quantizer`] if [`Self::problem`] finds a broken rule.
    pub fn new(step: f32, offset: f32, bits: u8) -> Result<Self, CompressError> {
        let quantizer = Self { step, offset, bits };
        match quantizer.problem() {
            Some(problem) => Err(CompressError::Quantizer { step, offset, bits, problem }),
            None => Ok(quantizer),
        }
    }

    /// The rule that the fields break: step positive and finite, offset finite, width within 1 to 16 bits. `None` if
    /// they break no rule.
    pub fn problem(&self) -> Option<&'static str> {
        if !(1..=MAX_BITS).contains(&self.bits) {
            Some("the width is not within 1 to 16 bits")
        } else if !(self.step.is_finite() && self.step > 0.0) {
            Some("the step is not a positive finite number")
        } else if !self.offset.is_finite() {
            Some("the offset is not finite")
        } else {
            None
        }
    }

    /// Smallest code, `-2^(bits-1)`.
    #[inline(always)]
    pub fn min_code(&self) -> i32 {
        -(1 << (self.bits - 1))
    }

    /// Largest code, `2^(bits-1) - 1`.
    #[inline(always)]
    pub fn max_code(&self) -> i32 {
        (1 << (self.bits - 1)) - 1
    }

    /// Code whose value is nearest to `x`; a tie rounds away from code 0. A value outside the range of the codes gets
    /// the smallest or the largest code.
    ///
    /// ```
    /// let quantizer = tcgs_codec::Quantizer::new(0.5, 1.0, 4)?;
    /// assert_eq!((quantizer.quantize(2.1), quantizer.quantize(100.0)), (2, 7));
    /// assert_eq!(quantizer.dequantize(2), 2.0);
    /// # Ok::<(), tcgs_codec::CompressError>(())
    /// ```
    #[inline(always)]
    pub fn quantize(&self, x: f32) -> i32 {
        let code = ((f64::from(x) - f64::from(self.offset)) / f64::from(self.step)).round();
        code.clamp(f64::from(self.min_code()), f64::from(self.max_code())) as i32
    }

    /// Value of a code: `code * step + offset` computed in f64 and rounded once to f32.
    #[inline(always)]
    pub fn dequantize(&self, code: i32) -> f32 {
        (f64::from(code) * f64::from(self.step) + f64::from(self.offset)) as f32
    }

    /// Sum of squared errors over `values` after `quantize` and `dequantize`, in the squared unit of the attribute.
    pub fn squared_error(&self, values: &[f32]) -> f64 {
        values
            .iter()
            .map(|&x| {
                let error = f64::from(x) - f64::from(self.dequantize(self.quantize(x)));
                error * error
            })
            .sum()
    }

    /// The quantizer whose smallest code has the value `min` and whose largest code has the value `max`. If `min` and
    /// `max` are equal, code 0 has exactly that value.
    ///
    /// ```
    /// let quantizer = tcgs_codec::Quantizer::covering(0.0, 15.0, 4)?;
    /// assert_eq!((quantizer.quantize(0.0), quantizer.quantize(15.0), quantizer.step), (-8, 7, 1.0));
    /// # Ok::<(), tcgs_codec::CompressError>(())
    /// ```
    ///
    /// # Errors
    /// [`CompressError::Value`] if a bound is not finite, `min > max`, or `bits` is not within 1 to 16;
    /// [`CompressError::Quantizer`] if the step or the offset overflows an `f32`.
    pub fn covering(min: f32, max: f32, bits: u8) -> Result<Self, CompressError> {
        check_finite("lower bound of a quantizer", min)?;
        check_finite("upper bound of a quantizer", max)?;
        if min > max {
            let (what, expected) = ("upper bound of a quantizer", "at least the lower bound");
            return Err(CompressError::Value { what, found: max.into(), expected });
        }
        check_bits(bits)?;
        let smallest = (f64::from(min.abs().max(max.abs())) * MIN_RELATIVE_STEP).max(MIN_STEP);
        let levels = f64::from((1_u32 << bits) - 1);
        let step = ((f64::from(max) - f64::from(min)) / levels).max(smallest);
        let offset = if min == max { f64::from(min) } else { f64::from(min) + step * f64::from(1_u32 << (bits - 1)) };
        Self::new(step as f32, offset as f32, bits)
    }

    /// The quantizer of a given step whose smallest code has the value `min`.
    ///
    /// # Errors
    /// [`CompressError::Quantizer`] if step, offset and width break a rule of [`Self::problem`].
    pub(crate) fn from_lowest(min: f32, step: f64, bits: u8) -> Result<Self, CompressError> {
        let offset = f64::from(min) + step * f64::from(1_u32 << (bits - 1));
        Self::new(step as f32, offset as f32, bits)
    }

    /// A quantizer of small squared error over `values`.
    ///
    /// The search starts from [`Self::covering`]. It shrinks the range from either end, which clips outliers; this pays
    /// where the finer step for the other values outweighs the clipping. Then it alternates between assigning codes and
    /// solving for the step and offset of least squares.
    ///
    /// - `values`: in the unit of the attribute; of more than 16,384 values an evenly spaced sample is used
    /// - returns: a quantizer whose squared error over the values used is at most that of [`Self::covering`], and zero
    ///   if all values are equal
    ///
    /// ```
    /// use tcgs_codec::Quantizer;
    /// let mut values: Vec<f32> = (0..1000).map(|i| i as f32 / 1000.0).collect();
    /// values.push(30.0); // an outlier
    /// let (fitted, covering) = (Quantizer::fit(&values, 4)?, Quantizer::covering(0.0, 30.0, 4)?);
    /// assert!(fitted.squared_error(&values) <= covering.squared_error(&values));
    /// # Ok::<(), tcgs_codec::CompressError>(())
    /// ```
    ///
    /// # Errors
    /// [`CompressError::Count`] if `values` is empty; [`CompressError::Value`] if a value is not finite or `bits` is
    /// not within 1 to 16; [`CompressError::Quantizer`] if the range of the values overflows an `f32`.
    pub fn fit(values: &[f32], bits: u8) -> Result<Self, CompressError> {
        let (min, max) = bounds(values)?;
        let covering = Self::covering(min, max, bits)?;
        if min == max {
            return Ok(covering);
        }
        let mut sample: Vec<f32> = values.iter().step_by(values.len().div_ceil(FIT_SAMPLE)).copied().collect();
        let middle = sample.len() / 2;
        let median = f64::from(*sample.select_nth_unstable_by(middle, f32::total_cmp).1);
        let bound = |end: f32, power: usize| (median + (f64::from(end) - median) * SHRINK.powi(power as i32)) as f32;

        let mut best = (covering.squared_error(&sample), covering);
        let mut powers = (0, 0);
        // Both ends together, then each alone twice.
        for pass in 0..5 {
            let start = powers;
            for power in 0..NUM_SHRINKS {
                let (low, high) = match pass {
                    0 => (power, power),
                    1 | 3 => (power, start.1),
                    _ => (start.0, power),
                };
                let (low_bound, high_bound) = (bound(min, low), bound(max, high));
                if low_bound < high_bound {
                    let candidate = Self::covering(low_bound, high_bound, bits)?;
                    let error = candidate.squared_error(&sample);
                    if error < best.0 {
                        best = (error, candidate);
                        powers = (low, high);
                    }
                }
            }
        }
        for _ in 0..NUM_REFITS {
            let Some(refitted) = best.1.refitted(&sample) else { break };
            let error = refitted.squared_error(&sample);
            if error >= best.0 {
                break;
            }
            best = (error, refitted);
        }
        Ok(best.1)
    }

    /// Step and offset of least squared error for the codes that `self` gives to `values`.
    fn refitted(&self, values: &[f32]) -> Option<Self> {
        let count = values.len() as f64;
        let [mut sum_c, mut sum_x, mut sum_cc, mut sum_cx] = [0.0; 4];
        for &x in values {
            let (c, x) = (f64::from(self.quantize(x)), f64::from(x));
            sum_c += c;
            sum_x += x;
            sum_cc += c * c;
            sum_cx += c * x;
        }
        let step = (count * sum_cx - sum_c * sum_x) / (count * sum_cc - sum_c * sum_c);
        let offset = (sum_x - step * sum_c) / count;
        let smallest = offset.abs().max(step * f64::from(1_u32 << self.bits)) * MIN_RELATIVE_STEP;
        (step >= smallest.max(MIN_STEP))
            .then_some(Self { step: step as f32, offset: offset as f32, bits: self.bits })
            .filter(|q| q.problem().is_none())
    }
}

/// Smallest and largest of some values.
fn bounds(values: &[f32]) -> Result<(f32, f32), CompressError> {
    let first = *values.first().ok_or_else(no_values)?;
    values.iter().try_fold((first, first), |(min, max), &x| {
        check_finite("value to fit a quantizer to", x).map(|()| (min.min(x), max.max(x)))
    })
}

fn no_values() -> CompressError {
    CompressError::Count { what: "values to fit a quantizer to".into(), found: 0, expected: 1 }
}

fn check_finite(what: &'static str, x: f32) -> Result<(), CompressError> {
    if x.is_finite() {
        Ok(())
    } else {
        Err(CompressError::Value { what, found: x.into(), expected: "a finite number" })
    }
}

/// Refuses a width of codes that is not within 1 to [`MAX_BITS`].
pub(crate) fn check_bits(bits: u8) -> Result<(), CompressError> {
    if (1..=MAX_BITS).contains(&bits) {
        Ok(())
    } else {
        Err(CompressError::Value { what: "width of codes in bits", found: bits.into(), expected: "1 to 16" })
    }
}

/// Initial step of a learned quantizer (LSQ): `2 mean|x| / sqrt(Q_p)` with `Q_p = 2^(bits-1) - 1`.
///
/// - `values`: `x`, at least one value
/// - `bits`: width of a code, 1 to 16
/// - returns: step in the unit of `values`
///
/// Esser et al. 2020, §2.1. One bit gives `Q_p = 0`, which counts as 1.
///
/// ```
/// assert_eq!(tcgs_codec::lsq_step(&[1.0, -3.0], 3)?, 4.0 / 3.0_f32.sqrt());
/// # Ok::<(), tcgs_codec::CompressError>(())
/// ```
///
/// # Errors
/// [`CompressError::Count`] if `values` is empty; [`CompressError::Value`] if `bits` is not within 1 to 16.
pub fn lsq_step(values: &[f32], bits: u8) -> Result<f32, CompressError> {
    check_bits(bits)?;
    if values.is_empty() {
        return Err(no_values());
    }
    let mean = values.iter().map(|&x| f64::from(x.abs())).sum::<f64>() / values.len() as f64;
    let max_code = f64::from((1_u32 << (bits - 1)) - 1).max(1.0);
    Ok((2.0 * mean / max_code.sqrt()) as f32)
}

/// All quantizers of a scene: one for every attribute, width in use and component.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantizers {
    /// By [`Attribute::index`], then by bit width: `[components]` quantizers.
    pub attributes: Vec<BTreeMap<u8, Vec<Quantizer>>>,
}

impl Default for Quantizers {
    /// No quantizers, for the columns of [`Layout::base`].
    fn default() -> Self {
        Self::none(&Layout::base())
    }
}

impl Quantizers {
    /// No quantizers, for the columns of `layout`; [`Self::attributes`] is filled by the caller.
    pub fn none(layout: &Layout) -> Self {
        Self { attributes: vec![BTreeMap::new(); layout.columns().len()] }
    }

    /// The quantizer of component `channel` of an attribute at a width in bits; `None` if the width is not in use.
    pub fn get(&self, attribute: Attribute, width: u8, channel: usize) -> Option<&Quantizer> {
        self.attributes.get(attribute.index())?.get(&width)?.get(channel)
    }

    /// The quantizers of all channels, by width from 0; empty where a width is not in use.
    pub(crate) fn by_width(&self, attribute: Attribute) -> [&[Quantizer]; MAX_BITS as usize + 1] {
        std::array::from_fn(|width| {
            self.attributes[attribute.index()].get(&(width as u8)).map_or(&[][..], Vec::as_slice)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn covering_reaches_both_ends() {
        for bits in 1..=16 {
            let q = Quantizer::covering(-3.0, 5.0, bits).unwrap();
            assert_eq!((q.quantize(-3.0), q.quantize(5.0)), (q.min_code(), q.max_code()), "{bits} bits");
            assert!((q.dequantize(q.min_code()) + 3.0).abs() < 1e-6);
            assert!((q.dequantize(q.max_code()) - 5.0).abs() < 1e-6 * 5.0);
        }
    }

    #[test]
    fn constant_values_are_exact() {
        for value in [0.0, 0.1, -7.3e4, 1e-20] {
            for q in [Quantizer::fit(&[value; 9], 4), Quantizer::covering(value, value, 16)].map(Result::unwrap) {
                assert_eq!((q.quantize(value), q.dequantize(0)), (0, value));
            }
        }
    }

    #[test]
    fn fitting_cuts_an_outlier_off() {
        let mut values: Vec<f32> = (0..10_000).map(|i| i as f32 / 10_000.0).collect();
        values.push(4.0);
        let (fitted, covering) = (Quantizer::fit(&values, 4).unwrap(), Quantizer::covering(0.0, 4.0, 4).unwrap());
        assert!(fitted.squared_error(&values) < 0.5 * covering.squared_error(&values));
    }

    #[test]
    fn fitting_finds_a_lattice() {
        let lattice = Quantizer::new(0.37, 2.0, 4).unwrap();
        let values: Vec<f32> = (0..160).map(|i| lattice.dequantize(i % 16 - 8)).collect();
        assert!(Quantizer::fit(&values, 4).unwrap().squared_error(&values) < 1e-9);
    }

    #[test]
    fn the_first_learned_step_is_that_of_the_formula() {
        assert_eq!(lsq_step(&[-2.0, 2.0, 4.0, 0.0], 8).unwrap(), (4.0 / 127.0_f64.sqrt()) as f32);
        assert_eq!(lsq_step(&[1.0], 1).unwrap(), 2.0);
    }

    #[test]
    fn what_makes_no_quantizer_is_refused() {
        let says = |result: Result<Quantizer, CompressError>, message: &str| {
            assert_eq!(result.unwrap_err().to_string(), message);
        };
        let message = "invalid quantizer of step 0, offset 1 and 4 bits: the step is not a positive finite number";
        says(Quantizer::new(0.0, 1.0, 4), message);
        let message = "invalid upper bound of a quantizer: found -1, expected at least the lower bound";
        says(Quantizer::covering(0.0, -1.0, 4), message);
        says(
            Quantizer::covering(f32::NAN, 0.0, 4),
            "invalid lower bound of a quantizer: found NaN, expected a finite number",
        );
        says(Quantizer::covering(0.0, 1.0, 17), "invalid width of codes in bits: found 17, expected 1 to 16");
        says(Quantizer::fit(&[], 4), "invalid number of values to fit a quantizer to: found 0, expected 1");
        let message = "invalid value to fit a quantizer to: found inf, expected a finite number";
        says(Quantizer::fit(&[0.0, f32::INFINITY], 4), message);
        // Both bounds are finite, but their distance overflows a float.
        assert!(Quantizer::covering(f32::MIN, f32::MAX, 1).is_err());
        assert!(lsq_step(&[], 4).is_err() && lsq_step(&[1.0], 0).is_err());
    }
}
