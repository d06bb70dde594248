//! Named ways to evaluate. Publications use the names PSNR, SSIM and LPIPS for different things, so a figure has a
//! meaning only together with its protocol.
//!
//! A protocol prescribes how pixels are prepared, the metrics with their names, and the cameras, frames and sizes. The
//! first two are computed here. The last are only stated, because the capture decides them. All means are over the
//! images of a scene, then over scenes, unweighted.

use std::fmt::Write;

use tcgs_core::Image;

use crate::lpips::{Backbone, InputRange, Lpips};
use crate::{dssim, ms_ssim, psnr, psnr_per_channel, ssim, uniform_ssim};

/// A published way to evaluate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Protocol {
    /// *Temporally Compressed 3D Gaussian Splatting*: the evaluation in its authors' development fork.
    Tc3dgs,
    /// *4D Gaussian Splatting* (Wu et al. 2024): `metrics.py` of its code.
    FourDgs,
    /// *Spacetime Gaussians* (Li et al. 2024): `test.py` of its code.
    Stg,
}

/// The rules of a protocol.
#[derive(Debug)]
pub struct Rules {
    /// Name of the protocol for machines, such as an option of a command: `tc3dgs`.
    pub name: &'static str,
    /// The publication, and the program of it that measures.
    pub source: &'static str,
    /// How pixel values are prepared before images are compared.
    pub range: PixelRange,
    /// The metrics, in the order in which the protocol's program prints them.
    pub metrics: &'static [ProtocolMetric],
    /// Cameras that are held out of training, by data set. Stated, not enforced.
    pub split: &'static str,
    /// Frames that the means are over, by data set. Stated, not enforced.
    pub frames: &'static str,
    /// Size of the images, pixels, by data set. Stated, not enforced.
    pub resizing: &'static str,
}

/// How pixel values are prepared before images are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelRange {
    /// Unchanged: renders keep values outside of `[0, 1]`.
    Unclamped,
    /// Renders are clamped to `[0, 1]`.
    Clamped,
    /// Renders and images are rounded to 8 bits, as when written to PNG files and read again.
    EightBit,
}

/// A metric under the name that a protocol gives it.
#[derive(Debug)]
pub struct ProtocolMetric {
    /// Key of the metric in JSON, unique within the protocol.
    pub key: &'static str,
    /// Name that the protocol's program prints.
    pub title: &'static str,
    /// How the value is computed.
    pub measure: Measure,
}

/// A metric as computed, independent of a protocol's name for it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Measure {
    /// [`psnr`](crate::psnr): dB over all channels together.
    Psnr,
    /// [`psnr_per_channel`](crate::psnr_per_channel): dB, the mean over the channels.
    PsnrPerChannel,
    /// [`ssim`](crate::ssim): a Gaussian window of 11x11 pixels.
    Ssim,
    /// [`uniform_ssim`] with a data range of 2.
    UniformSsim,
    /// [`ms_ssim`](crate::ms_ssim): five scales.
    MsSsim,
    /// [`dssim`](crate::dssim) of [`ms_ssim`](crate::ms_ssim).
    Dssim,
    /// [`Lpips::distance`] with [`InputRange::Unit`], which all three protocols have.
    LpipsUnit(Backbone),
}

const fn metric(key: &'static str, title: &'static str, measure: Measure) -> ProtocolMetric {
    ProtocolMetric { key, title, measure }
}

const TC3DGS: Rules = Rules {
    name: "tc3dgs",
    source: "Temporally Compressed 3D Gaussian Splatting, its authors' fork",
    range: PixelRange::Unclamped,
    metrics: &[
        metric("psnr", "PSNR", Measure::PsnrPerChannel),
        metric("ssim", "SSIM", Measure::Ssim),
        metric("lpips", "LPIPS", Measure::LpipsUnit(Backbone::Vgg)),
    ],
    split: "0, 10, 15, 30 of Panoptic Sports; cam00 of Neural 3D Video; cam10 of Technicolor",
    frames: "all 150 of Panoptic Sports, the first 300 of Neural 3D Video, 50 of Technicolor",
    resizing: "Panoptic Sports as it is, 640x360; Neural 3D Video halved to 1352x1014; Technicolor as it is, 2048x1088",
};

