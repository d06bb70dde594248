//! Bit allocation: the width of every Gaussian's codes, from the sensitivities of the images.
//!
//! [`assign_bits`] makes a [`BitMap`] before compression. [`Quantizer`](crate::Quantizer) defines the float that a code
//! of a width stands for.

use std::collections::BTreeMap;
use std::sync::Arc;

use tcgs_core::{Attribute, Column, Gaussians, Layout, Sensitivity};

use crate::error::CompressError;
use crate::quantize::MAX_BITS;

/// Bit width of the codes of every attribute of every Gaussian. All components of an attribute of a Gaussian share one
/// width.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BitMap {
    layout: Arc<Layout>,
    /// By [`Attribute::index`]: `[N]` widths in bits, 1 to 16.
    pub widths: Vec<Vec<u8>>,
}

impl Default for BitMap {
    /// No Gaussians, with the columns of [`Layout::base`].
    fn default() -> Self {
        Self::uniform(0, MAX_BITS, MAX_BITS)
    }
}

impl BitMap {
    /// A bit map with one width for positions and one for all other base attributes.
    ///
    /// - `position_bits`: width of means, 1 to 16
    /// - `bits`: width of quaternions, scales, opacities and colours, 1 to 16
    ///
    /// The widths are checked by [`compress`](crate::compress()).
    ///
    /// ```
    /// let map = tcgs_codec::BitMap::uniform(10, 16, 6);
    /// assert_eq!((map.num_gaussians(), map.mean_bits()), (10, 6.0));
    /// ```
    pub fn uniform(num_gaussians: usize, position_bits: u8, bits: u8) -> Self {
        Self::uniform_of(&Layout::base(), num_gaussians, position_bits, bits)
    }

    /// [`Self::uniform`] for the columns of `layout`. Columns that are not quantised in training
    /// ([`Column::quantized`]) get `position_bits`.
    pub fn uniform_of(layout: &Arc<Layout>, num_gaussians: usize, position_bits: u8, bits: u8) -> Self {
        let widths = |c: &Column| vec![if c.quantized { bits } else { position_bits }; num_gaussians];
        Self::new(Arc::clone(layout), layout.columns().iter().map(widths).collect())
    }

    /// A bit map of given widths.
    ///
    /// - `widths`: by [`Attribute::index`], `[N]` widths each, in bits, 1 to 16
    ///
    /// # Panics
    /// If `widths` and `layout` differ in the number of columns, or the columns of `widths` differ in length.
    pub fn new(layout: Arc<Layout>, widths: Vec<Vec<u8>>) -> Self {
        assert_eq!(widths.len(), layout.columns().len(), "columns of widths against {layout}");
        for (column, of_column) in layout.columns().iter().zip(&widths) {
            assert_eq!(of_column.len(), widths[0].len(), "widths of {} against those of means", column.name);
        }
        Self { layout, widths }
    }

    /// Layout of the scene that the widths belong to.
    pub fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    /// `N`, the number of Gaussians.
    pub fn num_gaussians(&self) -> usize {
        self.widths[0].len()
    }

    /// The widths of the Gaussians at `indices`, in the order of `indices`.
    ///
    /// # Panics
    /// If an index is not below [`Self::num_gaussians`].
    pub fn select(&self, indices: &[usize]) -> Self {
        let select = |widths: &Vec<u8>| indices.iter().map(|&i| widths[i]).collect();
        Self { layout: Arc::clone(&self.layout), widths: self.widths.iter().map(select).collect() }
    }

    /// By [`Attribute::index`]: the number of Gaussians of each width in use.
    pub fn histogram(&self) -> Vec<BTreeMap<u8, usize>> {
        let count = |widths: &Vec<u8>| {
            let mut counts = BTreeMap::new();
            for &width in widths {
                *counts.entry(width).or_insert(0) += 1;
            }
            counts
        };
        self.widths.iter().map(count).collect()
    }

    /// Mean width of a scalar over all columns that are quantised in training (all base attributes but means), in bits;
    /// 0 for a map without Gaussians.
    pub fn mean_bits(&self) -> f64 {
        let (mut bits, mut scalars) = (0, 0);
        for attribute in mixed(&self.layout) {
            let widths = &self.widths[attribute.index()];
            bits += attribute.components() * widths.iter().map(|&w| usize::from(w)).sum::<usize>();
            scalars += attribute.components() * widths.len();
        }
        if scalars == 0 { 0.0 } else { bits as f64 / scalars as f64 }
    }
}

