//! Between floats and codes of a few bits: uniform quantizers with an offset.
//!
//! A quantizer serves all values of one attribute, channel and bit width. The offset is what the
//! paper's quantizer (LSQ) lacks: colours and opacities lie to one side of zero and would waste half
//! of the signed range.

use std::collections::BTreeMap;

use tcgs_core::{Attribute, Layout};

use crate::error::CompressError;

/// Widest code.
pub const MAX_BITS: u8 = 16;

/// A uniform quantizer: code `c` stands for `c * step + offset`, `c` in
/// `[-2^(bits-1), 2^(bits-1) - 1]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantizer {
    /// Distance of neighbouring values; finite and positive.
    pub step: f32,
    /// Value of code 0; finite.
    pub offset: f32,
    /// Width of a code, 1 to 16.
    pub bits: u8,
}

/// A step is at least this fraction of the largest value, two units in its last place, so that every
/// code stands for another float and `quantize(dequantize(c)) == c`.
const MIN_RELATIVE_STEP: f64 = 1.0 / (1 << 22) as f64;
/// The step where all values are zero.
const MIN_STEP: f64 = 1e-30;
/// [`Quantizer::fit`] judges its candidates on at most this many values, evenly taken.
const FIT_SAMPLE: usize = 1 << 14;
/// Ranges that [`Quantizer::fit`] tries: the distance of each bound to the median, times a power of this.
const SHRINK: f64 = 0.87;
/// The highest power; 0.87^24 = 0.035.
const NUM_SHRINKS: usize = 25;
/// Rounds of assigning codes and solving for the best step and offset; more gained below 0.1 %.
const NUM_REFITS: usize = 8;

impl Quantizer {
    /// A quantizer of given step and offset.
    ///
    /// # Errors
    /// [`CompressError::Quantizer`] if [`Self::problem`] finds a problem.
    pub fn new(step: f32, offset: f32, bits: u8) -> Result<Self, CompressError> {
        let quantizer = Self { step, offset, bits };
        match quantizer.problem() {
            Some(problem) => Err(CompressError::Quantizer { step, offset, bits, problem }),
            None => Ok(quantizer),
        }
    }

    /// What makes these numbers no quantizer, if anything.
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

    /// Lowest code, `-2^(bits-1)`.
    #[inline(always)]
    pub fn min_code(&self) -> i32 {
        -(1 << (self.bits - 1))
    }

    /// Highest code, `2^(bits-1) - 1`.
    #[inline(always)]
    pub fn max_code(&self) -> i32 {
        (1 << (self.bits - 1)) - 1
    }

    /// Nearest code; values beyond the range get the code at its end.
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

    /// Value of a code: `code * step + offset`, rounded once.
    #[inline(always)]
    pub fn dequantize(&self, code: i32) -> f32 {
        (f64::from(code) * f64::from(self.step) + f64::from(self.offset)) as f32
    }

    /// Sum of squared errors over `values`.
    pub fn squared_error(&self, values: &[f32]) -> f64 {
        values
            .iter()
            .map(|&x| {
                let error = f64::from(x) - f64::from(self.dequantize(self.quantize(x)));
                error * error
            })
            .sum()
    }

    /// The quantizer whose lowest code is `min` and whose highest is `max`; if they are equal, code 0
    /// is exactly that value.
    ///
    /// ```
    /// let quantizer = tcgs_codec::Quantizer::covering(0.0, 15.0, 4)?;
    /// assert_eq!((quantizer.quantize(0.0), quantizer.quantize(15.0), quantizer.step), (-8, 7, 1.0));
    /// # Ok::<(), tcgs_codec::CompressError>(())
    /// ```
    ///
    /// # Errors
    /// [`CompressError`] if a bound is not finite, `min > max`, `bits` is not within 1 to 16, or the step from one end
    /// to the other exceeds what 32 bits hold.
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

    /// The quantizer of a given step whose lowest code is `min`.
    ///
    /// # Errors
    /// [`CompressError::Quantizer`] if these numbers make no quantizer.
    pub(crate) fn from_lowest(min: f32, step: f64, bits: u8) -> Result<Self, CompressError> {
        let offset = f64::from(min) + step * f64::from(1_u32 << (bits - 1));
        Self::new(step as f32, offset as f32, bits)
    }

    /// The quantizer of lowest squared error found: ranges shrunk from either side (an outlier is
    /// cut off where that makes the step finer for the rest), then least squares for step and offset.
    ///
    /// A constant set of values gets an exact quantizer. Its error over `values`, or over the even
    /// sample that it looks at when there are very many, is at most that of [`Self::covering`].
    ///
    /// # Errors
    /// [`CompressError`] if there are no values, a value is not finite, `bits` is not within 1 to 16, or the values
    /// lie further apart than 32 bits hold.
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

/// First step of a learned quantizer: `2 mean|x| / sqrt(Q_p)`, `Q_p = 2^(bits-1) - 1`.
///
/// Esser et al. 2020, §2.1. One bit has `Q_p = 0`; it counts as 1.
///
/// ```
/// assert_eq!(tcgs_codec::lsq_step(&[1.0, -3.0], 3)?, 4.0 / 3.0_f32.sqrt());
/// # Ok::<(), tcgs_codec::CompressError>(())
/// ```
///
/// # Errors
/// [`CompressError`] if there are no values or `bits` is not within 1 to 16.
pub fn lsq_step(values: &[f32], bits: u8) -> Result<f32, CompressError> {
    check_bits(bits)?;
    if values.is_empty() {
        return Err(no_values());
    }
    let mean = values.iter().map(|&x| f64::from(x.abs())).sum::<f64>() / values.len() as f64;
    let max_code = f64::from((1_u32 << (bits - 1)) - 1).max(1.0);
    Ok((2.0 * mean / max_code.sqrt()) as f32)
}

/// All quantizers of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantizers {
    /// By [`Attribute::index`], then bit width: one quantizer per channel.
    pub attributes: Vec<BTreeMap<u8, Vec<Quantizer>>>,
}

impl Default for Quantizers {
    /// None, for the columns of [`Layout::base`].
    fn default() -> Self {
        Self::none(&Layout::base())
    }
}

impl Quantizers {
    /// None yet, for the columns of `layout`.
    pub fn none(layout: &Layout) -> Self {
        Self { attributes: vec![BTreeMap::new(); layout.columns().len()] }
    }

    /// The quantizer of one channel at one width, if there is one.
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
        // Finite, but further apart than a float says.
        assert!(Quantizer::covering(f32::MIN, f32::MAX, 1).is_err());
        assert!(lsq_step(&[], 4).is_err() && lsq_step(&[1.0], 0).is_err());
    }
}
