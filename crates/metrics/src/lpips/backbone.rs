//! The two networks whose features are compared: VGG-16 (Simonyan & Zisserman 2015) and AlexNet (Krizhevsky 2014).

/// The network that computes the features.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Backbone {
    /// VGG-16: close to what optimisation with perceptual losses uses; the usual choice for rendering.
    Vgg,
    /// AlexNet: the metric's authors' choice for comparing, and a twentieth of the work.
    Alex,
}

impl Backbone {
    /// Both networks, in the order of the file of weights.
    pub const ALL: [Self; 2] = [Self::Vgg, Self::Alex];

    /// Name of the network; its tensors' names in the file of weights begin with it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vgg => "vgg",
            Self::Alex => "alex",
        }
    }

    /// Its layers, from the image on.
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

    /// Whether an image leaves features at every layer: VGG needs 16 pixels a side, AlexNet 31.
    ///
    /// - `width`, `height`: pixels
    ///
    /// ```
    /// use tcgs_metrics::Backbone;
    /// assert!(Backbone::Vgg.sees(16, 40) && !Backbone::Alex.sees(30, 40));
    /// ```
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

/// The shape of a convolution, without its weights.
#[derive(Clone, Copy)]
// Without the networks the channels are unused; the sizes give the smallest image.
#[cfg_attr(not(feature = "lpips"), allow(dead_code))]
pub(super) struct Shape {
    pub size: usize,
    pub stride: usize,
    pub padding: usize,
    /// Number of channels of its result.
    pub channels: usize,
    /// Whether its result is compared.
    pub compared: bool,
}

/// Pixels that a window of `size` finds, every `stride`; `None` if the image is smaller than the window.
pub(super) fn num_windows(side: usize, size: usize, stride: usize) -> Option<usize> {
    side.checked_sub(size).map(|rest| rest / stride + 1)
}