/// Rule by which [`assign_bits`] derives widths from sensitivities.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BitMapping {
    /// Reverse water-filling: the width rises by one where the effect of an error on the images doubles; see
    /// [`assign_bits`].
    Log,
    /// The paper's rule (4.1.2): the width is linear in the min-max normalised sensitivity.
    Linear,
}

/// Settings of [`assign_bits`].
#[derive(Clone, Debug, PartialEq)]
pub struct BitSettings {
    /// Smallest width, in bits, 1 to 16: the paper's `b_min`. Default 4 (paper).
    pub min_bits: u8,
    /// Largest width, in bits, `min_bits` to 16: the paper's `b_max`. Default 8 (paper).
    pub max_bits: u8,
    /// Target mean width of [`BitMapping::Log`] in every attribute but positions, in bits; unused by
    /// [`BitMapping::Linear`]. Default 5, about the mean width that the paper's rule gives with its range of 4 to 8.
    pub mean_bits: f32,
    /// Width of each coordinate of a mean, in bits, 1 to 16. Default 16 (paper).
    pub position_bits: u8,
    /// Rule from sensitivities to widths. Default [`BitMapping::Log`].
    pub mapping: BitMapping,
}

/// Bits beyond the mean of a Gaussian that no training image shows. Other cameras may see it. A quantizer of few bits
/// cuts off rare large scales, and a wall of large Gaussians then has holes.
const UNSEEN_BITS: f64 = 1.0;

impl Default for BitSettings {
    fn default() -> Self {
        Self { min_bits: 4, max_bits: 8, mean_bits: 5.0, position_bits: 16, mapping: BitMapping::Log }
    }
}

/// The columns whose widths differ between Gaussians.
fn mixed(layout: &Layout) -> impl Iterator<Item = Attribute> {
    layout.columns().iter().filter(|column| column.quantized).map(|column| column.attribute)
}

/// Width of every attribute of every Gaussian, from the sensitivity of the images to the attribute.
///
/// - `sensitivity`: `S(θ) >= 0` of the Gaussians of `stored`, in their order (paper 4.1.2)
/// - `stored`: the values in stored form; [`BitMapping::Log`] uses their spread
/// - returns: one width for each Gaussian and attribute; means always get [`BitSettings::position_bits`]
///
/// [`BitMapping::Linear`] is the paper's rule: `S` is min-max normalised over all parameters, and the width is
/// `round(min_bits + S (max_bits - min_bits))`, where `S` is the largest sensitivity among the components of the
/// attribute. `S` is heavy-tailed, so nearly all attributes get `min_bits`.
///
/// [`BitMapping::Log`] minimises `Σ S² step²` within each attribute: the expected squared change of the images when
/// each parameter errs by its step independently. At equal width the step is proportional to the spread (standard
/// deviation over Gaussians) of the component, `step = spread 2^-b`. All components `k` of an attribute share one
/// width. At the minimum for a given total of bits, `Σ_k (S_k spread_k)² 4^-b` is the same for all Gaussians (reverse
/// water-filling). So `b = log2 w + c` with `w² = Σ_k (S_k spread_k)²`. For each attribute bisection finds the constant
/// `c` whose mean width is nearest to `mean_bits`. A Gaussian without any sensitivity gets one bit more than
/// `mean_bits`, since training keeps it for other cameras. Attributes are not weighed against each other: `S` sums
/// signed changes of pixels, so the effect of an attribute that moves edges (rotations, scales) cancels in part, and
/// the effect of an attribute that brightens (colours, opacities) does not.
///
/// ```
/// use tcgs_codec::{BitSettings, assign_bits};
/// use tcgs_core::{Gaussians, Sensitivity};
/// let (mut stored, mut sensitivity) = (Gaussians::zeros(2), Sensitivity::zeros(2));
/// stored.logit_opacities_mut().copy_from_slice(&[-1.0, 1.0]);
/// sensitivity.logit_opacities_mut().copy_from_slice(&[0.1, 0.8]);
/// let map = assign_bits(&sensitivity, &stored, &BitSettings::default())?;
/// assert!(map.widths[3][1] > map.widths[3][0]);
/// # Ok::<(), tcgs_codec::CompressError>(())
/// ```
///
/// # Errors
/// - [`CompressError::Value`] if a setting is out of range
/// - [`CompressError::Count`] if `sensitivity` and `stored` differ in columns or in the number of Gaussians
/// - [`CompressError::Gaussian`] if a sensitivity is negative or not finite, or a stored value is not finite
pub fn assign_bits(
    sensitivity: &Sensitivity,
    stored: &Gaussians,
    settings: &BitSettings,
) -> Result<BitMap, CompressError> {
    let n = stored.num_gaussians();
    let BitSettings { min_bits, max_bits, position_bits, mean_bits, .. } = *settings;
    let invalid = |what, found, expected| Err(CompressError::Value { what, found, expected });
    if !(1..=MAX_BITS).contains(&min_bits) {
        return invalid("min_bits", min_bits.into(), "1 to 16");
    }
    if !(min_bits..=MAX_BITS).contains(&max_bits) {
        return invalid("max_bits", max_bits.into(), "min_bits to 16");
    }
    if !(1..=MAX_BITS).contains(&position_bits) {
        return invalid("position_bits", position_bits.into(), "1 to 16");
    }
    if !mean_bits.is_finite() {
        return invalid("mean_bits", mean_bits.into(), "a finite number");
    }
    let layout = stored.layout();
    if sensitivity.layout() != layout {
        let (found, expected) = (sensitivity.layout().columns().len(), layout.columns().len());
        return Err(CompressError::Count { what: "columns of sensitivities".into(), found, expected });
    }
    for column in layout.columns() {
        let (attribute, name, components) = (column.attribute, &column.name, column.components());
        let (s, v) = (sensitivity.values(attribute), stored.values(attribute));
        if s.len() != v.len() {
            let what = format!("sensitivities of {name}");
            return Err(CompressError::Count { what, found: s.len(), expected: v.len() });
        }
        let illegal = |i: usize, what: String, found: f32, expected| {
            let (gaussian, found) = (i / components, found.into());
            Err(CompressError::Gaussian { what, gaussian, timestep: None, found, expected })
        };
        if let Some(i) = s.iter().position(|s| !(s.is_finite() && *s >= 0.0)) {
            return illegal(i, format!("sensitivity of {name}"), s[i], "a finite number, 0 or more");
        }
        if let Some(i) = v.iter().position(|x| !x.is_finite()) {
            return illegal(i, name.clone(), v[i], "a finite number");
        }
    }
    let mut map = BitMap::uniform_of(layout, n, position_bits, min_bits);
    if min_bits < max_bits {
        match settings.mapping {
            BitMapping::Linear => assign_linear(sensitivity, settings, &mut map),
            BitMapping::Log => assign_log(sensitivity, stored, settings, &mut map),
        }
    }
    Ok(map)
}

