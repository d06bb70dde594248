//! One channel of several cameras: the gains and offsets under which a place has one colour in all cameras.
//!
//! What lives here: numbers alone. What does not: the search for places that cameras have in common, and their colours
//! (`colors`).

use tcgs_core::upper_median;

use super::normal::solve_positive;

/// Values of one place: camera and value in `[0, 1]`.
pub(super) type Seen = Vec<(usize, f64)>;

/// `gain * value + offset` of one camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Line {
    pub gain: f64,
    pub offset: f64,
}

/// Whether offsets are fitted as well.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Model {
    /// Exposure and white balance are factors. They stay factors for displayed values, which are a power of light.
    Gains,
    /// Black levels differ as well, or tone curves.
    GainsAndOffsets,
}

impl Line {
    /// Leaves values as they are.
    pub const NONE: Self = Self { gain: 1.0, offset: 0.0 };

    pub fn at(self, value: f64) -> f64 {
        self.gain * value + self.offset
    }
}

/// Cauchy's loss is 95 % as efficient as squares for Gaussian errors if its scale is this many standard deviations.
const CAUCHY: f64 = 2.385;
/// Standard deviation of a Gaussian over its median absolute value.
const DEVIATION_PER_MEDIAN: f64 = 1.4826;
/// Lower bound of the errors: values have eight bits.
const MIN_DEVIATION: f64 = 1.0 / 255.0;
/// Standard deviations of the priors of gains and offsets.
const PRIOR_GAIN: f64 = 0.3;
const PRIOR_OFFSET: f64 = 0.05;
/// Reweighting converges within a few steps; a step costs next to nothing.
const NUM_STEPS: usize = 30;

/// Fits the cameras' lines by iteratively reweighted least squares. The camera in the middle has gain 1 and offset 0.
///
/// - `is_free`: whether each camera has a line; the places of other cameras do not count
pub(super) fn fit(places: &[Seen], is_free: &[bool], model: Model) -> Vec<Line> {
    let places: Vec<Seen> = places
        .iter()
        .map(|seen| seen.iter().copied().filter(|&(camera, _)| is_free[camera]).collect::<Seen>())
        .filter(|seen| seen.len() >= 2)
        .collect();
    let mut lines = vec![Line::NONE; is_free.len()];
    if places.is_empty() {
        return lines;
    }
    for _ in 0..NUM_STEPS {
        let errors: Vec<Vec<f64>> = places.iter().map(|seen| from_middle(seen, &lines)).collect();
        let middle = upper_median(errors.iter().flatten().map(|error| error.abs())).unwrap_or_default();
        let deviation = (DEVIATION_PER_MEDIAN * middle).max(MIN_DEVIATION);
        match step(&places, &errors, deviation, is_free, model) {
            Some(next) => lines = next,
            None => break,
        }
    }
    relative_to_the_middle(&mut lines, is_free);
    lines
}

/// Differences of each camera's value from the median of a place, with the lines applied.
fn from_middle(seen: &Seen, lines: &[Line]) -> Vec<f64> {
    let values: Vec<f64> = seen.iter().map(|&(camera, value)| lines[camera].at(value)).collect();
    let mut sorted = values.clone();
    sorted.sort_by(f64::total_cmp);
    let middle = 0.5 * (sorted[(sorted.len() - 1) / 2] + sorted[sorted.len() / 2]);
    values.into_iter().map(|value| value - middle).collect()
}

/// Solves the weighted normal equations. The places' own colours are eliminated: each is the weighted mean.
fn step(places: &[Seen], errors: &[Vec<f64>], deviation: f64, is_free: &[bool], model: Model) -> Option<Vec<Line>> {
    let num = 2 * is_free.len();
    let (mut matrix, mut right) = (vec![0.0; num * num], vec![0.0; num]);
    let mut num_seen = 0.0;
    for (seen, errors) in places.iter().zip(errors) {
        let weights: Vec<f64> =
            errors.iter().map(|error| 1.0 / (1.0 + (error / (CAUCHY * deviation)).powi(2))).collect();
        let total: f64 = weights.iter().sum();
        for (&(a, x), &of_a) in seen.iter().zip(&weights) {
            num_seen += 1.0;
            for (&(b, y), &of_b) in seen.iter().zip(&weights) {
                let weight = if a == b { of_a } else { 0.0 } - of_a * of_b / total;
                for (i, slope) in [x, 1.0].into_iter().enumerate() {
                    for (j, other) in [y, 1.0].into_iter().enumerate() {
                        matrix[(2 * a + i) * num + 2 * b + j] += weight * slope * other;
                    }
                }
            }
        }
    }
    // Gauge: all values could be scaled to 0, so the mean gain is tied to 1 and the mean offset to 0.
    let tie = 10.0 * num_seen;
    let free: Vec<usize> = (0..is_free.len()).filter(|&camera| is_free[camera]).collect();
    for &a in &free {
        for &b in &free {
            matrix[2 * a * num + 2 * b] += tie;
            matrix[(2 * a + 1) * num + 2 * b + 1] += tie;
        }
        right[2 * a] += tie * free.len() as f64;
    }
    // A prior of nearly infinite weight fixes the parameters that are not fitted.
    let fixed = 1e9 * num_seen;
    for (camera, is_free) in is_free.iter().enumerate() {
        let of_gain = if *is_free { (deviation / PRIOR_GAIN).powi(2) } else { fixed };
        let fits_offset = *is_free && model == Model::GainsAndOffsets;
        let of_offset = if fits_offset { (deviation / PRIOR_OFFSET).powi(2) } else { fixed };
        matrix[2 * camera * num + 2 * camera] += of_gain;
        right[2 * camera] += of_gain;
        matrix[(2 * camera + 1) * num + 2 * camera + 1] += of_offset;
    }
    let found = solve_positive(&mut matrix, right, num)?;
    let line = |&[gain, offset]: &[f64; 2]| Line { gain, offset: if model == Model::Gains { 0.0 } else { offset } };
    Some(found.as_chunks::<2>().0.iter().map(line).collect())
}

