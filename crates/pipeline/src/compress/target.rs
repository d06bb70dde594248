//! Finds the setting for a size or a quality: one number moves all settings of the codec together, and a search
//! along it stops at the best that keeps within the target.

use std::ops::RangeInclusive;

use tcgs_codec::{CompactFile, CompressSettings};

use super::PrunedScene;
use super::judge::Judge;
use crate::observe::{Trial, tell};
use crate::{Event, Observer, PipelineError};

/// Quality is searched in steps of 1 / this, so that the one found can be said in two decimals.
const STEPS: i32 = Trial::STEPS;
/// Lowest and highest quality, in these steps. Below, almost every code has its fewest bits; above, errors vanish
/// in the rounding of pictures to 8 bits.
const RANGE: (i32, i32) = (-6 * STEPS, 8 * STEPS);
/// Qualities that [`CompressSettings::with_quality`] gives files for and that [`search`] tries.
pub const QUALITY_RANGE: RangeInclusive<f32> = (RANGE.0 / STEPS) as f32..=(RANGE.1 / STEPS) as f32;
/// First strides from quality 0.
const FIRST_STRIDE: i32 = STEPS;
/// A file this close below a target is close enough, as a share of it.
const CLOSE_BYTES: f64 = 0.005;
/// A quality this close above a target is close enough.
const CLOSE_DB: f64 = 0.005;
/// Settings tried at most.
const MAX_TRIALS: usize = 16;

/// What is wanted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// The best quality whose file has at most so many bytes.
    Bytes(u64),
    /// The smallest file with at least this PSNR, dB.
    Psnr(f64),
}

/// The result of a search.
#[derive(Clone, Debug)]
pub struct SearchResult {
    /// The chosen setting; its PSNR was measured.
    pub trial: Trial,
    /// All settings tried, in order.
    pub trials: Vec<Trial>,
    /// The chosen setting.
    pub settings: CompressSettings,
    /// The scene as symbols.
    pub compact: CompactFile,
    /// The same as bytes.
    pub file: Vec<u8>,
}

impl SearchResult {
    /// Settings that need no search, since their PSNR in dB is known.
    pub(super) fn of(pruned: &PrunedScene, settings: CompressSettings, psnr: f64) -> Result<Self, PipelineError> {
        let (compact, file) = pruned.compress(&settings)?;
        let trial = Trial { steps: 0, bytes: file.len() as u64, psnr: Some(psnr) };
        Ok(Self { trial, trials: vec![trial], settings, compact, file })
    }
}

/// Searches the setting for a target. Every setting tried is told as [`Event::Tried`].
///
/// - `settings`: those of quality 0
///
/// # Errors
/// [`PipelineError::TargetBytes`] or [`PipelineError::TargetPsnr`] if no setting meets the target;
/// [`PipelineError::Stopped`] if the observer broke off.
pub fn search(
    pruned: &PrunedScene,
    settings: &CompressSettings,
    target: Target,
    judge: &Judge,
    observer: &mut dyn Observer,
) -> Result<SearchResult, PipelineError> {
    let (trials, best) = search_with(target, |steps| {
        let of_trial = settings.clone().with_quality(steps as f32 / STEPS as f32);
        let (compact, file) = pruned.try_out(&of_trial)?;
        let psnr = match target {
            Target::Bytes(_) => None,
            Target::Psnr(_) => Some(judge.psnr(&compact)?),
        };
        let trial = Trial { steps, bytes: file.len() as u64, psnr };
        tell(observer, Event::Tried(&trial))?;
        Ok((trial, of_trial))
    })?;
    let Some((mut trial, settings)) = best else {
        return Err(unreachable_target(target, &trials, judge));
    };
    let (compact, file) = pruned.compress(&settings)?;
    if trial.psnr.is_none() {
        trial.psnr = Some(judge.psnr(&compact)?);
        tell(observer, Event::Tried(&trial))?;
    }
    Ok(SearchResult { trial, trials, settings, compact, file })
}

/// All trials, and the best that meets the target, if any does, with what it gave.
type Tried<T> = (Vec<Trial>, Option<(Trial, T)>);

/// Tries until nothing better is to be expected.
fn search_with<T>(
    target: Target,
    mut try_out: impl FnMut(i32) -> Result<(Trial, T), PipelineError>,
) -> Result<Tried<T>, PipelineError> {
    let (mut trials, mut best): Tried<T> = (Vec::new(), None);
    let mut bracket = Bracket::new();
    while let Some(steps) = bracket.next().filter(|_| trials.len() < MAX_TRIALS) {
        let (trial, gave) = try_out(steps)?;
        trials.push(trial);
        bracket.narrow(steps, target.excess(&trial));
        if target.is_met(&trial) && best.as_ref().is_none_or(|(best, _)| target.prefers(&trial, best)) {
            best = Some((trial, gave));
        }
        if target.is_close(&trial) {
            break;
        }
    }
    Ok((trials, best))
}

fn unreachable_target(target: Target, trials: &[Trial], judge: &Judge) -> PipelineError {
    match target {
        Target::Bytes(target) => {
            PipelineError::TargetBytes { target, smallest: trials.iter().map(|t| t.bytes).min().unwrap_or(0) }
        }
        Target::Psnr(target) => {
            let best = trials.iter().filter_map(|t| t.psnr).fold(f64::MIN, f64::max);
            // Rounded down, so that what is named can be reached.
            PipelineError::TargetPsnr { target, best: (100.0 * best).floor() / 100.0, of: judge.of.clone() }
        }
    }
}