fn assign_linear(sensitivity: &Sensitivity, settings: &BitSettings, map: &mut BitMap) {
    let all = || mixed(sensitivity.layout()).flat_map(|a| sensitivity.values(a).iter().copied());
    let (lowest, highest) = all().fold((f32::INFINITY, 0.0_f32), |(low, high), s| (low.min(s), high.max(s)));
    let (min_bits, range) = (f32::from(settings.min_bits), f32::from(settings.max_bits - settings.min_bits));
    for attribute in mixed(sensitivity.layout()) {
        let channels = sensitivity.values(attribute).chunks_exact(attribute.components());
        for (width, s) in map.widths[attribute.index()].iter_mut().zip(channels) {
            let largest = s.iter().fold(0.0_f32, |a, &b| a.max(b));
            let normalized = if highest > lowest { (largest - lowest) / (highest - lowest) } else { 0.0 };
            *width = (min_bits + normalized * range).round() as u8;
        }
    }
}

fn assign_log(sensitivity: &Sensitivity, stored: &Gaussians, settings: &BitSettings, map: &mut BitMap) {
    // `[attribute][N]` of log2 w; none if no image shows the Gaussian.
    let of_column = |column: &Column| -> Vec<Option<f64>> {
        if !column.quantized {
            return Vec::new();
        }
        let (attribute, components) = (column.attribute, column.components());
        let spreads: Vec<f64> = (0..components).map(|c| spread(stored.values(attribute), components, c)).collect();
        let weight = |s: &[f32]| {
            let sum: f64 = s.iter().zip(&spreads).map(|(&s, spread)| (f64::from(s) * spread).powi(2)).sum();
            s.iter().any(|&s| s > 0.0).then(|| 0.5 * sum.log2())
        };
        sensitivity.values(attribute).chunks_exact(components).map(weight).collect()
    };
    let unseen = f64::from(settings.mean_bits) + UNSEEN_BITS;
    let log_weights: Vec<Vec<Option<f64>>> = stored.layout().columns().iter().map(of_column).collect();
    let width = |log_weight: Option<f64>, c: f64| -> u8 {
        let bits = log_weight.map_or(unseen, |log_weight| log_weight + c);
        bits.round().clamp(f64::from(settings.min_bits), f64::from(settings.max_bits)) as u8
    };
    let target = f64::from(settings.mean_bits);
    for attribute in mixed(stored.layout()) {
        let weights = &log_weights[attribute.index()];
        let mean_bits = |c: f64| -> f64 {
            weights.iter().map(|&w| usize::from(width(w, c))).sum::<usize>() as f64 / weights.len().max(1) as f64
        };
        // Wide enough for any products of two `f32`. The mean rises with c.
        let (mut low, mut high) = (-400.0, 400.0);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if mean_bits(middle) < target {
                low = middle;
            } else {
                high = middle;
            }
        }
        let c = if target - mean_bits(low) < mean_bits(high) - target { low } else { high };
        for (bits, &log_weight) in map.widths[attribute.index()].iter_mut().zip(weights) {
            *bits = width(log_weight, c);
        }
    }
}

