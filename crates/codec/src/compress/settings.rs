//! [`CompressSettings`], and the bit map and step of positions that follow from the settings.

use tcgs_core::{Attribute, Column, Gaussians, RateGroup, upper_median};

use super::order::ranks;
use crate::bits::BitMap;
use crate::compact::MAX_TIMESTEPS;
use crate::error::CompressError;
use crate::quantize::MAX_BITS;

/// Settings of [`compress`](super::compress()).
///
/// In `max_mse` and `coarser`, a column beyond [`Attribute::BASE`] uses the entry of the base attribute with the same
/// learning rate.
///
/// ```
/// use tcgs_codec::CompressSettings;
/// let settings = CompressSettings { segment_length: Some(30), ..CompressSettings::default().with_quality(-1.0) };
/// assert!(settings.max_mse[0] > CompressSettings::default().max_mse[0]);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct CompressSettings {
    /// Whether tracks are reduced to keypoints. If not, every timestep is stored, and `max_keypoints`, `max_mse`,
    /// `constant_tracks`, `noise_floor`, `joint` and `importance` have no effect. Default true.
    pub keypoints: bool,
    /// Most keypoints of a track, or where `joint` of a track in each segment; a number below 2 counts as 2. Default
    /// 60: the tolerance should decide, and the colours that change most in a long scene need more than the paper's 30.
    pub max_keypoints: usize,
    /// By [`Attribute::index`]: tolerance, the mean squared error of a track at which the selection of keypoints stops,
    /// in the squared unit of the stored attribute, 0 or more. Unused for attributes that do not vary. Default 2.5e-6
    /// for positions (1.6 mm in scenes in metres), 4e-5 for rotations (0.7 degrees), 1e-4 for scales (1 percent), 1e-3
    /// for opacities (at most 0.008 of 1) and 2e-4 for colours (3.6 of 255): in measurements on basketball, smaller
    /// tolerances cost bytes without a visible gain. 1e-5 for all attributes in the paper.
    pub max_mse: [f32; 5],
    /// Whether a track whose mean squared distance to its mean is within the tolerance is stored as the mean, with one
    /// keypoint. Default true, since most of a scene is static. The paper keeps two keypoints.
    pub constant_tracks: bool,
    /// Whether the tolerance is at least `(step/4)²` for the step of the track's quantizer: a keypoint that removes an
    /// error below the quantisation error `step²/12` is a waste. Default true; not in the paper.
    pub noise_floor: bool,
    /// Number of timesteps of a segment, 1 to 65536. Default none, which chooses 50 for a scene of up to 60,000
    /// Gaussians, and fewer (at least 8) for a larger scene, so that a segment decodes in about 50 ms on one core.
    pub segment_length: Option<u32>,
    /// Whether the components of an attribute of a Gaussian share their keypoint times. Keypoints are then selected
    /// segment by segment, with keypoints at both ends of each segment, and their values are the least-squares fit
    /// rather than samples of the track. Default true; not in the paper.
    pub joint: bool,
    /// Exponent `p` by which the tolerance depends on the Gaussian: the tolerance is divided by `w^p`, at most by 16
    /// and at least by 1/16. The weight `w`, relative to the median over Gaussians, estimates from opacity and scales
    /// how much an error changes images. Default 0.5; 0 (the same tolerance for all Gaussians) in the paper.
    pub importance: f32,
    /// Number of Gaussians of each layer but the last as a share of `N`, 0 to 1; the last layer has the rest. Default
    /// `[0.1, 0.3]`: three layers. Empty: one layer, as in the paper.
    pub layers: Vec<f32>,
    /// By [`Attribute::index`]: bits by which the widths of the bit map are lowered, to 2 at least; a negative number
    /// raises widths, to 16 at most. A fraction applies to a share of the Gaussians: 0.25 lowers the width by one bit
    /// for the quarter of the Gaussians that covers least of an image. Default 2 for rotations and 1 for opacities,
    /// whose widths in training equal those of colours: on basketball that saves 6 percent of the file for 0.01 dB.
    pub coarser: [f32; 5],
    /// If positive, the error of colours, a root mean square over all directions of view, below which a Gaussian does
    /// without a band of spherical harmonics, and which rounding the coefficients may make; colours are from 0 to 1.
    /// For each Gaussian it is divided by the power `p/2` of the sensitivity of the images to its band, relative to
    /// that of the others, for the `p` of `importance`. If 0, all Gaussians keep all bands with the widths of the bit
    /// map. Default 0.014, the root of the tolerance of colours.
    pub harmonic_error: f32,
    /// If positive, the number of steps of positions to a length typical of the scene's Gaussians: the step along all
    /// axes is the median over Gaussians of the second largest scale (one standard deviation, in scene units) divided
    /// by this number, and the width of positions follows from the step and the extent of the scene. If 0 or negative,
    /// the width of positions is that of the bit map, and the codes cover the range along each axis. Default 11; 0 in
    /// the paper.
    pub position_fineness: f32,
    /// By [`Attribute::index`]: whether quantizers cover all values, and are fitted again. Where not, learned ones
    /// stay, and outliers may be cut off for a smaller mean error, so that the largest error has no bound. Quantizers
    /// of positions cover all in any case. Default false.
    pub covers_outliers: [bool; 5],
}

