//! Which Gaussians keep which bands of spherical harmonics, and how many bits the coefficients take.

use std::f64::consts::PI;

use tcgs_core::{Attribute, Gaussians, sigmoid};

use super::CompressSettings;
use super::statistics::Statistics;
use crate::bits::BitMap;
use crate::quantize::MAX_BITS;

/// Of the coefficients of a band so many may lie beyond the range that the bits are counted for.
const BEYOND: f64 = 0.001;

/// Sets the widths of all bands of harmonics: 0 for a Gaussian that looks alike without the band, and for all others as
/// many bits as make the error of rounding [`CompressSettings::harmonic_error`]. If that is 0, all keep the widths of
/// the bit map.
///
/// The root mean square over all directions of `Σ Y_lm c_lm` is `√(Σ c_lm² / 4π)`, since harmonics are orthonormal.
pub(super) fn set_widths(bit_map: &mut BitMap, statistics: &Statistics, settings: &CompressSettings) {
    let error = f64::from(settings.harmonic_error);
    if error <= 0.0 {
        return;
    }
    for attribute in statistics.first.layout().harmonics() {
        let samples = samples(statistics, attribute);
        let widths = &mut bit_map.widths[attribute.index()];
        let components = attribute.components();
        let mut kept: Vec<f32> = Vec::new();
        for (g, width) in widths.iter_mut().enumerate() {
            let opacity = f64::from(sigmoid(statistics.first.logit_opacities()[g]));
            let most = samples.iter().map(|of| rms(&of[g * components..][..components])).fold(0.0, f64::max);
            if opacity * most < error {
                *width = 0;
            } else {
                kept.extend(samples.iter().flat_map(|of| &of[g * components..][..components]).map(|x| x.abs()));
            }
        }
        // Rounding to steps errs by step / √12 in each of 2l + 1 coefficients of a channel.
        let step = error * (4.0 * PI * 12.0 / (components as f64 / 3.0)).sqrt();
        let bits = (2.0 * range(kept) / step + 1.0).log2().ceil().clamp(1.0, f64::from(MAX_BITS));
        widths.iter_mut().filter(|width| **width > 0).for_each(|width| *width = bits as u8);
    }
}

/// `[N * components]` values at some timesteps.
fn samples(statistics: &Statistics, attribute: Attribute) -> Vec<Vec<f32>> {
    let column = &statistics.columns[attribute.index()];
    if !column.varies {
        return vec![Gaussians::values(&statistics.first, attribute).to_vec()];
    }
    (0..3).map(|i| column.samples.iter().map(|sample| sample[i]).collect()).collect()
}

/// Root mean square over all directions of what a band adds to a colour, of the channel that it adds most to.
///
/// - `band`: `[2l + 1, 3]`
fn rms(band: &[f32]) -> f64 {
    let of_channel = |c: usize| band.iter().skip(c).step_by(3).map(|&x| f64::from(x).powi(2)).sum::<f64>();
    ((0..3).map(of_channel).fold(0.0, f64::max) / (4.0 * PI)).sqrt()
}

/// A bound that all but a few of some absolute values keep.
fn range(mut values: Vec<f32>) -> f64 {
    let place = ((1.0 - BEYOND) * values.len() as f64) as usize;
    let Some(place) = values.len().checked_sub(1).map(|last| place.min(last)) else { return 0.0 };
    f64::from(*values.select_nth_unstable_by(place, f32::total_cmp).1)
}
