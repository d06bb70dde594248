//! Adam (Kingma and Ba 2015) on flat arrays.

use rayon::prelude::*;

use crate::engine::constants::{ADAM_EPSILON, BETA1, BETA2, adam_factors};

/// Values that one task updates.
const CHUNK: usize = 1 << 14;

/// Moments of one group of parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Moments {
    /// `[values]` running mean of the gradient.
    pub first: Vec<f32>,
    /// `[values]` running mean of its square.
    pub second: Vec<f32>,
    /// Updates so far.
    pub step: u64,
}

impl Moments {
    /// Zero moments for `len` values.
    pub fn new(len: usize) -> Self {
        Self { first: vec![0.0; len], second: vec![0.0; len], step: 0 }
    }

    /// Forgets the moments, and the count only if asked to. The reference keeps the count at every
    /// timestep: the bias is then no longer corrected, and the first step is about 3.2 times the rate.
    pub fn clear(&mut self, count_too: bool) {
        if count_too {
            self.step = 0;
        }
        self.first.fill(0.0);
        self.second.fill(0.0);
    }

    /// Moments of rows taken from `sources`; a row marked as fresh starts from zero.
    ///
    /// - `components`: values of a row
    pub fn gather(&mut self, sources: &[(usize, bool)], components: usize) {
        let take = |values: &[f32]| -> Vec<f32> {
            sources
                .iter()
                .flat_map(|&(i, fresh)| {
                    (0..components).map(move |c| if fresh { 0.0 } else { values[i * components + c] })
                })
                .collect()
        };
        self.first = take(&self.first);
        self.second = take(&self.second);
    }

    /// One update of `values` along `v_values`: Kingma and Ba 2015, Algorithm 1, in the form in which `ε` is
    /// added after the bias correction. A rate of 0 only counts.
    ///
    /// - `values`: `[values]`, updated in place
    /// - `v_values`: `[values]`, their gradient
    ///
    /// # Panics
    /// If lengths differ.
    pub fn update(&mut self, values: &mut [f32], v_values: &[f32], rate: f32) {
        assert_eq!([values.len(), v_values.len()], [self.first.len(); 2], "values and gradients against the moments");
        self.step += 1;
        if rate == 0.0 {
            return;
        }
        let [step_size, correction] = adam_factors(rate, self.step);
        (
            values.par_chunks_mut(CHUNK),
            v_values.par_chunks(CHUNK),
            self.first.par_chunks_mut(CHUNK),
            self.second.par_chunks_mut(CHUNK),
        )
            .into_par_iter()
            .for_each(|(values, v_values, first, second)| {
                for (((x, &v), m), s) in values.iter_mut().zip(v_values).zip(first).zip(second) {
                    *m = BETA1 * *m + (1.0 - BETA1) * v;
                    *s = BETA2 * *s + (1.0 - BETA2) * v * v;
                    *x -= step_size * *m / (s.sqrt() * correction + ADAM_EPSILON);
                }
            });
    }
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

    #[test]
    fn gathering_keeps_rows_and_zeroes_fresh_ones() {
        let mut moments = Moments::new(4);
        moments.first = vec![1.0, 2.0, 3.0, 4.0];
        moments.second = vec![5.0, 6.0, 7.0, 8.0];
        moments.gather(&[(1, false), (0, true)], 2);
        assert_eq!((moments.first, moments.second), (vec![3.0, 4.0, 0.0, 0.0], vec![7.0, 8.0, 0.0, 0.0]));
    }
}
