//! Tolerance of each track: the mean squared error allowed between the track and its keypoints. Also the quantizers for
//! the values at keypoints.

use std::collections::BTreeMap;

use rayon::prelude::*;
use tcgs_core::{Attribute, Column};

use super::CompressSettings;
use super::order::tolerance_factors;
use super::statistics::Statistics;
use crate::error::CompressError;
use crate::quantize::{MAX_BITS, Quantizer, Quantizers};

/// Tolerances of all tracks of a column.
pub(super) struct Tolerances<'a> {
    /// `[N]` bit widths.
    widths: &'a [u8],
    /// By width and channel: mean squared error, and the noise floor below which the tolerance never falls.
    by_width: Vec<Vec<(f32, f32)>>,
    /// `[N]` factors; empty if all are 1.
    factors: Vec<f32>,
}

impl<'a> Tolerances<'a> {
    /// Tolerances of the tracks of a column that varies.
    pub(super) fn new(
        statistics: &Statistics,
        column: &Column,
        widths: &'a [u8],
        learned: Option<&Quantizers>,
        position_step: Option<f64>,
        settings: &CompressSettings,
    ) -> Result<Self, CompressError> {
        let (attribute, components) = (column.attribute, column.components());
        let max_mse = settings.max_mse[CompressSettings::place_of(column)];
        let mut by_width = vec![vec![(max_mse, 0.0); components]; usize::from(MAX_BITS) + 1];
        if settings.keypoints && settings.noise_floor {
            // The final quantizers need the keypoints, which need the steps. Quantizers of three timesteps give the
            // steps.
            let samples = &statistics.columns[attribute.index()].samples;
            let values = |gaussian: usize, channel: usize, values: &mut Vec<f32>| {
                values.extend(samples[gaussian * components + channel]);
            };
            for (width, quantizers) in quantizers_for(column, values, widths, learned, position_step, settings)? {
                by_width[usize::from(width)] = quantizers.iter().map(|q| (max_mse, (q.step / 4.0).powi(2))).collect();
            }
        }
        Ok(Self { widths, by_width, factors: tolerance_factors(&statistics.first, attribute, settings) })
    }

    /// `[components]` tolerances of the tracks of a Gaussian.
    pub(super) fn of(&self, gaussian: usize) -> impl Iterator<Item = f32> {
        let factor = self.factors.get(gaussian).copied().unwrap_or(1.0);
        let by_channel = &self.by_width[usize::from(self.widths[gaussian])];
        by_channel.iter().map(move |&(max_mse, floor)| f32::max(max_mse * factor, floor))
    }
}

/// Largest squared error of a learned quantizer, relative to the fitted one. Training rounded to the learned quantizer,
/// and its errors are placed where they do not show, so it may err more. A larger ratio means that values have left its
/// range since training.
const LEARNED_ERROR_RATIO: f64 = 2.0;

/// Fits quantizers for every width in use.
///
/// - `append_values`: appends the values to be quantised, of one channel of a Gaussian
pub(super) fn quantizers_for(
    column: &Column,
    append_values: impl Fn(usize, usize, &mut Vec<f32>) + Sync,
    widths: &[u8],
    learned: Option<&Quantizers>,
    position_step: Option<f64>,
    settings: &CompressSettings,
) -> Result<BTreeMap<u8, Vec<Quantizer>>, CompressError> {
    let attribute = column.attribute;
    let covers = attribute == Attribute::Mean || settings.covers_outliers[CompressSettings::place_of(column)];
    let mut groups: BTreeMap<u8, Vec<usize>> = BTreeMap::new();
    // An attribute that a Gaussian lacks has the width 0.
    for (gaussian, &width) in widths.iter().enumerate().filter(|(_, width)| **width > 0) {
        groups.entry(width).or_default().push(gaussian);
    }
    let groups: Vec<_> = groups.into_iter().collect();
    groups
        .into_par_iter()
        .map(|(width, gaussians)| {
            let quantizers = (0..attribute.components()).into_par_iter().map(|channel| {
                let mut values = Vec::new();
                gaussians.iter().for_each(|&gaussian| append_values(gaussian, channel, &mut values));
                if covers {
                    let (min, max) = values.iter().fold((f32::MAX, f32::MIN), |(a, b), &x| (a.min(x), b.max(x)));
                    let covering = Quantizer::covering(min, max, width)?;
                    let step = position_step.filter(|_| attribute == Attribute::Mean);
                    let step = step.filter(|&step| step > f64::from(covering.step));
                    return step.map_or(Ok(covering), |step| Quantizer::from_lowest(min, step, width));
                }
                let fitted = Quantizer::fit(&values, width)?;
                let learned = learned.and_then(|l| l.get(attribute, width, channel)).filter(|q| q.bits == width);
                Ok(match learned {
                    Some(q)
                        if q.problem().is_none()
                            && q.squared_error(&values) <= LEARNED_ERROR_RATIO * fitted.squared_error(&values) =>
                    {
                        *q
                    }
                    _ => fitted,
                })
            });
            Ok((width, quantizers.collect::<Result<_, CompressError>>()?))
        })
        .collect()
}