/// Gives the camera in the middle the gain 1 and the offset 0.
fn relative_to_the_middle(lines: &mut [Line], is_free: &[bool]) {
    let of = |pick: fn(&Line) -> f64| {
        let free = lines.iter().zip(is_free).filter(|(_, is_free)| **is_free);
        upper_median(free.map(|(line, _)| pick(line))).unwrap_or_default()
    };
    let (gain, offset) = (of(|line| line.gain), of(|line| line.offset));
    for (line, _) in lines.iter_mut().zip(is_free).filter(|(_, is_free)| **is_free) {
        *line = Line { gain: line.gain / gain, offset: (line.offset - offset) / gain };
    }
}

/// Differences of each camera's values from the mean of the other cameras' values, place by place.
pub(super) fn errors(places: &[Seen], lines: &[Line]) -> Vec<Vec<f64>> {
    let mut errors = vec![Vec::new(); lines.len()];
    for seen in places.iter().filter(|seen| seen.len() >= 2) {
        let values: Vec<f64> = seen.iter().map(|&(camera, value)| lines[camera].at(value)).collect();
        let sum: f64 = values.iter().sum();
        for (&(camera, _), value) in seen.iter().zip(&values) {
            errors[camera].push((value - (sum - value) / (values.len() - 1) as f64).abs());
        }
    }
    errors
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Places that neighbours of five cameras have in common, seen through lines, with noise and outliers.
    fn places(lines: &[Line]) -> Vec<Seen> {
        let random = |i: usize| {
            let x = (i as f64 * 12.9898).sin() * 43_758.545_3;
            x - x.floor()
        };
        let place = |i: usize| {
            let color = 0.1 + 0.7 * random(i);
            let seen = |camera: usize| {
                let noise = 0.02 * (random(1000 + 7 * i + camera) - 0.5);
                let is_wrong = i % 11 == 3 && camera == i % 5;
                let shown = if is_wrong { random(5000 + i) } else { color + noise };
                (camera, (shown - lines[camera].offset) / lines[camera].gain)
            };
            vec![seen(i % 5), seen((i + 1) % 5)]
        };
        (0..600).map(place).collect()
    }

    #[test]
    fn lines_come_back_relative_to_the_camera_in_the_middle() {
        let line = |gain, offset| Line { gain, offset };
        let gains = [0.8, 1.0, 1.3, 0.95, 1.1].map(|gain| line(gain, 0.0));
        let found = fit(&places(&gains), &[true; 5], Model::Gains);
        for (found, expected) in found.iter().zip(gains) {
            assert!((found.gain / expected.gain - 1.0).abs() < 0.01, "{found:?} {expected:?}");
            assert!(found.offset == 0.0, "{found:?}");
        }
        let lines = [line(0.8, 0.03), line(1.0, 0.0), line(1.3, -0.05), line(0.95, 0.01), line(1.1, -0.02)];
        let found = fit(&places(&lines), &[true; 5], Model::GainsAndOffsets);
        for (found, expected) in found.iter().zip(lines) {
            assert!((found.gain / expected.gain - 1.0).abs() < 0.02, "{found:?} {expected:?}");
            assert!((found.offset - expected.offset).abs() < 0.01, "{found:?} {expected:?}");
        }
        let typical = |lines: &[Line]| upper_median(errors(&places(&gains), lines).concat()).unwrap();
        assert!(typical(&gains) < 0.02 && typical(&[Line::NONE; 5]) > 0.04);
    }

    #[test]
    fn a_camera_that_is_not_free_stays_as_it_is() {
        let lines = [1.2, 1.0, 0.9, 1.0, 1.1].map(|gain| Line { gain, offset: 0.0 });
        let found = fit(&places(&lines), &[false, true, true, true, true], Model::Gains);
        assert!((found[0].gain - 1.0).abs() < 1e-6 && found[0].offset.abs() < 1e-6, "{found:?}");
        assert!((found[2].gain / found[4].gain - 0.9 / 1.1).abs() < 0.01, "{found:?}");
    }
}
