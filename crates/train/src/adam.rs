//! Adam (Kingma and Ba 2015) on flat arrays: its moments, and one update.

use rayon::prelude::*;

use crate::row::Row;

/// Decay of the first moments.
pub(crate) const BETA1: f32 = 0.9;
/// Decay of the second moments.
pub(crate) const BETA2: f32 = 0.999;
/// Adam's ε, added to the root of the second moment. Reference: far below any gradient, so that the step does not
/// depend on the loss's scale.
pub(crate) const EPSILON: f32 = 1e-15;
/// Values that one task updates.
const CHUNK: usize = 1 << 14;

/// Moments of a group of parameters that are no columns of Gaussians.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Moments {
    /// `[values]` running mean of the gradient.
    pub first: Vec<f32>,
    /// `[values]` running mean of its square.
    pub second: Vec<f32>,
    /// Number of updates so far.
    pub step: u64,
}

impl Moments {
    /// Zero moments for `len` values.
    pub fn new(len: usize) -> Self {
        Self { first: vec![0.0; len], second: vec![0.0; len], step: 0 }
    }

    /// Sets the moments to zero.
    ///
    /// - `count_too`: whether to set the count of updates to zero as well. The reference keeps the count at every
    ///   timestep: the bias is then no longer corrected, and the first step is about 3.2 times the rate.
    pub fn clear(&mut self, count_too: bool) {
        if count_too {
            self.step = 0;
        }
        self.first.fill(0.0);
        self.second.fill(0.0);
    }

    /// Reorders the moments as `rows` says, with one value per Gaussian. The moments of a new Gaussian are zero.
    pub fn gather(&mut self, rows: &[Row]) {
        let take = |values: &[f32]| rows.iter().map(|row| row.kept().map_or(0.0, |i| values[i])).collect();
        (self.first, self.second) = (take(&self.first), take(&self.second));
    }

    /// One update of the first values along `v_values`; see [`adam`].
    ///
    /// # Panics
    /// If lengths differ, or there are fewer moments.
    pub fn update(&mut self, values: &mut [f32], v_values: &[f32], rate: f32) {
        let (first, second) = (&mut self.first[..values.len()], &mut self.second[..values.len()]);
        adam(values, v_values, first, second, &mut self.step, rate, EPSILON);
    }
}

/// Adam's factors of update number `count`: the step size `rate / (1 − β1ᵗ)`, and the bias correction of the second
/// moment's root, `1 / √(1 − β2ᵗ)`.
///
/// - `rate`: learning rate
/// - `count`: `t`, updates including this one, from 1
pub(crate) fn adam_factors(rate: f32, count: u64) -> [f32; 2] {
    let t = i32::try_from(count).unwrap_or(i32::MAX);
    [rate / (1.0 - BETA1.powi(t)), 1.0 / (1.0 - BETA2.powi(t)).sqrt()]
}

/// One update of `values` along `v_values`: Kingma and Ba 2015, Algorithm 1, in the form in which `ε` is added after
/// the bias correction. A rate of 0 only counts.
///
/// - `values`: `[values]`, updated in place
/// - `v_values`: `[values]`, their gradient
/// - `first`, `second`: `[values]`, running means of the gradient and of its square, updated in place
/// - `step`: updates so far, counted on
/// - `epsilon`: `ε`
///
/// # Panics
/// If lengths differ.
pub fn adam(
    values: &mut [f32],
    v_values: &[f32],
    first: &mut [f32],
    second: &mut [f32],
    step: &mut u64,
    rate: f32,
    epsilon: f32,
) {
    assert_eq!(
        [values.len(), v_values.len(), second.len()],
        [first.len(); 3],
        "values and gradients against the moments"
    );
    *step += 1;
    if rate == 0.0 {
        return;
    }
    let [step_size, correction] = adam_factors(rate, *step);
    (
        values.par_chunks_mut(CHUNK),
        v_values.par_chunks(CHUNK),
        first.par_chunks_mut(CHUNK),
        second.par_chunks_mut(CHUNK),
    )
        .into_par_iter()
        .for_each(|(values, v_values, first, second)| {
            for (((x, &v), m), s) in values.iter_mut().zip(v_values).zip(first).zip(second) {
                *m = BETA1 * *m + (1.0 - BETA1) * v;
                *s = BETA2 * *s + (1.0 - BETA2) * v * v;
                *x -= step_size * *m / (s.sqrt() * correction + epsilon);
            }
        });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_is_the_rate_and_a_cleared_one_larger() {
        let mut moments = Moments::new(2);
        let mut x = [1.0, 1.0];
        moments.update(&mut x, &[1e-6, -3.0], 0.1);
        assert!((x[0] - 0.9).abs() < 1e-6 && (x[1] - 1.1).abs() < 1e-6);
        moments.step = 10_000;
        moments.clear(false);
        let before = x[0];
        moments.update(&mut x, &[1.0, 0.0], 0.1);
        assert!(((before - x[0]) / 0.1 - (1.0 - BETA1) / (1.0 - BETA2).sqrt()).abs() < 1e-3);
    }
}