impl Target {
    /// By how much a trial is above what is aimed at, the middle of what is close enough; nearly straight along the
    /// quality.
    fn excess(self, trial: &Trial) -> f64 {
        match self {
            Self::Bytes(bytes) => (trial.bytes as f64 / bytes as f64).ln() + CLOSE_BYTES / 2.0,
            Self::Psnr(psnr) => trial.psnr.unwrap_or(f64::NAN) - psnr - CLOSE_DB / 2.0,
        }
    }

    fn is_met(self, trial: &Trial) -> bool {
        match self {
            Self::Bytes(bytes) => trial.bytes <= bytes,
            Self::Psnr(psnr) => trial.psnr.is_some_and(|measured| measured >= psnr),
        }
    }

    fn is_close(self, trial: &Trial) -> bool {
        let close = if matches!(self, Self::Bytes(_)) { CLOSE_BYTES } else { CLOSE_DB };
        self.is_met(trial) && self.excess(trial).abs() <= close / 2.0
    }

    /// The better of two that meet the target.
    fn prefers(self, trial: &Trial, other: &Trial) -> bool {
        match self {
            Self::Bytes(_) => trial.steps > other.steps,
            Self::Psnr(_) => trial.bytes < other.bytes,
        }
    }
}

/// Where the target lies, as far as known: between a quality of negative excess and one of positive.
#[derive(Default)]
struct Bracket {
    low: Option<(i32, f64)>,
    high: Option<(i32, f64)>,
    stride: i32,
    /// How often in a row the same side moved: the high one, or the low one where negative.
    same_side: i32,
}

impl Bracket {
    fn new() -> Self {
        Self { stride: FIRST_STRIDE, ..Self::default() }
    }

    /// The next to try; none if nothing lies between.
    fn next(&mut self) -> Option<i32> {
        let outwards = match (self.low, self.high) {
            (None, None) => return Some(0),
            (Some((low, below)), Some((high, above))) => {
                if high - low <= 1 {
                    return None;
                }
                // Where a straight line crosses zero; the middle where that side keeps moving.
                let share = if self.same_side.abs() > 1 { 0.5 } else { (below / (below - above)).clamp(0.05, 0.95) };
                let next = low + (share * f64::from(high - low)).round() as i32;
                return Some(next.clamp(low + 1, high - 1));
            }
            (Some((low, _)), None) => low + self.stride,
            (None, Some((high, _))) => high - self.stride,
        };
        self.stride *= 2;
        let known = self.low.or(self.high).map(|(steps, _)| steps);
        Some(outwards.clamp(RANGE.0, RANGE.1)).filter(|&next| Some(next) != known)
    }

    fn narrow(&mut self, steps: i32, excess: f64) {
        let (side, way) = if excess < 0.0 { (&mut self.low, -1) } else { (&mut self.high, 1) };
        *side = Some((steps, excess));
        self.same_side = if self.same_side * way > 0 { self.same_side + way } else { way };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Trials until a search along `bytes(quality)` ends, and the best quality found.
    fn run(bytes: impl Fn(f64) -> f64, target: u64) -> (usize, Option<Trial>) {
        let try_out = |steps| {
            let bytes = bytes(f64::from(steps) / f64::from(STEPS)) as u64;
            Ok((Trial { steps, bytes, psnr: None }, ()))
        };
        let (trials, best) = search_with(Target::Bytes(target), try_out).unwrap();
        (trials.len(), best.map(|(trial, ())| trial))
    }

    #[test]
    fn a_search_ends_close_to_its_target() {
        let smooth = |q: f64| 150_000.0 * (0.3 * q + 0.01 * q * q).exp();
        let stairs = |q: f64| smooth(q.floor());
        for target in [60_000, 100_000, 150_000, 151_000, 400_000, 1_000_000] {
            let (count, best) = run(smooth, target);
            let bytes = best.expect("a file that is small enough").bytes;
            assert!(count <= MAX_TRIALS, "{count} for {target}");
            assert!(bytes <= target && bytes as f64 >= (1.0 - CLOSE_BYTES) * target as f64, "{bytes} for {target}");
            let (count, best) = run(stairs, target);
            let best = best.expect("a file that is small enough");
            assert!(count <= MAX_TRIALS && best.bytes <= target);
            assert!(stairs(best.quality().floor() + 1.0) > target as f64, "{best:?} for {target}");
        }
    }

    #[test]
    fn what_is_out_of_reach_is_not_found() {
        let bytes = |q: f64| 1000.0 + 150_000.0 * (0.3 * q).exp();
        assert_eq!(run(bytes, 1_000).1, None);
        let (count, best) = run(bytes, 100_000_000);
        assert!(count <= MAX_TRIALS);
        assert_eq!(best.map(|b| b.steps), Some(RANGE.1));
    }

    #[test]
    fn of_two_that_meet_a_target_the_better_is_taken() {
        let trial = |steps, bytes, psnr| Trial { steps, bytes, psnr: Some(psnr) };
        assert!(Target::Bytes(9).prefers(&trial(2, 8, 30.0), &trial(1, 7, 29.0)));
        // Near its ceiling the PSNR may fall while files grow.
        assert!(Target::Psnr(29.0).prefers(&trial(1, 7, 29.5), &trial(2, 8, 29.4)));
        assert!(Target::Psnr(29.0).is_met(&trial(1, 7, 29.0)) && !Target::Psnr(29.0).is_met(&trial(1, 7, 28.999)));
    }
}