impl Default for CompressSettings {
    fn default() -> Self {
        Self {
            keypoints: true,
            max_keypoints: 60,
            max_mse: [2.5e-6, 4e-5, 1e-4, 1e-3, 2e-4],
            constant_tracks: true,
            noise_floor: true,
            segment_length: None,
            joint: true,
            importance: 0.5,
            layers: vec![0.1, 0.3],
            coarser: [0.0, 2.0, 0.0, 1.0, 0.0],
            harmonic_error: 0.014,
            position_fineness: 11.0,
            covers_outliers: [false; 5],
        }
    }
}

impl CompressSettings {
    /// The paper's settings for Panoptic Sports: at most 30 keypoints, tolerance 1e-5 for all attributes, none of this
    /// crate's additions.
    pub fn paper() -> Self {
        Self {
            keypoints: true,
            max_keypoints: 30,
            max_mse: [1e-5; 5],
            constant_tracks: false,
            noise_floor: false,
            segment_length: None,
            joint: false,
            importance: 0.0,
            layers: Vec::new(),
            coarser: [0.0; 5],
            harmonic_error: 0.0,
            position_fineness: 0.0,
            covers_outliers: [false; 5],
        }
    }

    /// Refuses settings that are out of range.
    pub(super) fn check(&self) -> Result<(), CompressError> {
        let invalid = |what, found: f32, expected| Err(CompressError::Value { what, found: found.into(), expected });
        if let Some(&found) = self.max_mse.iter().find(|x| x.is_nan() || **x < 0.0) {
            return invalid("max_mse", found, "0 or more");
        }
        if let Some(found) = self.segment_length.filter(|length| !(1..=MAX_TIMESTEPS).contains(length)) {
            return invalid("segment_length", found as f32, "1 to 65536");
        }
        if !self.importance.is_finite() {
            return invalid("importance", self.importance, "a finite number");
        }
        if let Some(&found) = self.layers.iter().find(|x| !(0.0..=1.0).contains(*x)) {
            return invalid("share of a layer", found, "0 to 1");
        }
        if let Some(&found) = self.coarser.iter().find(|x| !x.is_finite()) {
            return invalid("coarser", found, "a finite number");
        }
        if !(self.harmonic_error.is_finite() && self.harmonic_error >= 0.0) {
            return invalid("harmonic_error", self.harmonic_error, "0 or more");
        }
        if !self.position_fineness.is_finite() {
            return invalid("position_fineness", self.position_fineness, "a finite number");
        }
        Ok(())
    }

