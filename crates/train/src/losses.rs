//! The table of losses: the common source of settings, both engines and reports.
//!
//! A line of the table gives a loss its name, which is that of its weight in `config.toml`, and the weight of the
//! reference. The table generates [`WeightConfig`], [`LossTerms`], the weights in the shaders' uniform and the
//! positions of the values that a device reports. The engines compute the losses.

use serde::{Deserialize, Serialize};

/// Share of L1 in the image losses; the rest is SSIM's. Kerbl et al. 2023, Eq. 7.
pub(crate) const L1_SHARE: f32 = 0.8;

/// Channels of the images that the image losses are means over. The segmentation image's middle one is always zero, is
/// not rendered, and still counts.
pub(crate) const COUNTED_CHANNELS: f32 = 3.0;

/// Added under square roots of the losses on motion, so that they have a derivative at zero. Reference.
pub(crate) const ROOT_EPSILON: f64 = 1e-20;

/// Declares [`Loss`], [`WeightConfig`] and [`LossTerms`] from one list.
macro_rules! losses {
    ($($(#[doc = $about:literal])+ $variant:ident $name:ident = $weight:literal;)+) => {
        /// One loss.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Loss {
            $($(#[doc = $about])+ $variant,)+
        }

        impl Loss {
            /// All losses. Values and weights are reported in this order.
            pub const ALL: [Self; [$(Self::$variant),+].len()] = [$(Self::$variant),+];

            /// Name in `config.toml`, in metrics and in errors.
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => stringify!($name),)+ }
            }
        }

        /// Weights of the losses; 0 leaves a loss out, `rigid`, `rot` and `iso` only together.
        #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct WeightConfig {
            $($(#[doc = $about])+ pub $name: f32,)+
        }

        impl WeightConfig {
            /// The weights of the reference, and the paper's of masks.
            pub const REFERENCE: Self = Self { $($name: $weight,)+ };

            /// No loss at all.
            pub const NONE: Self = Self { $($name: 0.0,)+ };

            /// The weights in the order of [`Loss::ALL`].
            pub const fn values(&self) -> [f32; Loss::ALL.len()] {
                [$(self.$name),+]
            }

            /// From weights in the order of [`Loss::ALL`].
            pub const fn from_values(values: [f32; Loss::ALL.len()]) -> Self {
                Self { $($name: values[Loss::$variant as usize],)+ }
            }
        }

        /// Values of every loss of one iteration, before their weights; 0 where a loss is off.
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub struct LossTerms {
            $($(#[doc = $about])+ pub $name: f64,)+
        }

        impl LossTerms {
            /// The values in the order of [`Loss::ALL`].
            pub const fn values(&self) -> [f64; Loss::ALL.len()] {
                [$(self.$name),+]
            }

            /// From values in the order of [`Loss::ALL`].
            pub const fn from_values(values: [f64; Loss::ALL.len()]) -> Self {
                Self { $($name: values[Loss::$variant as usize],)+ }
            }
        }
    };
}

losses! {
    /// Colour image, `0.8 L1 + 0.2 (1 − SSIM)`. Weight 1 (reference).
    Image image = 1.0;
    /// Segmentation image, likewise. Weight 3 (reference); default 0.5, since more of it gathers Gaussians at outlines.
    Segmentation segmentation = 3.0;
    /// Local rigidity: `mean sqrt(w ‖Rᵢᵀ(x_k − x_i) − previous offset‖²)`. Weight 4 (reference); default 2.
    Rigid rigid = 4.0;
    /// Rotation similarity of neighbours: `mean sqrt(w ‖relative rotation of k − of i‖²)`. Weight 4 (reference);
    /// default 2.
    Rot rot = 4.0;
    /// Distances of neighbours: `mean sqrt(w (‖x_k − x_i‖ − first distance)²)`. Weight 2 (reference); default 1.
    Iso iso = 2.0;
    /// Foreground below the floor: `mean max(y, 0)`; y points down, floor at `y = 0`. Weight 2 (reference); default 1.
    Floor floor = 2.0;
    /// Background that moves: `mean ‖x − first x‖₁ + mean ‖q − first q‖₁`. Weight 20 (reference); default 10.
    Background background = 20.0;
    /// Motion of Gaussians that the images show to be still: `mean s (‖x − previous x‖₁ + ‖q − previous q‖₁)`. `s` is
    /// the share of a Gaussian's blending weight on unchanged content, known under a gate only. Weight 0 (neither
    /// reference nor paper has it); 0.5 for captures without masks.
    Stillness stillness = 0.0;
    /// Colours that change with time: `mean ‖colour − previous colour‖₁`. Weight 0.01 (reference, where a bug makes it
    /// inactive); default 0.005.
    SoftColor soft_color = 0.01;
    /// `L_mask`, a mean. Weight 0.01 (paper).
    Mask mask = 0.01;
    /// `L_mc`, a mean. Weight 0.01 (paper).
    MaskConsistency mask_consistency = 0.01;
}

impl LossTerms {
    /// Names, values and weights of all losses.
    ///
    /// ```
    /// use tcgs_train::{LossTerms, WeightConfig};
    /// let terms = LossTerms { iso: 0.5, ..LossTerms::default() };
    /// assert_eq!(terms.terms(&WeightConfig::REFERENCE)[4], ("iso", 0.5, 2.0));
    /// assert_eq!(terms.total(&WeightConfig::REFERENCE), 1.0);
    /// ```
    pub fn terms(&self, weights: &WeightConfig) -> [(&'static str, f64, f32); Loss::ALL.len()] {
        let (values, weights) = (self.values(), weights.values());
        std::array::from_fn(|i| (Loss::ALL[i].name(), values[i], weights[i]))
    }

    /// Weighted sum.
    pub fn total(&self, weights: &WeightConfig) -> f64 {
        self.terms(weights).iter().map(|(_, value, weight)| value * f64::from(*weight)).sum()
    }
}

impl std::ops::AddAssign for LossTerms {
    /// Adds losses that were computed apart.
    fn add_assign(&mut self, other: Self) {
        let (own, other) = (self.values(), other.values());
        *self = Self::from_values(std::array::from_fn(|i| own[i] + other[i]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_and_weights_have_one_order() {
        let terms = LossTerms::from_values(std::array::from_fn(|i| i as f64));
        assert_eq!((terms.image, terms.rigid, terms.mask_consistency), (0.0, 2.0, 10.0));
        for (i, (name, value, weight)) in terms.terms(&WeightConfig::REFERENCE).into_iter().enumerate() {
            assert_eq!((value, weight), (i as f64, WeightConfig::REFERENCE.values()[i]), "{name}");
            assert_eq!(Loss::ALL[i] as usize, i);
        }
        let mut twice = terms;
        twice += terms;
        assert_eq!(twice.soft_color, 16.0);
    }
}
