//! Clocks by motion: motion and light rise and fall at the same moments in every camera.
//!
//! Two cameras may agree by chance, and more easily the less they share. A correlation is therefore weighted by its
//! significance (Fisher's transform), and with many cameras all pairs must agree. Offsets are found for each pair
//! alone, then for all cameras together. Two numbers measure the certainty ([`ClockEvidence`]): the share of pairs
//! whose own offset agrees with the joint one, and the joint correlation over that of the next best offset.

use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use tcgs_capture::Recording;

use super::ClockEvidence;
use crate::PrepareError;

/// Number of frames of each recording that are read, from its first on.
const MAX_FRAMES: usize = 1800;
/// Images are averaged to about so many blocks across: finer detail is noise.
const BLOCKS: usize = 96;
/// Fewest moments that two recordings must share.
const MIN_SHARED: usize = 20;
/// They must share this part of the shorter one.
const MIN_SHARED_SHARE: f64 = 0.4;
/// Added to the energy before its logarithm, in values of 255: the noise of a camera.
const NOISE: f32 = 0.05;
/// Correlations below this, in standard deviations, are all alike.
const MIN_SECOND: f64 = 1e-6;
/// Offsets this near to the best belong to its peak, moments.
const PEAK: i64 = 2;

/// Motion and light of one recording over time, on a regular grid: curves of equal length.
pub(super) struct Curves(Vec<Vec<f32>>);

/// The moment of one event in each recording, in seconds, to the nearest frame, and how sure it is. `None` if nothing
/// moves.
///
/// - `report`: called with the share of the frames that are decoded
pub(super) fn event_secs(
    recordings: &[Recording],
    report: &(dyn Fn(f64) + Sync),
) -> Result<Option<(Vec<f64>, ClockEvidence)>, PrepareError> {
    let rate = recordings.iter().filter_map(|recording| recording.times.fps()).fold(0.0, f64::max);
    if rate == 0.0 {
        return Ok(None);
    }
    let num_frames: usize = recordings.iter().map(|recording| recording.num_frames().min(MAX_FRAMES)).sum();
    let num_done = AtomicUsize::new(0);
    let decoded = || report((num_done.fetch_add(1, Ordering::Relaxed) + 1) as f64 / num_frames as f64);
    let curves: Vec<_> = recordings.par_iter().map(|recording| curves(recording, rate, &decoded)).collect();
    let curves = curves.into_iter().collect::<Result<Vec<_>, _>>()?;
    let begins = recordings.iter().map(|recording| recording.times.first_secs());
    let secs =
        |lates: Vec<i64>| lates.into_iter().zip(begins).map(|(late, begin)| late as f64 / rate + begin).collect();
    Ok(offsets(&curves).map(|(lates, evidence)| (secs(lates), evidence)))
}

/// Decodes the first frames and measures them.
///
/// - `rate`: of the grid, per second
/// - `decoded`: called after each frame
fn curves(recording: &Recording, rate: f64, decoded: &(dyn Fn() + Sync)) -> Result<Curves, PrepareError> {
    let num_frames = recording.num_frames().min(MAX_FRAMES);
    let mut before: Option<Vec<f32>> = None;
    // Between frames: the time, the amount of motion, the gain in brightness.
    let mut changes: Vec<(f64, f32, f32)> = Vec::new();
    for frame in 0..num_frames {
        let blocks = blocks(&recording.frame(frame)?);
        if let Some(before) = before.as_ref().filter(|before| before.len() == blocks.len()) {
            let count = blocks.len() as f32;
            let differences = || blocks.iter().zip(before).map(|(now, before)| now - before);
            let energy = differences().map(f32::abs).sum::<f32>() / count;
            let brighter = differences().sum::<f32>() / count;
            changes.push((recording.times.secs(frame), (energy + NOISE).ln(), brighter));
        }
        before = Some(blocks);
        decoded();
    }
    Ok(Curves::on_grid(&changes, recording.times.first_secs(), rate))
}

/// Mean brightness of square blocks of an image.
fn blocks(image: &image::RgbImage) -> Vec<f32> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let side = width.max(height).div_ceil(BLOCKS).max(1);
    let (across, down) = (width / side, height / side);
    let mut sums = vec![0_u32; across * down];
    for (y, row) in image.as_raw().chunks_exact(3 * width).take(down * side).enumerate() {
        let sums = &mut sums[y / side * across..][..across];
        for (sum, block) in sums.iter_mut().zip(row.chunks_exact(3 * side)) {
            *sum += block.iter().map(|&value| u32::from(value)).sum::<u32>();
        }
    }
    let share = 1.0 / (3 * side * side) as f32;
    sums.into_iter().map(|sum| sum as f32 * share).collect()
}

