//! A network of LPIPS, run forward.

use tcgs_core::Image;

use super::backbone::{Backbone, Step};
use super::layers::{Convolution, Features, max_pool};

/// A network with its weights.
pub(super) struct Network {
    pub backbone: Backbone,
    /// The convolutions of the steps, in order.
    pub convolutions: Vec<Convolution>,
    /// For every compared layer, the weight of each channel.
    pub heads: Vec<Vec<f32>>,
}

impl Network {
    /// Sum over the compared layers of the mean distance of their features.
    ///
    /// Both images go through a layer before the next one: features of a whole network are not kept.
    ///
    /// - `images`: `[3, H, W]`, as the network expects them
    pub fn distance(&self, images: [&Image; 2]) -> f64 {
        let steps = self.backbone.steps();
        let (mut convolutions, mut heads) = (self.convolutions.iter(), self.heads.iter());
        let [first, ..] = &self.convolutions[..] else { unreachable!("a network has layers") };
        let mut pair = images.map(|image| interleave(image, first.padding));
        let mut distance = 0.0;
        for (i, step) in steps.iter().enumerate() {
            let margin = match steps.get(i + 1) {
                Some(Step::Convolve(next)) => next.padding,
                _ => 0,
            };
            match *step {
                Step::Pool { size, stride } => pair = pair.map(|input| max_pool(&input, size, stride, margin)),
                Step::Convolve(shape) => {
                    let Some(layer) = convolutions.next() else { unreachable!("one a step") };
                    pair = pair.map(|input| layer.apply(&input, margin));
                    if shape.compared {
                        let Some(head) = heads.next() else { unreachable!("one a compared layer") };
                        distance += compare(&pair[0], &pair[1], head);
                    }
                }
            }
        }
        distance
    }
}

/// From planes to pixels.
fn interleave(image: &Image, margin: usize) -> Features {
    let mut features = Features::zeros(image.height, image.width, image.num_channels, margin);
    features.fill(|row, values| {
        for (channel, plane) in (0..image.num_channels).map(|channel| (channel, image.plane(channel))) {
            let row = &plane[row * image.width..][..image.width];
            for (value, &pixel) in values.iter_mut().skip(channel).step_by(image.num_channels).zip(row) {
                *value = pixel;
            }
        }
    });
    features
}

/// Mean over pixels of `Σ_c head_c (a_c / |a| - b_c / |b|)²`, lengths over the channels of a pixel.
fn compare(a: &Features, b: &Features, head: &[f32]) -> f64 {
    use rayon::prelude::*;
    let rows: Vec<f64> = (0..a.height)
        .into_par_iter()
        .map(|row| {
            let pixels = a.row(row).chunks_exact(a.channels).zip(b.row(row).chunks_exact(b.channels));
            pixels.map(|(a, b)| pixel_distance(a, b, head)).sum()
        })
        .collect();
    rows.iter().sum::<f64>() / (a.height * a.width) as f64
}

fn pixel_distance(a: &[f32], b: &[f32], head: &[f32]) -> f64 {
    let inverse_length = |v: &[f32]| 1.0 / (v.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>().sqrt() + 1e-10);
    let (inverse_a, inverse_b) = (inverse_length(a), inverse_length(b));
    let differences = a.iter().zip(b).map(|(&a, &b)| f64::from(a) * inverse_a - f64::from(b) * inverse_b);
    differences.zip(head).map(|(difference, &weight)| f64::from(weight) * difference * difference).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_smallest_images_are_known() {
        assert!(Backbone::Vgg.sees(16, 40) && !Backbone::Vgg.sees(40, 15));
        assert!(Backbone::Alex.sees(31, 31) && !Backbone::Alex.sees(30, 31));
        assert!(!Backbone::Vgg.sees(0, 0));
    }

    #[test]
    fn a_pixel_is_compared_by_the_direction_of_its_features() {
        // (3, 4) / 5 and (0, 1): differences 0.6 and -0.2.
        let found = pixel_distance(&[3.0, 4.0], &[0.0, 7.0], &[1.0, 10.0]);
        assert!((found - (0.36 + 10.0 * 0.04)).abs() < 1e-9, "{found}");
        assert_eq!(pixel_distance(&[0.0; 2], &[0.0; 2], &[1.0; 2]), 0.0);
    }
}
