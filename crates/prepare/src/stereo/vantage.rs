//! A view for stereo: single precision, grey, small.

use tcgs_core::{Pinhole, View};

/// A small image and its camera.
#[derive(Clone, Debug)]
pub(crate) struct Vantage {
    pub pinhole: Pinhole<f32>,
    /// Mean of the channels, `[H, W]`.
    pub gray: Vec<f32>,
    /// `[H, W]`
    pub colors: Vec<[f32; 3]>,
    /// Foreground, `[H, W]`.
    pub mask: Option<Vec<bool>>,
}

impl Vantage {
    /// - `factor`: pixels squared that become one
    pub fn new(view: &View, factor: usize) -> Self {
        let small;
        let image = if factor == 1 {
            &view.image
        } else {
            small = view.image.downscaled(factor);
            &small
        };
        let planes = [image.plane(0), image.plane(1), image.plane(2)];
        let colors: Vec<[f32; 3]> = (0..image.num_pixels()).map(|i| planes.map(|plane| plane[i])).collect();
        Self {
            pinhole: Pinhole::new(&view.camera.downscaled(factor)),
            gray: colors.iter().map(|c| c.iter().sum::<f32>() / 3.0).collect(),
            colors,
            mask: view.segmentation.as_ref().map(|mask| mask.downscaled(factor).foreground),
        }
    }

    /// Whether a pixel is known to be foreground.
    pub fn is_foreground(&self, pixel: usize) -> bool {
        self.mask.as_ref().is_some_and(|mask| mask[pixel])
    }
}
