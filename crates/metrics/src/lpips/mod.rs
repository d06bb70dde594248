//! LPIPS: the perceptual distance of two images according to a trained network (Zhang et al. 2018), version 0.1.
//!
//! With `a` and `b` the features of the two images after a rectified layer `l`, of unit length over the channels at
//! every pixel, and `w_l` the learned weights of its channels:
//!
//! ```text
//! lpips = Σ_l mean over pixels of Σ_c w_lc (a_lc - b_lc)²
//! ```
//!
//! Compared are the five layers `relu1_2 relu2_2 relu3_3 relu4_3 relu5_3` of VGG-16 or the five rectified ones of
//! AlexNet. Pixels enter as `(x - shift) / scale` with shift (-0.030, -0.088, -0.188) and scale (0.458, 0.448, 0.450)
//! for `x` in `[-1, 1]`; programs that forget to stretch `[0, 1]` to that are common, hence [`InputRange`].
//!
//! What lives here: the networks, run forward. What does not: their numbers, which come from a file.

mod backbone;
#[cfg(feature = "lpips")]
mod gemm;
#[cfg(feature = "lpips")]
mod layers;
#[cfg(feature = "lpips")]
mod network;
#[cfg(feature = "lpips")]
mod weights;

use std::path::Path;

use tcgs_core::Image;

use crate::{MetricsError, assert_same_shape};

pub use self::backbone::Backbone;

/// A network's input for pixels in `[0, 1]`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum InputRange {
    /// `2 x - 1`, which the metric was trained for.
    Signed,
    /// `x` itself, as if it were in `[-1, 1]`: the input of `lpipsPyTorch`, and of every evaluation built on it. It has
    /// half the contrast around a brighter mean, so it is another metric.
    Unit,
}

/// The metric, with the weights of its two networks. It does not exist without feature `lpips`.
pub struct Lpips {
    #[cfg(feature = "lpips")]
    vgg: network::Network,
    #[cfg(feature = "lpips")]
    alex: network::Network,
    #[cfg(not(feature = "lpips"))]
    never: std::convert::Infallible,
}

impl Lpips {
    /// Reads the networks from the safetensors file that `scripts/fetch_lpips_weights.py` makes.
    ///
    /// # Errors
    /// If the file cannot be read, or does not hold the tensors of both networks in their shapes;
    /// [`MetricsError::NotBuilt`] without feature `lpips`.
    pub fn read(path: &Path) -> Result<Self, MetricsError> {
        #[cfg(feature = "lpips")]
        {
            let [vgg, alex] = weights::read(path)?;
            Ok(Self { vgg, alex })
        }
        #[cfg(not(feature = "lpips"))]
        Err(MetricsError::NotBuilt { path: path.into() })
    }

    /// The distance of two images: 0 for the same image, rarely above 1. The same bits for any number of threads.
    ///
    /// - `rendered`, `target`: `[3, H, W]`, values nominally in `[0, 1]`; not clamped
    /// - returns: `None` where an image is too small to leave features at every layer: VGG needs 16 pixels a side,
    ///   AlexNet 31
    ///
    /// # Panics
    /// If the images differ in shape or have not three channels.
    pub fn distance(&self, backbone: Backbone, range: InputRange, rendered: &Image, target: &Image) -> Option<f64> {
        assert_same_shape(rendered, target);
        assert_eq!(rendered.num_channels, 3, "channels of the images");
        #[cfg(feature = "lpips")]
        {
            let network = match backbone {
                Backbone::Vgg => &self.vgg,
                Backbone::Alex => &self.alex,
            };
            let [a, b] = [rendered, target].map(|image| normalized(image, range));
            backbone.sees(rendered.width, rendered.height).then(|| network.distance([&a, &b]))
        }
        #[cfg(not(feature = "lpips"))]
        {
            let _ = (backbone, range);
            match self.never {}
        }
    }
}

/// Mean of the values that the networks were trained on, by channel, for values in `[-1, 1]`.
#[cfg(feature = "lpips")]
const SHIFT: [f32; 3] = [-0.030, -0.088, -0.188];

/// Standard deviation of the same.
#[cfg(feature = "lpips")]
const SCALE: [f32; 3] = [0.458, 0.448, 0.450];

#[cfg(feature = "lpips")]
fn normalized(image: &Image, range: InputRange) -> Image {
    let mut image = image.clone();
    for channel in 0..3 {
        let (shift, inverse) = (SHIFT[channel], 1.0 / SCALE[channel]);
        for value in image.plane_mut(channel) {
            let x = match range {
                InputRange::Signed => 2.0 * *value - 1.0,
                InputRange::Unit => *value,
            };
            *value = (x - shift) * inverse;
        }
    }
    image
}
