//! Fits the settings of the codec to one scene: fewer bytes at the same PSNR than along the curve of qualities, which
//! has to suit all scenes.

use tcgs_codec::CompressSettings;
use tcgs_core::Attribute;

use super::PrunedScene;
use super::judge::Judge;
use super::target::{SearchResult, Target, search};
use crate::observe::{TuningTrial, tell};
use crate::{Event, Observer, PipelineError};

/// A setting, by its name for people, and how it moves by some strides: tolerances as lengths and finenesses by
/// factors, bits and exponents by sums.
struct Knob {
    name: &'static str,
    turn: fn(&mut CompressSettings, f32),
    stride: f32,
}

/// Widens the tolerance of an attribute by a power of two, as a length.
fn widen(settings: &mut CompressSettings, attribute: Attribute, by: f32) {
    settings.max_mse[attribute.index()] *= 4.0_f32.powf(by);
}

/// Takes bits from an attribute.
fn coarsen(settings: &mut CompressSettings, attribute: Attribute, by: f32) {
    settings.coarser[attribute.index()] += by;
}

/// All of them. Strides are as large as single steps of a search by hand that gained something.
const KNOBS: [Knob; 9] = [
    Knob { name: "tolerance of positions", turn: |s, by| widen(s, Attribute::Mean, by), stride: 0.4 },
    Knob { name: "tolerance of rotations", turn: |s, by| widen(s, Attribute::Quat, by), stride: 0.4 },
    Knob { name: "tolerance of colours", turn: |s, by| widen(s, Attribute::Color, by), stride: 0.4 },
    Knob { name: "bits less of rotations", turn: |s, by| coarsen(s, Attribute::Quat, by), stride: 0.5 },
    Knob { name: "bits less of scales", turn: |s, by| coarsen(s, Attribute::LogScale, by), stride: 0.5 },
    Knob { name: "bits less of opacities", turn: |s, by| coarsen(s, Attribute::LogitOpacity, by), stride: 0.5 },
    Knob { name: "bits less of colours", turn: |s, by| coarsen(s, Attribute::Color, by), stride: 0.5 },
    Knob { name: "fineness of positions", turn: |s, by| s.position_fineness *= 2.0_f32.powf(by), stride: 0.3 },
    Knob { name: "exponent of importance", turn: |s, by| s.importance += by, stride: 0.15 },
];
/// Strides are halved once nothing is gained by whole ones.
const SCALES: [f32; 2] = [1.0, 0.5];
/// Settings tried at most; each takes a compression and the pictures of the judge.
const MAX_TRIALS: usize = 150;
/// Least gain of a trial that counts, as a share of the bytes, and of all knobs together before they are tried once
/// more.
const LEAST_GAIN: f64 = 1e-4;
const LEAST_GAIN_OF_ALL: f64 = 2e-3;
/// Smallest gain of PSNR that a doubling of the bytes is taken to buy, dB: where more bytes show in no image, a search
/// would only follow noise.
const LEAST_SLOPE: f64 = 0.05;

/// What tuning found.
#[derive(Clone, Debug)]
pub struct Tuning {
    /// Length of the file and PSNR in dB before.
    pub start: (u64, f64),
    /// All settings tried, in order.
    pub trials: Vec<TuningTrial>,
    /// The chosen settings, no worse than before; their quality is counted from the tuned settings.
    pub found: SearchResult,
}

impl Tuning {
    /// By how much smaller the file is than before, as a share.
    pub fn saved(&self) -> f64 {
        1.0 - self.found.trial.bytes as f64 / self.start.0 as f64
    }
}

