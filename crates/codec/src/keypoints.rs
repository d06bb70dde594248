//! Selection of keypoints (the paper's Algorithm 1) and linear interpolation between them.
//!
//! Selection works on the float values of one or several scalars over time, before quantisation, and does not depend on
//! the meaning of the scalars. Tolerances for each attribute are the subject of `compress`.

use crate::error::CompressError;

/// Selects the samples of a track to keep as keypoints (the paper's Algorithm 1).
///
/// The selection starts with the first and the last sample. In each step it adds the sample of the largest squared
/// error of linear interpolation between keypoints; of equal errors the earliest. It stops when the mean squared error
/// over all samples is at most `max_mse`, or when `max_keypoints` are selected.
///
/// - `track`: `[T]` values, finite
/// - `max_keypoints`: a number below 2 counts as 2
/// - `max_mse`: mean squared error, in the squared unit of the track, 0 or more; may be infinite
/// - returns: `[K]` indices of samples, strictly increasing; no index for an empty track, `[0]` for a single sample
///
/// The mean squared error may rise when a keypoint is added, so another selection of the same size may be better.
///
/// ```
/// let track = [0.0, 1.0, 2.0, 1.0, 0.0];
/// assert_eq!(tcgs_codec::select_keypoints(&track, 30, 1e-5)?, [0, 2, 4]);
/// assert_eq!(tcgs_codec::select_keypoints(&track, 2, 1e-5)?, [0, 4]);
/// # Ok::<(), tcgs_codec::CompressError>(())
/// ```
///
/// # Errors
/// [`CompressError::Value`] if a sample is not finite, or `max_mse` is negative or NaN.
pub fn select(track: &[f32], max_keypoints: usize, max_mse: f32) -> Result<Vec<usize>, CompressError> {
    if max_mse.is_nan() || max_mse < 0.0 {
        return Err(CompressError::Value { what: "max_mse", found: max_mse.into(), expected: "0 or more" });
    }
    if let Some(&found) = track.iter().find(|x| !x.is_finite()) {
        let (what, found) = ("sample of a track", found.into());
        return Err(CompressError::Value { what, found, expected: "a finite number" });
    }
    Ok(Selector::default().select(track, max_keypoints, max_mse).to_vec())
}

/// [`select`] for many tracks with buffers that are reused.
///
/// Simple version: after each added keypoint interpolate the whole track, and find the mean and the largest of the
/// squared errors. Departures: (1) only the interval that the keypoint splits is interpolated again; the squared errors
/// elsewhere are kept. (2) The sum over all samples is computed from scratch each time, always in the order of [`sum`],
/// so that every decision equals that of the simple version to the last bit.
#[derive(Default)]
pub(crate) struct Selector {
    squared_errors: Vec<f64>,
    indices: Vec<usize>,
}

impl Selector {
    /// - `track`: `[T]`, finite
    /// - `max_mse`: 0 or more
    pub(crate) fn select(&mut self, track: &[f32], max_keypoints: usize, max_mse: f32) -> &[usize] {
        self.select_joint(&[track], &[1.0], max_keypoints, f64::from(max_mse))
    }

    /// Selection for several tracks that share their keypoints.
    ///
    /// - `tracks`: `[C][T]`, finite, not empty
    /// - `weights`: `[C]` factors of the squared errors of the tracks
    /// - `max_error`: bound on the mean over time of the weighted sum of squared errors
    pub(crate) fn select_joint(
        &mut self,
        tracks: &[&[f32]],
        weights: &[f64],
        max_keypoints: usize,
        max_error: f64,
    ) -> &[usize] {
        let count = tracks[0].len();
        self.indices.clear();
        if count < 2 {
            self.indices.extend(0..count);
            return &self.indices;
        }
        self.indices.extend([0, count - 1]);
        self.squared_errors.clear();
        self.squared_errors.resize(count, 0.0);
        self.interpolate(tracks, weights, 0, count - 1);
        while self.indices.len() < max_keypoints && sum(&self.squared_errors) / count as f64 > max_error {
            let worst = index_of_largest(&self.squared_errors);
            let at = self.indices.partition_point(|&i| i < worst);
            if self.indices[at] == worst {
                // All errors are zero.
                break;
            }
            let (before, after) = (self.indices[at - 1], self.indices[at]);
            self.indices.insert(at, worst);
            self.squared_errors[worst] = 0.0;
            self.interpolate(tracks, weights, before, worst);
            self.interpolate(tracks, weights, worst, after);
        }
        &self.indices
    }