impl Curves {
    /// Brings changes to a regular grid, by linear interpolation.
    ///
    /// - `changes`: seconds, ascending; logarithm of the energy; gain in brightness
    fn on_grid(changes: &[(f64, f32, f32)], begin_secs: f64, rate: f64) -> Self {
        let Some(&(last, ..)) = changes.last() else { return Self(vec![Vec::new(); 3]) };
        let length = ((last - begin_secs) * rate).round() as usize;
        // The change before a frame belongs to the grid place before that of the frame.
        let at = |i: usize, of: fn(&(f64, f32, f32)) -> f32| {
            let secs = begin_secs + (i + 1) as f64 / rate;
            let after = changes.partition_point(|change| change.0 < secs).min(changes.len() - 1);
            let (a, b) = (&changes[after.saturating_sub(1)], &changes[after]);
            let share = if b.0 > a.0 { ((secs - a.0) / (b.0 - a.0)).clamp(0.0, 1.0) as f32 } else { 1.0 };
            of(a) + share * (of(b) - of(a))
        };
        let energy: Vec<f32> = (0..length).map(|i| at(i, |change| change.1)).collect();
        let brighter = (0..length).map(|i| at(i, |change| change.2)).collect();
        let rise = (0..length).map(|i| energy[i] - energy[i.saturating_sub(1)]).collect();
        Self(vec![energy, brighter, rise])
    }

    fn len(&self) -> usize {
        self.0[0].len()
    }
}

/// The correlations of two recordings by the delay of the second.
struct Pair {
    /// The least offset.
    first: i64,
    scores: Vec<f64>,
}

impl Pair {
    fn of(a: &Curves, b: &Curves) -> Self {
        let shorter = a.len().min(b.len());
        let shared = MIN_SHARED.max((MIN_SHARED_SHARE * shorter as f64) as usize);
        if shorter < shared {
            return Self { first: 0, scores: Vec::new() };
        }
        let first = shared as i64 - a.len() as i64;
        let last = b.len() as i64 - shared as i64;
        let score = |late: i64| {
            let curves = a.0.iter().zip(&b.0).map(|(a, b)| evidence(a, b, late));
            curves.sum::<f64>() / a.0.len() as f64
        };
        Self { first, scores: (first..=last).map(score).collect() }
    }

    fn best(&self) -> Option<i64> {
        let best = (0..self.scores.len()).max_by(|&i, &j| self.scores[i].total_cmp(&self.scores[j]))?;
        Some(self.first + best as i64)
    }

    /// 0 for an offset at which the recordings share too little.
    fn score(&self, late: i64) -> f64 {
        let i = usize::try_from(late - self.first).ok();
        i.and_then(|i| self.scores.get(i)).copied().unwrap_or(0.0)
    }

    /// The least and the greatest offset that is known.
    fn range(&self) -> [i64; 2] {
        [self.first, self.first + self.scores.len() as i64 - 1]
    }
}

/// Significance of the correlation of `a[i]` and `b[i + late]` against chance, in standard deviations: Fisher's
/// transform of Pearson's correlation. 0 where nothing changes.
fn evidence(a: &[f32], b: &[f32], late: i64) -> f64 {
    let begin = usize::try_from(-late).unwrap_or(0);
    let (a, b) = (&a[begin..], &b[usize::try_from(late).unwrap_or(0)..]);
    let length = a.len().min(b.len());
    let (a, b) = (&a[..length], &b[..length]);
    let mean = |values: &[f32]| values.iter().map(|&v| f64::from(v)).sum::<f64>() / length as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let (mut both, mut of_a, mut of_b) = (0.0, 0.0, 0.0);
    for (&a, &b) in a.iter().zip(b) {
        let (a, b) = (f64::from(a) - mean_a, f64::from(b) - mean_b);
        both += a * b;
        of_a += a * a;
        of_b += b * b;
    }
    let norm = (of_a * of_b).sqrt();
    if norm > 1e-9 { (both / norm).clamp(-0.99, 0.99).atanh() * (length as f64 - 3.0).sqrt() } else { 0.0 }
}

