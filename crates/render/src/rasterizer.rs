//! The contract of every renderer.

use std::error::Error;
use std::sync::Arc;

use tcgs_core::{Activated, ActivatedGrads, Camera, Image};

use crate::device::GpuError;
use crate::settings::RenderSettings;

/// Result of a forward pass.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderOutput {
    /// `[C, H, W]`, background included, neither clamped nor colour-corrected.
    pub image: Image,
    /// `[H, W]` share of light that passes all splats, `∏(1 − alpha)`.
    pub transmittance: Vec<f32>,
}

/// Result of a backward pass.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderGrads {
    /// Gradients to the activated Gaussians.
    pub activated: ActivatedGrads,
    /// `[N, 2]` densification statistic: gradient of the statistic channels alone to the projected
    /// centre, in NDC units (pixels times half the image size).
    pub v_means2d_ndc: Vec<[f32; 2]>,
    /// `[N]` whether the Gaussian reached the image's tiles.
    pub visible: Vec<bool>,
}

/// A differentiable renderer of activated Gaussians.
pub trait Rasterizer {
    /// State that forward saves for backward.
    type Saved;

    /// Error of the renderer; [`Infallible`](std::convert::Infallible) on the CPU.
    type Error: Error + Send + Sync + 'static;

    /// Renders all channels of `gaussians.colors` in one pass.
    ///
    /// # Errors
    /// [`Self::Error`] if the device lacks the memory, or fails.
    ///
    /// # Panics
    /// If arrays of `gaussians` disagree in length, or `num_channels` is not in `1..=MAX_CHANNELS`.
    fn forward(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(RenderOutput, Self::Saved), Self::Error>;

    /// Overwrites: gradients of one forward pass.
    ///
    /// - `gaussians`, `camera`, `settings`: as given to `forward`
    /// - `v_image`: `[C, H, W]`, gradient to the rendered image
    ///
    /// # Errors
    /// As [`Self::forward`].
    ///
    /// # Panics
    /// If `v_image` has another shape than the rendered image; on the CPU also if
    /// [`RenderSettings::statistic_channels`] has another value than its documented ones.
    fn backward(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
        saved: &Self::Saved,
        v_image: &Image,
    ) -> Result<RenderGrads, Self::Error>;
}

/// A renderer for pictures without gradients.
pub trait Draw: Send + Sync {
    /// Error of the renderer; [`Infallible`](std::convert::Infallible) on the CPU.
    type Error: Error + Send + Sync + 'static;

    /// Name of the device for reports: `cpu, 2 threads`.
    fn name(&self) -> String;

    /// Renders all channels of `gaussians.colors` in one pass; as [`Rasterizer::forward`].
    ///
    /// - `gaussians`: shared, so that a renderer with memory of its own can recognise Gaussians that it already has
    /// - returns: the image, and the milliseconds of drawing, without transfers to or from the GPU
    ///
    /// # Errors
    /// As [`Rasterizer::forward`].
    fn draw(
        &self,
        gaussians: &Arc<Activated>,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(RenderOutput, f64), Self::Error>;
}

/// A renderer chosen at run time; made by [`draw_any`].
pub type DrawAny = dyn Draw<Error = GpuError>;

/// Wraps any renderer in one type.
///
/// ```
/// # #[cfg(feature = "cpu")] {
/// use tcgs_render::{CpuRasterizer, Draw, DrawAny, draw_any};
/// let renderer: Box<DrawAny> = draw_any(CpuRasterizer);
/// assert!(renderer.name().starts_with("cpu"));
/// # }
/// ```
pub fn draw_any<D: Draw<Error: Into<GpuError>> + 'static>(renderer: D) -> Box<DrawAny> {
    Box::new(Any(renderer))
}

struct Any<D>(D);

impl<D: Draw<Error: Into<GpuError>>> Draw for Any<D> {
    type Error = GpuError;

    fn name(&self) -> String {
        self.0.name()
    }

    fn draw(
        &self,
        gaussians: &Arc<Activated>,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(RenderOutput, f64), GpuError> {
        self.0.draw(gaussians, camera, settings).map_err(Into::into)
    }
}