    /// Computes the squared errors strictly between two keypoints; at a keypoint the error is exactly zero.
    fn interpolate(&mut self, tracks: &[&[f32]], weights: &[f64], first: usize, last: usize) {
        let inner = first + 1..last;
        self.squared_errors[inner.clone()].fill(0.0);
        for (track, weight) in tracks.iter().zip(weights) {
            let start = f64::from(track[first]);
            let slope = (f64::from(track[last]) - start) / (last - first) as f64;
            let errors = &mut self.squared_errors[inner.clone()];
            for ((i, squared_error), &x) in (1_u32..).zip(errors).zip(&track[inner.clone()]) {
                let error = f64::from(x) - (start + slope * f64::from(i));
                *squared_error += weight * (error * error);
            }
        }
    }
}

/// Least-squares values at keypoints: their linear interpolation has the least squared error over all samples.
///
/// - `track`: `[T]`
/// - `indices`: `[K]`, ascending from 0 to `T - 1`
/// - returns: `[K]`
pub(crate) fn fit_values(track: &[f32], indices: &[usize]) -> Vec<f32> {
    let count = indices.len();
    if count < 2 {
        return indices.iter().map(|&i| track[i]).collect();
    }
    // Normal equations. Each sample lies between two keypoints, so the matrix is tridiagonal.
    let (mut diagonal, mut beside, mut right) = (vec![0.0_f64; count], vec![0.0_f64; count - 1], vec![0.0_f64; count]);
    for (k, pair) in indices.windows(2).enumerate() {
        let length = (pair[1] - pair[0]) as f64;
        let end = if k + 2 == count { pair[1] + 1 } else { pair[1] };
        for i in pair[0]..end {
            let b = (i - pair[0]) as f64 / length;
            let (a, x) = (1.0 - b, f64::from(track[i]));
            diagonal[k] += a * a;
            diagonal[k + 1] += b * b;
            beside[k] += a * b;
            right[k] += a * x;
            right[k + 1] += b * x;
        }
    }
    for k in 1..count {
        let factor = beside[k - 1] / diagonal[k - 1];
        diagonal[k] -= factor * beside[k - 1];
        right[k] -= factor * right[k - 1];
    }
    for k in (0..count).rev() {
        let known = if k + 1 < count { beside[k] * right[k + 1] } else { 0.0 };
        right[k] = (right[k] - known) / diagonal[k];
    }
    right.into_iter().map(|x| x as f32).collect()
}

/// Sum in eight interleaved partial sums, then the rest: a fixed order that runs in SIMD lanes.
fn sum(values: &[f64]) -> f64 {
    let (chunks, rest) = values.as_chunks::<8>();
    let mut lanes = [0.0; 8];
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane += value;
        }
    }
    lanes.iter().chain(rest).sum()
}

fn index_of_largest(values: &[f64]) -> usize {
    let (chunks, rest) = values.as_chunks::<8>();
    let mut lanes = [0.0_f64; 8];
    for chunk in chunks {
        for (lane, &value) in lanes.iter_mut().zip(chunk) {
            *lane = if value > *lane { value } else { *lane };
        }
    }
    let largest = lanes.iter().chain(rest).fold(0.0_f64, |a, &b| a.max(b));
    values.iter().position(|&v| v == largest).unwrap_or(0)
}

/// Index of the last keypoint at or before a timestep, and the fraction in `[0, 1)` of the way to the next keypoint.
///
/// - `times`: strictly increasing, not empty; a `timestep` outside them gives the nearest keypoint and fraction 0
pub fn locate(times: &[u16], timestep: usize) -> (usize, f32) {
    let before = times.partition_point(|&t| usize::from(t) <= timestep).saturating_sub(1);
    (before, fraction(times, before, timestep))
}

/// Fraction in `[0, 1)` of the way from keypoint `before` to the next keypoint at a timestep; 0 before the first
/// keypoint and after the last.
///
/// - `before`: index of the last keypoint at or before the timestep, or 0
#[inline(always)]
pub(crate) fn fraction(times: &[u16], before: usize, timestep: usize) -> f32 {
    let start = usize::from(times[before]);
    match times.get(before + 1) {
        Some(&end) if start < timestep => (timestep - start) as f32 / (usize::from(end) - start) as f32,
        _ => 0.0,
    }
}

