//! Finds settings for bounds on errors: each attribute that errs by too much gets finer, until none does or rounding to
//! 16 bits is what is left.

use tcgs_codec::{CompactFile, CompressSettings};
use tcgs_core::Attribute;

use super::PrunedScene;
use crate::observe::tell;
use crate::{ErrorTrial, Event, Observer, PipelineError};

/// Settings tried at most.
const MAX_TRIALS: usize = 12;
/// Settings that halve an error rarely halve it exactly.
const MARGIN: f64 = 1.25;
/// An attribute is made finer by this in all. The errors that are left come from the 16 bits of codes.
const MAX_FACTOR: f64 = (1 << 24) as f64;
/// An attribute whose error falls by less than this although it is made finer is stuck,
const LEAST_FALL: f64 = 0.8;
/// and made finer by this, and by its square if it still is.
const STRIDE: f64 = 16.0;

/// The result of a search.
#[derive(Clone, Debug)]
pub struct ErrorSearch {
    /// All settings tried, in order; the last is the chosen one.
    pub trials: Vec<ErrorTrial>,
    /// The scene as symbols, with the errors of all attributes.
    pub compact: CompactFile,
    /// The same as bytes.
    pub file: Vec<u8>,
}

/// An attribute with a bound.
struct Bounded<'a> {
    name: &'a str,
    wanted: f64,
    /// In all settings tried.
    smallest: f64,
    /// In the setting tried last.
    last: f64,
    /// Whether quantizers cover all of its values: the errors of outliers that were cut off say nothing of the others.
    is_covered: bool,
    /// Ratio of the first value to the present one.
    factor: f64,
    /// How often in a row that did not help.
    num_stuck: i32,
}

/// Searches settings whose errors keep some bounds: those given, made finer attribute by attribute. Every setting tried
/// is told as [`Event::Measured`].
///
/// - `pruned`: with version 2 of the format, which declares errors
/// - `settings`: to start from
/// - `bounds`: by name of the attribute, in the unit of [`tcgs_codec::attribute_error`], 0 or more
///
/// # Errors
/// [`PipelineError::MaxError`] if no setting keeps a bound; [`PipelineError::Input`] if the scene has no such
/// attribute; [`PipelineError::Stopped`] if the observer broke off.
pub fn search_errors(
    pruned: &PrunedScene,
    settings: &CompressSettings,
    bounds: &[(String, f64)],
    observer: &mut dyn Observer,
) -> Result<ErrorSearch, PipelineError> {
    let layout = pruned.layout();
    let mut bounded: Vec<Bounded> = bounds.iter().map(|(name, wanted)| Bounded::new(name, *wanted)).collect();
    let unknown = bounded.iter().find(|bound| layout.find(bound.name).is_none());
    if let Some(Bounded { name, .. }) = unknown {
        let names: Vec<&str> = layout.columns().iter().map(|column| &column.name[..]).collect();
        return Err(PipelineError::input(name, "no attribute of the scene", format!("one of {}", names.join(", "))));
    }
    let (mut settings, mut trials) = (settings.clone(), Vec::new());
    loop {
        let (compact, file) = pruned.compress(&settings)?;
        let declared = |name: &str| {
            let of = compact.declared_errors.iter().find(|(of, _)| of == name);
            of.map_or(f64::INFINITY, |(_, error)| f64::from(*error))
        };
        let errors = bounded.iter().map(|bound| (bound.name.to_owned(), declared(bound.name))).collect();
        let trial = ErrorTrial { bytes: file.len() as u64, errors };
        tell(observer, Event::Measured(&trial))?;
        trials.push(trial);
        let mut factors = Vec::new();
        for bound in &mut bounded {
            let error = declared(bound.name);
            bound.smallest = bound.smallest.min(error);
            if error > bound.wanted {
                if bound.factor >= MAX_FACTOR || trials.len() == MAX_TRIALS {
                    return Err(bound.out_of_reach());
                }
                let finer = bound.next_factor(error);
                let column = layout.find(bound.name).map(|attribute| layout.column(attribute));
                factors.extend(column.map(|column| (column, finer as f32)));
            }
            bound.last = error;
        }
        if factors.is_empty() {
            return Ok(ErrorSearch { trials, compact, file });
        }
        settings = settings.with_smaller_errors(&factors);
    }
}

impl<'a> Bounded<'a> {
    fn new(name: &'a str, wanted: f64) -> Self {
        let is_covered = name == Attribute::Mean.name();
        Self { name, wanted, smallest: f64::INFINITY, last: f64::INFINITY, is_covered, factor: 1.0, num_stuck: 0 }
    }

    /// Divisor that makes it finer now.
    fn next_factor(&mut self, error: f64) -> f64 {
        if !self.is_covered {
            self.is_covered = true;
            return 1.0;
        }
        let is_stuck = self.factor > 1.0 && error > LEAST_FALL * self.last;
        self.num_stuck = if is_stuck { self.num_stuck + 1 } else { 0 };
        let finer = (MARGIN * error / self.wanted).max(STRIDE.powi(self.num_stuck)).min(MAX_FACTOR / self.factor);
        self.factor *= finer;
        finer
    }

    fn out_of_reach(&self) -> PipelineError {
        // Rounded up to the printed digits, so that the printed value can be reached.
        let unit = 10.0_f64.powf(self.smallest.log10().floor() - 3.0);
        let smallest = if unit.is_normal() { (self.smallest / unit).ceil() * unit } else { self.smallest };
        PipelineError::MaxError { attribute: self.name.to_owned(), wanted: self.wanted, smallest }
    }
}