/// Standard deviation of one channel over Gaussians.
fn spread(values: &[f32], components: usize, channel: usize) -> f64 {
    let of_channel = || values.iter().skip(channel).step_by(components).map(|&x| f64::from(x));
    let count = (values.len() / components).max(1) as f64;
    let mean = of_channel().sum::<f64>() / count;
    (of_channel().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `n` Gaussians whose sensitivities span several orders of magnitude, and values of different spread.
    fn example(n: usize) -> (Sensitivity, Gaussians) {
        let (mut sensitivity, mut stored) = (Sensitivity::zeros(n), Gaussians::zeros(n));
        for attribute in Attribute::BASE {
            let scale = 10.0_f32.powi(attribute.index() as i32 - 2);
            for (i, s) in sensitivity.values_mut(attribute).iter_mut().enumerate() {
                *s = 10.0_f32.powf((i * 7919 % 1000) as f32 / 200.0 - 4.0);
            }
            for (i, v) in stored.values_mut(attribute).iter_mut().enumerate() {
                *v = scale * ((i * 104_729 % 1000) as f32 / 1000.0);
            }
        }
        (sensitivity, stored)
    }

    #[test]
    fn log_mapping_reaches_its_mean() {
        let (sensitivity, stored) = example(500);
        for mean_bits in [4.5, 5.5, 7.0] {
            let map = assign_bits(&sensitivity, &stored, &BitSettings { mean_bits, ..Default::default() }).unwrap();
            assert!((map.mean_bits() - f64::from(mean_bits)).abs() < 0.01, "{} for {mean_bits}", map.mean_bits());
            assert!(map.widths[0].iter().all(|&w| w == 16));
            assert!(map.widths[1..].iter().flatten().all(|w| (4..=8).contains(w)));
        }
    }

    #[test]
    fn log_mapping_beats_uniform_and_random_widths_at_the_same_bits() {
        let (sensitivity, stored) = example(500);
        let cost = |map: &BitMap, a: Attribute| -> f64 {
            let c = a.components();
            let spreads: Vec<f64> = (0..c).map(|k| spread(stored.values(a), c, k)).collect();
            let terms = sensitivity.values(a).iter().enumerate().map(|(i, &s)| {
                let step = spreads[i % c] * 2.0_f64.powi(-i32::from(map.widths[a.index()][i / c]));
                (f64::from(s) * step).powi(2)
            });
            terms.sum()
        };
        let log = assign_bits(&sensitivity, &stored, &BitSettings { mean_bits: 6.0, ..Default::default() }).unwrap();
        let uniform = BitMap::uniform(500, 16, 6);
        // The same widths, assigned to other Gaussians.
        let mut shifted = log.clone();
        shifted.widths.iter_mut().for_each(|w| w.rotate_left(123));
        for a in mixed(&Layout::base()) {
            assert!(cost(&log, a) < 0.5 * cost(&uniform, a), "{a:?}");
            assert!(cost(&log, a) < 0.5 * cost(&shifted, a), "{a:?}");
        }
    }

    #[test]
    fn every_attribute_gets_several_widths() {
        let (sensitivity, stored) = example(500);
        let map = assign_bits(&sensitivity, &stored, &BitSettings::default()).unwrap();
        for a in mixed(&Layout::base()) {
            let common = map.histogram()[a.index()].values().filter(|&&count| count >= 25).count();
            assert!(common >= 3, "{a:?}: {:?}", map.histogram()[a.index()]);
        }
    }

    #[test]
    fn bits_rise_with_sensitivity() {
        let (sensitivity, stored) = example(300);
        for mapping in [BitMapping::Log, BitMapping::Linear] {
            let map = assign_bits(&sensitivity, &stored, &BitSettings { mapping, ..Default::default() }).unwrap();
            let index = Attribute::LogitOpacity.index();
            let mut pairs: Vec<(f32, u8)> =
                sensitivity.logit_opacities().iter().copied().zip(map.widths[index].iter().copied()).collect();
            pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
            assert!(pairs.is_sorted_by_key(|p| p.1) && pairs[0].1 < pairs[pairs.len() - 1].1, "{mapping:?}");
        }
    }

    #[test]
    fn linear_mapping_is_the_papers() {
        let (mut sensitivity, stored) = (Sensitivity::zeros(3), Gaussians::zeros(3));
        sensitivity.means_mut()[0] = [100.0; 3]; // positions are excluded
        sensitivity.colors_mut()[0] = [0.0, 8.0, 1.0];
        sensitivity.colors_mut()[1] = [0.0, 3.0, 1.0];
        let map =
            assign_bits(&sensitivity, &stored, &BitSettings { mapping: BitMapping::Linear, ..Default::default() })
                .unwrap();
        assert_eq!(map.widths[Attribute::Color.index()], [8, 6, 4]); // 4 + round(4 * 3/8 = 1.5) = 6
        assert_eq!(map.widths[Attribute::Quat.index()], [4, 4, 4]);
        assert_eq!(map.histogram()[Attribute::Color.index()], BTreeMap::from([(4, 1), (6, 1), (8, 1)]));
        assert_eq!(map.select(&[1, 0]).widths[Attribute::Color.index()], [6, 8]);
    }

    #[test]
    fn what_no_image_shows_is_not_the_coarsest() {
        let (mut sensitivity, stored) = example(500);
        for attribute in Attribute::BASE {
            sensitivity.values_mut(attribute)[..100 * attribute.components()].fill(0.0);
        }
        let map = assign_bits(&sensitivity, &stored, &BitSettings::default()).unwrap();
        for attribute in Attribute::BASE.into_iter().filter(|&attribute| attribute != Attribute::Mean) {
            let widths = &map.widths[attribute.index()];
            assert!(widths[..100].iter().all(|&width| width == 6) && widths[100..].contains(&4), "{attribute:?}");
        }
        assert!((map.mean_bits() - 5.0).abs() < 0.05, "{}", map.mean_bits());
    }

    #[test]
    fn equal_bounds_and_no_sensitivity_are_uniform() {
        let (sensitivity, stored) = example(20);
        let settings = BitSettings { min_bits: 6, max_bits: 6, ..Default::default() };
        assert_eq!(assign_bits(&sensitivity, &stored, &settings).unwrap(), BitMap::uniform(20, 16, 6));
        let nothing = assign_bits(&Sensitivity::zeros(20), &stored, &BitSettings::default()).unwrap();
        assert_eq!(nothing, BitMap::uniform(20, 16, 6), "one bit more than the mean");
        assert_eq!(assign_bits(&Sensitivity::zeros(0), &Gaussians::zeros(0), &settings).unwrap().mean_bits(), 0.0);
    }

    #[test]
    fn what_is_out_of_range_is_refused() {
        let (sensitivity, stored) = example(20);
        let says = |sensitivity: &Sensitivity, settings: BitSettings, message: &str| {
            assert_eq!(assign_bits(sensitivity, &stored, &settings).unwrap_err().to_string(), message);
        };
        let default = BitSettings::default;
        says(&Sensitivity::zeros(19), default(), "invalid number of sensitivities of means: found 57, expected 60");
        let mut negative = sensitivity.clone();
        negative.values_mut(Attribute::Color)[7] = -1.0;
        let message = "invalid sensitivity of colors of Gaussian 2: found -1, expected a finite number, 0 or more";
        says(&negative, default(), message);
        let settings = BitSettings { min_bits: 9, ..default() };
        says(&sensitivity, settings, "invalid max_bits: found 8, expected min_bits to 16");
        let settings = BitSettings { min_bits: 0, ..default() };
        says(&sensitivity, settings, "invalid min_bits: found 0, expected 1 to 16");
        let settings = BitSettings { position_bits: 17, ..default() };
        says(&sensitivity, settings, "invalid position_bits: found 17, expected 1 to 16");
        let settings = BitSettings { mean_bits: f32::NAN, ..default() };
        says(&sensitivity, settings, "invalid mean_bits: found NaN, expected a finite number");
    }
}
