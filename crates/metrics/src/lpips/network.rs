//! The two networks whose features are compared: VGG-16 (Simonyan & Zisserman 2015) and AlexNet (Krizhevsky 2014).

use tcgs_core::Image;

use super::layers::{Convolution, Features, max_pool, num_windows};

/// Which network looks at the images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Backbone {
    /// VGG-16: close to what optimisation with perceptual losses uses; the usual choice for rendering.
    Vgg,
    /// AlexNet: the metric's authors' choice for comparing, and a twentieth of the work.
    Alex,
}

impl Backbone {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Vgg, Self::Alex];

    /// What its tensors' names begin with.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vgg => "vgg",
            Self::Alex => "alex",
        }
    }

    /// Its layers from the image on.
    pub(super) fn steps(self) -> &'static [Step] {
        use Step::{Convolve, Pool};
        const fn vgg(channels: usize, compared: bool) -> Step {
            Convolve(Shape { size: 3, stride: 1, padding: 1, channels, compared })
        }
        const fn alex(size: usize, stride: usize, padding: usize, channels: usize) -> Step {
            Convolve(Shape { size, stride, padding, channels, compared: true })
        }
        const HALVE: Step = Pool { size: 2, stride: 2 };
        const OVERLAP: Step = Pool { size: 3, stride: 2 };
        const VGG: &[Step] = &[
            vgg(64, false),
            vgg(64, true),
            HALVE,
            vgg(128, false),
            vgg(128, true),
            HALVE,
            vgg(256, false),
            vgg(256, false),
            vgg(256, true),
            HALVE,
            vgg(512, false),
            vgg(512, false),
            vgg(512, true),
            HALVE,
            vgg(512, false),
            vgg(512, false),
            vgg(512, true),
        ];
        const ALEX: &[Step] = &[
            alex(11, 4, 2, 64),
            OVERLAP,
            alex(5, 1, 2, 192),
            OVERLAP,
            alex(3, 1, 1, 384),
            alex(3, 1, 1, 256),
            alex(3, 1, 1, 256),
        ];
        match self {
            Self::Vgg => VGG,
            Self::Alex => ALEX,
        }
    }

    /// Whether an image of this size leaves features at every layer: VGG needs 16 pixels a side, AlexNet 31.
    pub fn sees(self, width: usize, height: usize) -> bool {
        let after = |side: usize| {
            self.steps().iter().try_fold(side, |side, step| match *step {
                Step::Convolve(shape) => num_windows(side + 2 * shape.padding, shape.size, shape.stride),
                Step::Pool { size, stride } => num_windows(side, size, stride),
            })
        };
        width > 0 && height > 0 && after(width.min(height)).is_some()
    }
}

/// A layer.
pub(super) enum Step {
    Convolve(Shape),
    Pool { size: usize, stride: usize },
}

/// What a convolution is like, but for its numbers.
#[derive(Clone, Copy)]
pub(super) struct Shape {
    pub size: usize,
    pub stride: usize,
    pub padding: usize,
    /// Of its result.
    pub channels: usize,
    /// Whether its result is compared.
    pub compared: bool,
}

/// A network with its numbers.
pub(super) struct Network {
    pub backbone: Backbone,
    /// Those of the steps, in order.
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
