//! Shared by readers of one timestep: conversion of a file's numbers to stored values, and refusal of numbers that are
//! not finite.

use std::path::Path;
use std::sync::Arc;

use tcgs_core::{Gaussians, HARMONIC_0, Layout};

use crate::InterchangeError;
use crate::notes::Replaced;

/// The Gaussians that the start of a file declares.
#[derive(Clone, Debug)]
pub(crate) struct Head {
    /// `N`, at least 1, and not more than the file's length has room for.
    pub num_gaussians: usize,
    /// With the harmonics that are read.
    pub layout: Arc<Layout>,
}

/// sRGB of the coefficient of degree 0.
pub(crate) fn color_from_sh0(sh0: f32) -> f32 {
    (0.5 + HARMONIC_0 * f64::from(sh0)) as f32
}

/// The coefficient of degree 0 of an sRGB channel: the largest finite one of a colour for which it would be infinite,
/// which readers refuse.
pub(crate) fn sh0_from_color(color: f32) -> f32 {
    let largest = f64::from(f32::MAX);
    ((f64::from(color) - 0.5) / HARMONIC_0).clamp(-largest, largest) as f32
}

/// Inverse logistic of an opacity. Exactly 0 and 1 have none, so those and what is nearer to them than `nearest` are
/// taken for what is `nearest` to them.
///
/// - `opacity`: in `[0, 1]`
/// - `nearest`: above 0; a quarter of the step of a file's numbers is the middle of what such a file writes as 0 or 1
pub(crate) fn logit(opacity: f64, nearest: [f64; 2]) -> f32 {
    let (opacity, rest) = (opacity.max(nearest[0]), (1.0 - opacity).max(nearest[1]));
    (opacity / rest).ln() as f32
}

/// The largest component of a rotation, and the three others in turn, with the sign that makes the largest positive:
/// readers compute it from the others. The first of equally large ones is the largest.
///
/// - `unit`: components of a unit quaternion in the order of a file
pub(crate) fn smallest_three(unit: [f64; 4]) -> (usize, [f64; 3]) {
    let which = (1..4).fold(0, |which, c| if unit[c].abs() > unit[which].abs() { c } else { which });
    let sign = if unit[which] < 0.0 { -1.0 } else { 1.0 };
    let mut others = (0..4).filter(|&c| c != which).map(|c| sign * unit[c]);
    (which, std::array::from_fn(|_| others.next().unwrap_or_default()))
}

/// Coefficients of degree 1 and above, Gaussian by Gaussian: by degree and order, red, green and blue together.
pub(crate) fn harmonics_in_rows(gaussians: &Gaussians) -> Vec<f32> {
    let bands = gaussians.layout().harmonics();
    let mut all = Vec::new();
    for i in 0..gaussians.num_gaussians() {
        for &band in &bands {
            let components = band.components();
            all.extend_from_slice(&gaussians.values(band)[i * components..][..components]);
        }
    }
    all
}

/// [`logit`] of an opacity of 8 bits.
pub(crate) fn logit_of_byte(byte: u8) -> f32 {
    logit(f64::from(byte) / 255.0, [0.25 / 255.0; 2])
}

/// Distance from 0 and 1 of the opacities that replace them: half of the step of floats below 1.
const NEAREST_OF_FLOATS: [f64; 2] = [1.0 / (1 << 25) as f64; 2];

/// Replaces the log scale of a scale of 0: 2e-9 scene units, thinner than any picture shows. The smallest log scale of
/// a float, -87, would be worse: a quantizer spans all scales of a scene, and its step would grow fivefold.
const LEAST_LOG_SCALE: f32 = -20.0;

/// Replaces infinite logits, which programs write for opacities of exactly 0 and 1. Replaces log scales of -∞, which
/// they write for scales of 0. Refuses all other numbers that are not finite: a Gaussian of infinite scale cannot be
/// drawn.
///
/// Without harmonics negative colours become zero, since renderers of such files clamp colours at zero; with them they
/// clamp the sum.
pub(crate) fn checked(path: &Path, mut gaussians: Gaussians) -> Result<(Gaussians, Replaced), InterchangeError> {
    let mut replaced = Replaced::default();
    for x in gaussians.logit_opacities_mut().iter_mut().filter(|x| x.is_infinite()) {
        *x = logit(if *x > 0.0 { 1.0 } else { 0.0 }, NEAREST_OF_FLOATS);
        replaced.opacities += 1;
    }
    let scales = gaussians.log_scales_mut().as_flattened_mut().iter_mut();
    for x in scales.filter(|x| **x == f32::NEG_INFINITY) {
        *x = LEAST_LOG_SCALE;
        replaced.scales += 1;
    }
    if gaussians.layout().is_base() {
        for color in gaussians.colors_mut().as_flattened_mut().iter_mut().filter(|color| **color < 0.0) {
            *color = 0.0;
        }
    }
    for column in gaussians.layout().columns() {
        let values = gaussians.values(column.attribute);
        if let Some(i) = values.iter().position(|x| !x.is_finite()) {
            let (name, gaussian) = (&column.name, i / column.components());
            let problem = format!("{name} of Gaussian {gaussian}: {}, expected a finite number", values[i]);
            return Err(InterchangeError::File { path: path.into(), problem });
        }
    }
    Ok((gaussians, replaced))
}

#[cfg(test)]
mod tests {
    use tcgs_core::sigmoid;

    use super::*;

    #[test]
    fn every_finite_color_has_a_finite_coefficient() {
        for color in [f32::MAX, 1.2e38, 0.0, -1.2e38, f32::MIN] {
            let sh0 = sh0_from_color(color);
            assert!(sh0.is_finite() && color_from_sh0(sh0).is_finite(), "{color}: {sh0}");
        }
    }

    #[test]
    fn opacities_come_back_within_half_a_step() {
        for byte in 0..=255 {
            let opacity = f64::from(sigmoid(logit_of_byte(byte)));
            assert!((opacity - f64::from(byte) / 255.0).abs() <= 0.5 / 255.0, "{byte}: {opacity}");
        }
        assert_eq!(logit(0.5, [0.1; 2]), 0.0);
        assert_eq!(logit(1.0, [0.1; 2]), -logit(0.0, [0.1; 2]));
    }
}