/// Delay of each recording against the first, in moments, and how sure it is. `None` if two recordings share too little
/// to be compared.
pub(super) fn offsets(curves: &[Curves]) -> Option<(Vec<i64>, ClockEvidence)> {
    let num = curves.len();
    let indices: Vec<(usize, usize)> = (0..num).flat_map(|i| (i + 1..num).map(move |j| (i, j))).collect();
    let pairs: Vec<Pair> = indices.par_iter().map(|&(i, j)| Pair::of(&curves[i], &curves[j])).collect();
    let place = |i: usize, j: usize| i * (2 * num - i - 1) / 2 + j - i - 1;
    let score = |i: usize, j: usize, late: i64| match i < j {
        true => pairs[place(i, j)].score(late),
        false => pairs[place(j, i)].score(-late),
    };
    let best = |i: usize, j: usize| match i < j {
        true => pairs[place(i, j)].best(),
        false => pairs[place(j, i)].best().map(|late| -late),
    };
    // From the surest pair to the next, as a spanning tree of all cameras.
    let mut lates: Vec<Option<i64>> = vec![None; num];
    lates[0] = Some(0);
    for _ in 1..num {
        let known = (0..num).filter_map(|i| lates[i].map(|late| (i, late)));
        let open = known.flat_map(|(i, late)| (0..num).filter(|&j| lates[j].is_none()).map(move |j| (i, late, j)));
        let candidates =
            open.filter_map(|(i, late, j)| best(i, j).map(|of_pair| (score(i, j, of_pair), j, late + of_pair)));
        let (_, j, late) = candidates.max_by(|a, b| a.0.total_cmp(&b.0))?;
        lates[j] = Some(late);
    }
    let mut lates: Vec<i64> = lates.into_iter().collect::<Option<_>>()?;
    // Then coordinate ascent: each camera moves to the best offset against all others, until none moves.
    for _ in 0..10 * num {
        let before = lates.clone();
        for j in 1..num {
            let others: Vec<usize> = (0..num).filter(|&i| i != j).collect();
            let wanted = others.iter().filter_map(|&i| best(i, j).map(|late| lates[i] + late));
            let candidates: Vec<i64> = wanted.flat_map(|late| late - 1..=late + 1).chain([lates[j]]).collect();
            let total = |late: &i64| others.iter().map(|&i| score(i, j, late - lates[i])).sum::<f64>();
            lates[j] = candidates.into_iter().max_by(|a, b| total(a).total_cmp(&total(b)))?;
        }
        if lates == before {
            break;
        }
    }
    let agrees = |i: usize, j: usize| best(i, j).is_some_and(|late| (late - (lates[j] - lates[i])).abs() <= 1);
    let agreeing = |j: usize| (0..num).filter(|&i| i != j && agrees(i, j)).count() as f64 / (num - 1) as f64;
    let prominence = |j: usize| {
        let others: Vec<usize> = (0..num).filter(|&i| i != j).collect();
        let total = |late: i64| others.iter().map(|&i| score(i, j, late - lates[i])).sum::<f64>();
        let known = others.iter().map(|&i| match i < j {
            true => pairs[place(i, j)].range().map(|late| lates[i] + late),
            false => pairs[place(j, i)].range().map(|late| lates[i] - late),
        });
        let known: Vec<i64> = known.flatten().collect();
        let (Some(&from), Some(&to)) = (known.iter().min(), known.iter().max()) else { return 0.0 };
        let is_other = |late: &i64| (late - lates[j]).abs() > PEAK;
        let second = (from..=to).filter(is_other).map(total).fold(0.0, f64::max);
        // Without correlation there is no certainty.
        if total(lates[j]) > 0.0 { total(lates[j]) / second.max(MIN_SECOND) } else { 0.0 }
    };
    let least = |of: &dyn Fn(usize) -> f64| (0..num).map(of).fold(f64::INFINITY, f64::min);
    let evidence = ClockEvidence { agreeing: least(&agreeing), prominence: least(&prominence) };
    Some((lates, evidence))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// Curves of one camera: the scene that all share, and the camera's own noise.
    fn seen(seed: u64, skipped: usize, own: f32) -> Curves {
        let mut scene = rand_pcg::Pcg32::seed_from_u64(7);
        let mut camera = rand_pcg::Pcg32::seed_from_u64(seed);
        let mut level = 0.0_f32;
        let changes: Vec<(f64, f32, f32)> = (0..150)
            .map(|i| {
                level = 0.8 * level + scene.random_range(-1.0_f32..1.0);
                let light = scene.random_range(-1.0_f32..1.0);
                let mut noise = || own * camera.random_range(-1.0_f32..1.0);
                ((i + 1) as f64 / 30.0, level + noise(), light + noise())
            })
            .collect();
        let begin_secs = skipped as f64 / 30.0;
        Curves::on_grid(&changes[skipped..], begin_secs, 30.0)
    }

    #[test]
    fn offsets_of_many_cameras_are_found() {
        let skipped = [5, 0, 17, 3, 30];
        let curves: Vec<Curves> = skipped.iter().zip(1..).map(|(&skipped, seed)| seen(seed, skipped, 0.5)).collect();
        let expected: Vec<i64> = skipped.iter().map(|&skipped| 5 - skipped as i64).collect();
        let (found, evidence) = offsets(&curves).unwrap();
        assert_eq!(found, expected);
        assert!(evidence.is_sure() && evidence.agreeing == 1.0, "{evidence:?}");
    }

    #[test]
    fn cameras_of_different_scenes_have_no_sure_offsets() {
        let curves: Vec<Curves> = (1..5).map(|seed| seen(seed, 0, 50.0)).collect();
        let (_, evidence) = offsets(&curves).unwrap();
        assert!(!evidence.is_sure(), "{evidence:?}");
        let still: Vec<Curves> = (1..4).map(|_| Curves(vec![vec![0.0; 100]; 3])).collect();
        assert!(offsets(&still).is_none_or(|(_, evidence)| !evidence.is_sure()));
    }
}