    /// Timesteps of a segment of a scene of so many Gaussians and timesteps, all but the last of equal length.
    pub fn segment_length_of(&self, num_gaussians: usize, num_timesteps: usize) -> u32 {
        let fitting = (SEGMENT_WORK / num_gaussians.max(1)).max(MIN_SEGMENT_LENGTH);
        self.segment_length.unwrap_or_else(|| match fitting {
            SEGMENT_LENGTH.. => SEGMENT_LENGTH as u32,
            _ => num_timesteps.div_ceil(num_timesteps.div_ceil(fitting)) as u32,
        })
    }

    /// These settings moved along one rate-distortion curve.
    ///
    /// - `quality`: 0 changes nothing; each step of 1 up about halves the errors, each step of 1 down about doubles
    ///   them; any finite number. The file grows by a fourth to a third for each step up
    ///
    /// ```
    /// let finer = tcgs_codec::CompressSettings::default().with_quality(1.0);
    /// assert!(finer.max_mse[0] < tcgs_codec::CompressSettings::default().max_mse[0]);
    /// ```
    pub fn with_quality(mut self, quality: f32) -> Self {
        let pace = if quality < 0.0 { &COARSER } else { &FINER };
        for (a, pace) in pace.iter().enumerate() {
            self.max_mse[a] *= 4.0_f32.powf(-quality * pace.tolerance);
            self.coarser[a] -= quality * pace.bits;
        }
        self.harmonic_error *= 2.0_f32.powf(-quality * pace[Attribute::Color.index()].bits);
        self.position_fineness *= 2.0_f32.powf(quality * pace[Attribute::Mean.index()].bits);
        self.coarser[Attribute::Mean.index()] = 0.0;
        self
    }

    /// These settings with smaller largest errors of some attributes ([`attribute_error`](crate::attribute_error)), and
    /// of all that share their entries; where several do, the largest factor counts. How much smaller depends on the
    /// scene; many times over the errors become as small as 16 bits make them.
    ///
    /// - `factors`: by which the errors should fall, at least 1. With 1 quantizers cover all values, so that errors
    ///   have a bound, and every Gaussian keeps its harmonics if one of these is among the attributes
    ///
    /// ```
    /// use tcgs_codec::CompressSettings;
    /// use tcgs_core::{Attribute, Column};
    /// let settings = CompressSettings::default();
    /// let finer = settings.clone().with_smaller_errors(&[(&Column::like(Attribute::Color), 4.0)]);
    /// assert_eq!(finer.coarser[4], settings.coarser[4] - 2.0);
    /// ```
    pub fn with_smaller_errors(mut self, factors: &[(&Column, f32)]) -> Self {
        let mut of_places = [1.0_f32; 5];
        for (column, factor) in factors {
            let place = Self::place_of(column);
            of_places[place] = of_places[place].max(*factor);
            self.covers_outliers[place] = true;
            if matches!(column.attribute, Attribute::Extra { .. }) {
                // What does not show is an error nevertheless.
                self.harmonic_error = 0.0;
            }
        }
        self.max_keypoints = usize::MAX;
        for (place, factor) in of_places.into_iter().enumerate() {
            self.max_mse[place] /= factor * factor;
            if place == Attribute::Mean.index() && self.position_fineness > 0.0 {
                self.position_fineness *= factor;
            } else {
                // A part of a bit would go to a part of the Gaussians.
                self.coarser[place] -= factor.log2().ceil();
            }
        }
        self
    }
}

/// Timesteps of a segment, where they are few enough to decode.
const SEGMENT_LENGTH: usize = 50;
/// Gaussians times timesteps that decode in a twentieth of a second on one core, 16 ns each.
const SEGMENT_WORK: usize = 3_000_000;
/// A segment costs keypoints at its ends: of 30 timesteps of basketball 15 a segment take 3 percent more than all
/// together, 10 take 6, 5 take 16.
const MIN_SEGMENT_LENGTH: usize = 8;

/// How fast an attribute moves along [`CompressSettings::with_quality`]: halvings of its tolerance, as a length, and
/// bits.
struct Pace {
    tolerance: f32,
    bits: f32,
}

const fn pace(tolerance: f32, bits: f32) -> Pace {
    Pace { tolerance, bits }
}

