//! What the losses of one iteration are: their values and their weights, whichever engine computes them.

use crate::config::WeightConfig;

/// Share of L1 in the image losses; the rest is SSIM's. Kerbl et al. 2023, Eq. 7.
pub(crate) const L1_SHARE: f32 = 0.8;

/// Channels of the images that the image losses are means over. The segmentation image's middle one is always zero, is
/// not rendered, and still counts.
pub(crate) const COUNTED_CHANNELS: f32 = 3.0;

/// Added under square roots of the losses on motion, so that they have a derivative at zero. Reference.
pub(crate) const ROOT_EPSILON: f64 = 1e-20;

/// Weights of the losses; 0 leaves one out (its value is then 0 too, `rigid`, `rot` and `iso` only together).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PriorWeights {
    /// See [`crate::WeightConfig`].
    pub rigid: f32,
    /// See [`crate::WeightConfig`].
    pub rot: f32,
    /// See [`crate::WeightConfig`].
    pub iso: f32,
    /// See [`crate::WeightConfig`].
    pub floor: f32,
    /// See [`crate::WeightConfig`].
    pub background: f32,
    /// See [`crate::WeightConfig`].
    pub soft_color: f32,
}

/// Values of the losses, before their weights.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PriorLosses {
    /// `mean sqrt(w ‖Rᵢᵀ(x_k − x_i) − previous offset‖²)`
    pub rigid: f64,
    /// `mean sqrt(w ‖relative rotation of k − of i‖²)`
    pub rot: f64,
    /// `mean sqrt(w (‖x_k − x_i‖ − first distance)²)`
    pub iso: f64,
    /// `mean max(y, 0)` of the foreground: y points down, the floor is `y = 0`
    pub floor: f64,
    /// `mean ‖x − first x‖₁ + mean ‖q − first q‖₁` of the background
    pub background: f64,
    /// `mean ‖colour − previous colour‖₁` of all
    pub soft_color: f64,
}

/// Values of every loss of one iteration, before their weights; 0 where a loss is off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LossTerms {
    /// Colour image.
    pub image: f64,
    /// Segmentation image.
    pub segmentation: f64,
    /// Motion.
    pub prior: PriorLosses,
    /// `L_mask`
    pub mask: f64,
    /// `L_mc`
    pub mask_consistency: f64,
}

impl LossTerms {
    /// Names, values and weights of all terms.
    pub fn terms(&self, w: &WeightConfig) -> [(&'static str, f64, f32); 10] {
        [
            ("image", self.image, w.image),
            ("segmentation", self.segmentation, w.segmentation),
            ("rigid", self.prior.rigid, w.rigid),
            ("rot", self.prior.rot, w.rot),
            ("iso", self.prior.iso, w.iso),
            ("floor", self.prior.floor, w.floor),
            ("background", self.prior.background, w.background),
            ("soft_color", self.prior.soft_color, w.soft_color),
            ("mask", self.mask, w.mask),
            ("mask_consistency", self.mask_consistency, w.mask_consistency),
        ]
    }

    /// Weighted sum.
    pub fn total(&self, weights: &WeightConfig) -> f64 {
        self.terms(weights).iter().map(|(_, value, weight)| value * f64::from(*weight)).sum()
    }
}
