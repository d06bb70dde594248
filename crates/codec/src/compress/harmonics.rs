//! Which Gaussians keep which bands of spherical harmonics, and the bit widths of the coefficients.

use std::f64::consts::PI;

use tcgs_core::{Attribute, Gaussians};

use super::CompressSettings;
use super::statistics::Statistics;
use crate::bits::BitMap;
use crate::quantize::MAX_BITS;

/// Share of the coefficients of a band that may lie beyond the range for which the bits are counted.
const BEYOND: f64 = 0.001;

/// Sets the widths of all bands of harmonics by the tolerance of each Gaussian. The tolerance is
/// [`CompressSettings::harmonic_error`], divided by a power of the sensitivity of the images to the Gaussian's band. If
/// omitting the band errs by less, its width is 0. Else it gets enough bits to keep the rounding error below the
/// tolerance. Without a positive `harmonic_error` all widths stay those of the bit map.
///
/// The root mean square over all directions of `Σ Y_lm c_lm` is `√(Σ c_lm² / 4π)`, since harmonics are orthonormal.
///
/// - `measured`: the widths by sensitivity, one bit more where the sensitivity doubles
///   ([`assign_bits`](crate::assign_bits))
pub(super) fn set_widths(
    bit_map: &mut BitMap,
    measured: &BitMap,
    statistics: &Statistics,
    settings: &CompressSettings,
) {
    let error = f64::from(settings.harmonic_error);
    if error <= 0.0 {
        return;
    }
    for attribute in statistics.first.layout().harmonics() {
        let samples = samples(statistics, attribute);
        let components = attribute.components();
        let errors = errors(&measured.widths[attribute.index()], error, settings.importance.into());
        let of = |g: usize| samples.iter().map(move |values| &values[g * components..][..components]);
        let keeps = |g: usize| of(g).map(rms).fold(0.0, f64::max) >= errors[g];
        let kept: Vec<usize> = (0..errors.len()).filter(|&g| keeps(g)).collect();
        let range = range(kept.iter().flat_map(|&g| of(g).flatten()).map(|x| x.abs()).collect());
        let bits = |error: f64| {
            // Rounding has an error of step / √12 in each of 2l + 1 coefficients of a channel.
            let step = error * (4.0 * PI * 12.0 / (components as f64 / 3.0)).sqrt();
            (2.0 * range / step + 1.0).log2().ceil().clamp(1.0, f64::from(MAX_BITS)) as u8
        };
        let widths = &mut bit_map.widths[attribute.index()];
        widths.fill(0);
        kept.into_iter().for_each(|g| widths[g] = bits(errors[g]));
    }
}

/// `[N]` tolerances of Gaussians: `error` divided by the power `importance / 2` of the sensitivity, relative to its
/// geometric mean over Gaussians. [`CompressSettings::importance`] is a power for squared errors, hence the half.
///
/// - `widths`: `[N]` widths by sensitivity, one bit more where it doubles
fn errors(widths: &[u8], error: f64, importance: f64) -> Vec<f64> {
    let mean = widths.iter().map(|&w| f64::from(w)).sum::<f64>() / widths.len().max(1) as f64;
    widths.iter().map(|&w| error * (0.5 * importance * (mean - f64::from(w))).exp2()).collect()
}

/// `[N * components]` values at up to three timesteps.
fn samples(statistics: &Statistics, attribute: Attribute) -> Vec<Vec<f32>> {
    let column = &statistics.columns[attribute.index()];
    if !column.varies {
        return vec![Gaussians::values(&statistics.first, attribute).to_vec()];
    }
    (0..3).map(|i| column.samples.iter().map(|sample| sample[i]).collect()).collect()
}

/// Root mean square over all directions of a band's contribution to a colour, for the channel with the largest.
///
/// - `band`: `[2l + 1, 3]`
fn rms(band: &[f32]) -> f64 {
    let of_channel = |c: usize| band.iter().skip(c).step_by(3).map(|&x| f64::from(x).powi(2)).sum::<f64>();
    ((0..3).map(of_channel).fold(0.0, f64::max) / (4.0 * PI)).sqrt()
}

/// The quantile `1 - BEYOND` of some absolute values.
fn range(mut values: Vec<f32>) -> f64 {
    let place = ((1.0 - BEYOND) * values.len() as f64) as usize;
    let Some(place) = values.len().checked_sub(1).map(|last| place.min(last)) else { return 0.0 };
    f64::from(*values.select_nth_unstable_by(place, f32::total_cmp).1)
}