/// Below quality 0, by [`Attribute::index`]. Set so that a byte buys about as many decibels wherever it is spent, on
/// basketball and on a ray-traced room: at half the bytes 0.5 dB more than at one pace for all, since colours are what
/// one sees.
const COARSER: [Pace; 5] = [pace(0.75, 1.0), pace(1.0, 1.4), pace(1.0, 1.4), pace(1.0, 1.2), pace(0.25, 0.4)];
/// Above it: scales and opacities are soon exact enough, rotations later.
const FINER: [Pace; 5] = [pace(1.2, 0.75), pace(1.0, 1.0), pace(1.0, 0.4), pace(1.0, 0.5), pace(1.0, 1.05)];

impl CompressSettings {
    /// The bit map with what the settings change in it.
    ///
    /// - `first`: the first timestep
    /// - `bounds`: smallest and largest coordinates of all means at all timesteps
    pub(super) fn adjusted(&self, bit_map: &BitMap, first: &Gaussians, bounds: [[f32; 3]; 2]) -> BitMap {
        let mut bit_map = bit_map.clone();
        let ranks = ranks(first);
        for (widths, column) in bit_map.widths.iter_mut().zip(first.layout().columns()) {
            let coarser = self.coarser[Self::place_of(column)];
            for (width, &rank) in widths.iter_mut().zip(&ranks) {
                let one_more = rank < -coarser - (-coarser).floor();
                let shifted = f32::from(*width) + (-coarser).floor() + f32::from(u8::from(one_more));
                *width = shifted.clamp(f32::from(2.min(*width)), f32::from(MAX_BITS)) as u8;
            }
        }
        if let Some(step) = self.position_step(first) {
            bit_map.widths[Attribute::Mean.index()].fill(position_bits(bounds, step));
        }
        bit_map
    }

    /// Where `max_mse` and `coarser` have the value of a column: a further one is treated as the column of
    /// [`Attribute::BASE`] with the same rate of learning.
    pub(super) fn place_of(column: &Column) -> usize {
        match column.attribute {
            Attribute::Extra { .. } => match column.rate {
                RateGroup::Mean => Attribute::Mean,
                RateGroup::Quat => Attribute::Quat,
                RateGroup::LogScale => Attribute::LogScale,
                RateGroup::LogitOpacity => Attribute::LogitOpacity,
                RateGroup::Color => Attribute::Color,
            },
            base => base,
        }
        .index()
    }

    /// Step of positions along all axes, if the settings choose it.
    pub(super) fn position_step(&self, first: &Gaussians) -> Option<f64> {
        if self.position_fineness <= 0.0 {
            return None;
        }
        let axis = f64::from(upper_median(first.log_scales().iter().map(middle))?).exp();
        Some(axis / f64::from(self.position_fineness))
    }
}

/// The fewest bits of positions in steps of `step`.
fn position_bits([min, max]: [[f32; 3]; 2], step: f64) -> u8 {
    let extent = (0..3).map(|i| f64::from(max[i]) - f64::from(min[i])).fold(0.0, f64::max);
    let levels = extent / step + 1.0;
    (levels.log2().ceil() as u8).clamp(1, MAX_BITS)
}

/// The middle one of three.
pub(super) fn middle(values: &[f32; 3]) -> f32 {
    let mut values = *values;
    values.sort_unstable_by(f32::total_cmp);
    values[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_are_short_where_gaussians_are_many() {
        let automatic = CompressSettings::default();
        assert_eq!(automatic.segment_length_of(60_000, 150), 50);
        assert_eq!(automatic.segment_length_of(200_000, 150), 15);
        assert_eq!(automatic.segment_length_of(250_000, 150), 12);
        assert_eq!(automatic.segment_length_of(10_000_000, 150), 8);
        assert_eq!(automatic.segment_length_of(200_000, 4), 4);
        let told = CompressSettings { segment_length: Some(7), ..CompressSettings::default() };
        assert_eq!(told.segment_length_of(200_000, 150), 7);
    }
}