/// Coordinate descent over the settings, at equal PSNR: each is moved up and down as long as that gains, then all again
/// with smaller strides. In the end the quality is moved until the PSNR is as high as before, or until the target is
/// met again.
///
/// Every setting tried is told as [`Event::Tuned`], those of the searches along the quality as [`Event::Tried`].
///
/// - `settings`: to start from; with a target those of quality 0
/// - `judge`: best of training images, so that held-out ones can still tell what tuning is worth
///
/// # Errors
/// As [`search`].
pub fn tune(
    pruned: &PrunedScene,
    settings: &CompressSettings,
    target: Option<Target>,
    judge: &Judge,
    observer: &mut dyn Observer,
) -> Result<Tuning, PipelineError> {
    let settings = match target {
        Some(target) => search(pruned, settings, target, judge, observer)?.settings,
        None => settings.clone(),
    };
    let mut tuner = Tuner { pruned, judge, slope: 0.0, start: Measured::default(), trials: Vec::new() };
    let [below, above] = [-0.5, 0.5].map(|quality| tuner.measure(&settings.clone().with_quality(quality)));
    let (below, above) = (below?, above?);
    tuner.slope = ((above.psnr - below.psnr) / (above.log_bytes() - below.log_bytes())).max(LEAST_SLOPE);
    tuner.start = tuner.measure(&settings)?;
    let best = tuner.descend(&settings, observer)?;

    let Tuner { start, trials, .. } = tuner;
    let aim = target.unwrap_or(Target::Psnr(start.psnr));
    let found = match search(pruned, &best, aim, judge, observer) {
        // Settings that nearly met the target before may miss it after.
        Err(PipelineError::TargetPsnr { .. } | PipelineError::TargetBytes { .. }) => None,
        found => Some(found?),
    };
    let is_better = |found: &SearchResult| match aim {
        Target::Psnr(_) => found.trial.bytes < start.bytes,
        Target::Bytes(_) => found.trial.psnr.is_some_and(|psnr| psnr > start.psnr),
    };
    let found = match found.filter(is_better) {
        Some(found) => found,
        None => SearchResult::of(pruned, settings, start.psnr)?,
    };
    Ok(Tuning { start: (start.bytes, start.psnr), trials, found })
}

/// The result of some settings.
#[derive(Clone, Copy, Default)]
struct Measured {
    bytes: u64,
    /// dB
    psnr: f64,
}

impl Measured {
    fn log_bytes(&self) -> f64 {
        (self.bytes as f64).log2()
    }
}

struct Tuner<'a> {
    pruned: &'a PrunedScene<'a>,
    judge: &'a Judge,
    /// Gain of a doubling of the bytes along the curve of qualities, dB.
    slope: f64,
    start: Measured,
    trials: Vec<TuningTrial>,
}

impl Tuner<'_> {
    fn measure(&self, settings: &CompressSettings) -> Result<Measured, PipelineError> {
        let (compact, file) = self.pruned.try_out(settings)?;
        Ok(Measured { bytes: file.len() as u64, psnr: self.judge.psnr(&compact)? })
    }

    /// Fewer bytes than at the start, as a share, if the rest of the PSNR were turned into bytes.
    fn saved(&self, measured: &Measured) -> f64 {
        let doublings = measured.log_bytes() - self.start.log_bytes() - (measured.psnr - self.start.psnr) / self.slope;
        1.0 - doublings.exp2()
    }

    fn descend(
        &mut self,
        settings: &CompressSettings,
        observer: &mut dyn Observer,
    ) -> Result<CompressSettings, PipelineError> {
        let (mut best, mut saved) = (settings.clone(), 0.0);
        for scale in SCALES {
            loop {
                let before = saved;
                for knob in &KNOBS {
                    for by in [scale * knob.stride, -scale * knob.stride] {
                        while self.trials.len() < MAX_TRIALS {
                            let mut tried = best.clone();
                            (knob.turn)(&mut tried, by);
                            let measured = self.measure(&tried)?;
                            let of_tried = self.saved(&measured);
                            let is_better = of_tried > saved + LEAST_GAIN;
                            let Measured { bytes, psnr } = measured;
                            let saved_now = is_better.then_some(of_tried);
                            let trial = TuningTrial { setting: knob.name, bytes, psnr, saved: saved_now };
                            tell(observer, Event::Tuned(&trial))?;
                            self.trials.push(trial);
                            if !is_better {
                                break;
                            }
                            (best, saved) = (tried, of_tried);
                        }
                    }
                }
                if saved - before < LEAST_GAIN_OF_ALL {
                    break;
                }
            }
        }
        Ok(best)
    }
}