/// Value of a track at a timestep, from its value at any keypoint.
///
/// - `times`: as in [`locate`]
/// - `value`: value at the keypoint of an index
#[inline(always)]
pub(crate) fn sample(times: &[u16], timestep: usize, value: impl Fn(usize) -> f32) -> f32 {
    let (before, fraction) = locate(times, timestep);
    if fraction == 0.0 { value(before) } else { lerp(value(before), value(before + 1), fraction) }
}

/// Value of a track at a timestep: linear between keypoints, constant before the first keypoint and after the last.
///
/// - `times`: `[K]` timesteps of the keypoints, strictly increasing, `K >= 1`
/// - `values`: `[K]` values at the keypoints
/// - returns: the value at `timestep`, in the unit of `values`
///
/// ```
/// assert_eq!(tcgs_codec::interpolate(&[0, 4], &[1.0, 3.0], 1), 1.5);
/// assert_eq!(tcgs_codec::interpolate(&[0], &[1.0], 7), 1.0);
/// ```
///
/// # Panics
/// If `times` is empty, or `times` and `values` differ in length.
pub fn interpolate(times: &[u16], values: &[f32], timestep: usize) -> f32 {
    assert!(
        !times.is_empty() && times.len() == values.len(),
        "{} times against {} values, expected as many and at least one",
        times.len(),
        values.len()
    );
    sample(times, timestep, |keypoint| values[keypoint])
}

#[inline(always)]
pub(crate) fn lerp(a: f32, b: f32, fraction: f32) -> f32 {
    a + (b - a) * fraction
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn short_tracks_are_kept_whole() {
        assert_eq!(select(&[], 5, 0.0).unwrap(), [0_usize; 0]);
        assert_eq!(select(&[3.0], 5, 0.0).unwrap(), [0]);
        assert_eq!(select(&[3.0, 9.0], 0, 0.0).unwrap(), [0, 1]);
        assert_eq!(select(&[3.0, 9.0, 1.0], 0, 0.0).unwrap(), [0, 2]);
    }

    #[test]
    fn of_equal_errors_the_earliest_is_added() {
        assert_eq!(select(&[0.0, 1.0, 0.0, 1.0, 0.0], 3, 0.0).unwrap(), [0, 1, 4]);
    }

    #[test]
    fn the_tolerance_decides() {
        // The chord from 0 to 0 leaves errors 1, 2, 1: a mean square of 6/5 over all five samples.
        let track = [0.0, 1.0, 2.0, 1.0, 0.0];
        assert_eq!(select(&track, 5, 1.2).unwrap(), [0, 4]);
        assert_eq!(select(&track, 5, 1.199).unwrap(), [0, 2, 4]);
        assert_eq!(select(&track, 5, f32::INFINITY).unwrap(), [0, 4]);
        // Noise of known size below and above the tolerance.
        let noisy: Vec<f32> = (0..100).map(|i| if i % 2 == 0 { 0.01 } else { -0.01 }).collect();
        assert_eq!(select(&noisy, 100, 4.1e-4).unwrap(), [0, 99]);
        assert!(select(&noisy, 100, 0.9e-4).unwrap().len() > 2);
        assert_eq!(select(&noisy, 100, 0.0).unwrap().len(), 100);
    }

    #[test]
    fn what_is_not_finite_or_negative_is_refused() {
        let says = |track: &[f32], max_mse, message: &str| {
            assert_eq!(select(track, 3, max_mse).unwrap_err().to_string(), message);
        };
        says(&[0.0, f32::NAN, 1.0], 0.0, "invalid sample of a track: found NaN, expected a finite number");
        says(&[0.0], -1.0, "invalid max_mse: found -1, expected 0 or more");
        says(&[], f32::NAN, "invalid max_mse: found NaN, expected 0 or more");
    }

    #[test]
    fn interpolation_passes_through_its_keypoints() {
        let (times, values) = ([0, 3, 10], [1.0, -2.0, 5.0]);
        assert_eq!([0, 3, 10].map(|t| interpolate(&times, &values, t)), values);
        assert_eq!(interpolate(&times, &values, 2), -1.0);
        assert_eq!(interpolate(&times, &values, 12), 5.0);
    }
}