const FOUR_DGS: Rules = Rules {
    name: "4dgs",
    source: "4D Gaussian Splatting, metrics.py",
    range: PixelRange::EightBit,
    metrics: &[
        metric("ssim", "SSIM", Measure::Ssim),
        metric("psnr", "PSNR", Measure::Psnr),
        metric("lpips_vgg", "LPIPS-vgg", Measure::LpipsUnit(Backbone::Vgg)),
        metric("lpips_alex", "LPIPS-alex", Measure::LpipsUnit(Backbone::Alex)),
        metric("ms_ssim", "MS-SSIM", Measure::MsSsim),
        metric("dssim", "D-SSIM", Measure::Dssim),
    ],
    split: "cam00 of Neural 3D Video",
    frames: "the first 300",
    resizing: "halved to 1352x1014 by Lanczos",
};

const STG: Rules = Rules {
    name: "stg",
    source: "Spacetime Gaussians, test.py",
    range: PixelRange::Clamped,
    metrics: &[
        metric("ssim", "SSIM", Measure::Ssim),
        metric("psnr", "PSNR", Measure::Psnr),
        metric("lpips", "LPIPS", Measure::LpipsUnit(Backbone::Alex)),
        metric("ssimsv2", "ssimsv2", Measure::UniformSsim),
        metric("lpips_vgg", "LPIPSVGG", Measure::LpipsUnit(Backbone::Vgg)),
    ],
    split: "cam00 of Neural 3D Video, cam10 of Technicolor",
    frames: "50 a model: six models for the 300 of Neural 3D Video, one for Technicolor",
    resizing: "Neural 3D Video halved to 1352x1014; Technicolor as it is, 2048x1088",
};

impl Protocol {
    /// Every protocol.
    pub const ALL: [Self; 3] = [Self::Tc3dgs, Self::FourDgs, Self::Stg];

    /// The rules of the protocol.
    pub const fn rules(self) -> &'static Rules {
        match self {
            Self::Tc3dgs => &TC3DGS,
            Self::FourDgs => &FOUR_DGS,
            Self::Stg => &STG,
        }
    }

    /// One image's metrics, in the order of [`Rules::metrics`]; `None` for LPIPS without weights, and where an image is
    /// too small for a metric.
    ///
    /// ```
    /// use tcgs_core::Image;
    /// use tcgs_metrics::Protocol;
    /// // A render beyond white: the first protocol sees it, the others do not.
    /// let (rendered, target) = (Image::filled(20, 20, 3, 1.1), Image::filled(20, 20, 3, 1.0));
    /// let psnr = |protocol: Protocol| {
    ///     let metrics = protocol.rules().metrics;
    ///     let index = metrics.iter().position(|metric| metric.key == "psnr").unwrap();
    ///     protocol.measure(&rendered, &target, None)[index].unwrap()
    /// };
    /// assert!((psnr(Protocol::Tc3dgs) - 20.0).abs() < 1e-5);
    /// assert_eq!((psnr(Protocol::FourDgs), psnr(Protocol::Stg)), (100.0, 100.0));
    /// ```
    ///
    /// # Panics
    /// If the images differ in shape or have not three channels.
    pub fn measure(self, rendered: &Image, target: &Image, lpips: Option<&Lpips>) -> Vec<Option<f64>> {
        let rules = self.rules();
        let (rendered, target) = match rules.range {
            PixelRange::Unclamped => (rendered.clone(), target.clone()),
            PixelRange::Clamped => (mapped(rendered, |x| x.clamp(0.0, 1.0)), target.clone()),
            PixelRange::EightBit => (mapped(rendered, eight_bit), mapped(target, eight_bit)),
        };
        let measured = rules.metrics.iter().map(|metric| metric.measure.of(&rendered, &target, lpips));
        measured.collect()
    }

    /// The rules in words, several lines without a newline at the end, to accompany every table that follows the
    /// protocol.
    pub fn describe(self) -> String {
        let rules = self.rules();
        let mut text = format!("protocol {} ({})\n", rules.name, rules.source);
        let mut line = |what: &str, prescribed: &str| {
            let _ = writeln!(text, "  {what:<10}  {prescribed}");
        };
        line("pixels", rules.range.describe());
        for metric in rules.metrics {
            line(metric.title, metric.measure.describe());
        }
        line("mean", "over all images of a scene");
        line("cameras", rules.split);
        line("frames", rules.frames);
        line("size", rules.resizing);
        text.trim_end().to_owned()
    }
}

