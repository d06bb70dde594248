//! Clocks by sound: generalised cross-correlation with phase transform (Knapp and Carter 1976).
//!
//! Sound travels 1 m in 3 ms, so a camera that stands 5 m farther away hears everything half a frame later at 30 frames
//! a second. This delay is not corrected, because the place of the sound's source is unknown.

use std::path::Path;

use rayon::prelude::*;
use rustfft::{FftPlanner, num_complex::Complex32};
use tcgs_capture::audio;

/// Samples per second: bounds the precision of offsets, and the cost of a long recording.
const RATE: u32 = 8000;
/// Sound beyond this is ignored.
const MAX_SECS: f64 = 120.0;
/// Peaks nearer than this to the highest belong to it: an echo, or one period of a deep tone.
const PEAK_SECS: f64 = 0.02;
/// Minimum ratio of the highest peak to all others. Sound of different scenes reaches 1.1.
const MIN_PROMINENCE: f32 = 1.4;

/// The moment of one event in each recording, seconds. `None` if some recording has no sound, or has no sound in common
/// with another recording.
pub(super) fn event_secs(paths: &[&Path]) -> Option<Vec<f64>> {
    let sounds: Vec<Option<Vec<f32>>> = paths.par_iter().map(|path| audio(path, RATE, MAX_SECS)).collect();
    let sounds: Vec<Vec<f32>> = sounds.into_iter().collect::<Option<_>>()?;
    let samples = offsets(&sounds)?;
    Some(samples.into_iter().map(|samples| samples / f64::from(RATE)).collect())
}

/// Delay of each sound against the first, in samples. Every sound is compared with the first. A sound that has too
/// little in common with the first is compared with others whose offset is known by then.
pub(super) fn offsets(sounds: &[Vec<f32>]) -> Option<Vec<f64>> {
    let longest = sounds.iter().map(Vec::len).max()?;
    // Length for every shift without wrapping around.
    let length = (2 * longest).next_power_of_two();
    let mut planner = FftPlanner::new();
    let (forward, backward) = (planner.plan_fft_forward(length), planner.plan_fft_inverse(length));
    let spectra: Vec<Vec<Complex32>> = sounds
        .par_iter()
        .map(|sound| {
            let mean = sound.iter().sum::<f32>() / sound.len().max(1) as f32;
            let mut spectrum = vec![Complex32::default(); length];
            for (out, sample) in spectrum.iter_mut().zip(sound) {
                out.re = sample - mean;
            }
            forward.process(&mut spectrum);
            spectrum
        })
        .collect();
    let late = |a: usize, b: usize| {
        let mut product: Vec<Complex32> = spectra[a].iter().zip(&spectra[b]).map(|(a, b)| a.conj() * b).collect();
        whiten(&mut product);
        backward.process(&mut product);
        highest_peak(&product.iter().map(|value| value.re).collect::<Vec<f32>>())
    };
    let mut known: Vec<Option<f64>> = vec![None; sounds.len()];
    known[0] = Some(0.0);
    let mut compared = vec![0];
    while let Some(reference) = compared.pop() {
        let begin = known[reference]?;
        let open: Vec<usize> = (0..sounds.len()).filter(|&i| known[i].is_none()).collect();
        let found: Vec<Option<f64>> = open.par_iter().map(|&i| late(reference, i)).collect();
        for (i, found) in open.into_iter().zip(found) {
            if let Some(samples) = found {
                known[i] = Some(begin + samples);
                compared.push(i);
            }
        }
    }
    known.into_iter().collect()
}

/// Keeps the phases alone: all frequencies get the same weight. Weak ones hold noise and get less.
fn whiten(product: &mut [Complex32]) {
    let mean = product.iter().map(|value| value.norm()).sum::<f32>() / product.len().max(1) as f32;
    let floor = (0.01 * mean).max(f32::MIN_POSITIVE);
    for value in product {
        *value /= value.norm() + floor;
    }
}

/// Position of the highest peak of a circular correlation, between samples by a parabola. `None` if no peak stands out.
fn highest_peak(correlation: &[f32]) -> Option<f64> {
    let length = correlation.len();
    let peak = (0..length).max_by(|&a, &b| correlation[a].total_cmp(&correlation[b]))?;
    let near = (PEAK_SECS * f64::from(RATE)) as usize;
    let distance = |i: usize| (i + length - peak) % length;
    let is_other = |i: &usize| distance(*i) > near && length - distance(*i) > near;
    let second = (0..length).filter(is_other).map(|i| correlation[i]).fold(0.0, f32::max);
    let height = correlation[peak];
    if height.is_nan() || height <= MIN_PROMINENCE * second || height <= 0.0 {
        return None;
    }
    let [before, after] = [correlation[(peak + length - 1) % length], correlation[(peak + 1) % length]];
    let bend = before - 2.0 * height + after;
    let fraction = if bend < 0.0 { f64::from(0.5 * (before - after) / bend) } else { 0.0 };
    let samples = if peak > length / 2 { peak as f64 - length as f64 } else { peak as f64 };
    Some(samples + fraction)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// Noise of a room, as microphones at different places and of different quality hear it.
    fn heard(seed: u64, late: usize, own_noise: f32) -> Vec<f32> {
        let mut scene = rand_pcg::Pcg32::seed_from_u64(1);
        let mut sound: Vec<f32> = (0..40_000).map(|_| scene.random_range(-1.0..1.0)).collect();
        sound.drain(..4000 - late);
        let mut own = rand_pcg::Pcg32::seed_from_u64(seed);
        // An echo, another loudness, noise of its own.
        let echo: Vec<f32> =
            (0..sound.len()).map(|i| sound[i] + 0.5 * sound[i.saturating_sub(90 + late / 10)]).collect();
        echo.iter().map(|value| 0.1 * value + own_noise * own.random_range(-0.1..0.1)).collect()
    }

    #[test]
    fn offsets_of_noisy_sounds_are_found_to_the_sample() {
        let lates = [1000, 0, 3999, 1234];
        let sounds: Vec<Vec<f32>> = lates.iter().zip(2..).map(|(&late, seed)| heard(seed, late, 0.5)).collect();
        let found = offsets(&sounds).unwrap();
        for (found, late) in found.iter().zip(lates) {
            assert!((found - (late as f64 - 1000.0)).abs() < 0.5, "{found} for {late}");
        }
    }

    #[test]
    fn sounds_with_nothing_in_common_have_no_offset() {
        let mut random = rand_pcg::Pcg32::seed_from_u64(3);
        let mut noise = || (0..40_000).map(|_| random.random_range(-1.0..1.0)).collect::<Vec<f32>>();
        assert_eq!(offsets(&[noise(), noise()]), None);
        assert_eq!(offsets(&[vec![0.0; 1000], vec![0.0; 1000]]), None);
        // A tone has a peak every period.
        let tone: Vec<f32> = (0..40_000).map(|i| (i as f32 * 0.7).sin()).collect();
        assert_eq!(offsets(&[tone.clone(), tone[500..].to_vec()]), None);
    }
}