impl Measure {
    fn of(self, rendered: &Image, target: &Image, lpips: Option<&Lpips>) -> Option<f64> {
        match self {
            Self::Psnr => Some(psnr(rendered, target)),
            Self::PsnrPerChannel => Some(psnr_per_channel(rendered, target)),
            Self::Ssim => Some(ssim(rendered, target)),
            Self::UniformSsim => uniform_ssim(rendered, target, 2.0),
            Self::MsSsim => ms_ssim(rendered, target),
            Self::Dssim => ms_ssim(rendered, target).map(dssim),
            Self::LpipsUnit(backbone) => lpips?.distance(backbone, InputRange::Unit, rendered, target),
        }
    }

    /// In words.
    pub const fn describe(self) -> &'static str {
        match self {
            Self::Psnr => "all channels together",
            Self::PsnrPerChannel => "mean of the channels' PSNRs",
            Self::Ssim => "Gaussian window 11x11, sigma 1.5, zeros beyond the edge",
            Self::UniformSsim => "SSIM again: uniform window 7x7 inside the image, data range 2 (scikit-image, floats)",
            Self::MsSsim => "five scales, windows inside the image (pytorch_msssim)",
            Self::Dssim => "(1 - MS-SSIM) / 2",
            Self::LpipsUnit(Backbone::Vgg) => "version 0.1, VGG, given [0, 1] where [-1, 1] is meant (lpipsPyTorch)",
            Self::LpipsUnit(Backbone::Alex) => {
                "version 0.1, AlexNet, given [0, 1] where [-1, 1] is meant (lpipsPyTorch)"
            }
        }
    }
}

impl PixelRange {
    /// In words.
    pub const fn describe(self) -> &'static str {
        match self {
            Self::Unclamped => "floats in [0, 1], renders not clamped, without a camera's gain and offset",
            Self::Clamped => "floats in [0, 1], renders clamped",
            Self::EightBit => "renders and images rounded to 8 bits (PNG)",
        }
    }
}

fn mapped(image: &Image, map: impl Fn(f32) -> f32) -> Image {
    Image { data: image.data.iter().map(|&x| map(x)).collect(), ..*image }
}

/// Rounded to 8 bits as in a PNG: halves are rounded up.
fn eight_bit(x: f32) -> f32 {
    (x * 255.0 + 0.5).clamp(0.0, 255.0).floor() / 255.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eight_bits_round_and_clamp() {
        let levels = [-0.2, 0.0, 0.0019, 0.002, 0.5, 0.9999, 1.3].map(|x| eight_bit(x) * 255.0);
        assert_eq!(levels, [0.0, 0.0, 0.0, 1.0, 128.0, 255.0, 255.0]);
    }

    #[test]
    fn names_are_unique_and_rules_are_printed() {
        for protocol in Protocol::ALL {
            let rules = protocol.rules();
            let mut keys: Vec<&str> = rules.metrics.iter().map(|metric| metric.key).collect();
            keys.sort_unstable();
            keys.dedup();
            assert_eq!(keys.len(), rules.metrics.len(), "{}", rules.name);
            let text = protocol.describe();
            for part in [rules.name, rules.range.describe(), rules.split, rules.frames, rules.resizing] {
                assert!(text.contains(part), "{part} in {text}");
            }
            assert!(rules.metrics.iter().all(|metric| text.contains(metric.measure.describe())));
        }
    }

    #[test]
    fn lpips_without_weights_is_none_and_so_is_what_needs_larger_images() {
        let image = Image::filled(6, 200, 3, 0.5);
        let found = |protocol: Protocol| {
            let measured = protocol.measure(&image, &image, None);
            let metrics = protocol.rules().metrics.iter().map(|metric| metric.key);
            metrics.zip(measured).filter(|(_, value)| value.is_some()).map(|(key, _)| key).collect::<Vec<_>>()
        };
        assert_eq!(found(Protocol::Tc3dgs), ["psnr", "ssim"]);
        assert_eq!(found(Protocol::FourDgs), ["ssim", "psnr"]);
        assert_eq!(found(Protocol::Stg), ["ssim", "psnr"]);
    }
}
