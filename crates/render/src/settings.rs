//! All cut-offs of visibility, each defined once with its reason.

/// Most channels that one pass blends.
pub const MAX_CHANNELS: usize = 8;

/// Channels that are colours, where others follow: red, green and blue before those of segmentation.
pub const COLOR_CHANNELS: usize = 3;

/// Gaussians whose centre is nearer than this (camera z, scene units) or behind are culled, because the projection's
/// linearisation breaks down there.
pub const NEAR: f64 = 0.2;

/// Variance added to both axes of a splat, px²: the pixel's own extent, so that no splat falls
/// between pixel centres.
pub const BLUR_VARIANCE: f64 = 0.3;

/// A splat reaches every pixel where its alpha is at least this, whatever the tiles: a smaller alpha is invisible,
/// being below one step of an 8-bit image.
pub const MIN_ALPHA: f64 = 1.0 / 255.0;

/// Alpha is clamped here, so that splats behind keep a gradient and `1 − alpha` is a safe divisor.
pub const MAX_ALPHA: f64 = 0.99;

/// A pixel is finished before the splat that would bring its transmittance below this: a maximal-opacity Gaussian must
/// be blended twice to end a pixel, `(1 − MAX_ALPHA)²`.
pub const MIN_TRANSMITTANCE: f64 = 1e-4;

/// Before the Jacobian of the projection is computed, `x/z` and `y/z` are clamped to the image's field of view, widened
/// by this share of half its (centred) extent. Beyond it the linearisation stretches splats without bound.
pub const FOV_MARGIN: f64 = 0.3;

/// A renderer's inputs besides Gaussians and a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderSettings {
    /// Colour behind everything, one value per channel. Default: the Gaussians' own
    /// ([`Activated::background`](tcgs_core::Activated)).
    pub background: Option<[f32; MAX_CHANNELS]>,
    /// Number of leading channels whose gradient the densification statistic counts: 0, [`COLOR_CHANNELS`] or all.
    /// Default: the colours, without the segmentation that shares the pass.
    pub statistic_channels: usize,
    /// Number of leading channels whose colours are learned. A renderer may leave the gradients to the other colours 0.
    /// Default: all.
    pub learned_channels: usize,
}

impl RenderSettings {
    /// The same settings, with the background of Gaussians unless there is one.
    ///
    /// - `background`: [`Activated::background`](tcgs_core::Activated)
    ///
    /// # Panics
    /// If `background` has more than `MAX_CHANNELS` channels.
    #[must_use]
    pub fn or_background(self, background: &[f32]) -> Self {
        let own = || {
            let mut channels = [0.0; MAX_CHANNELS];
            channels[..background.len()].copy_from_slice(background);
            channels
        };
        Self { background: Some(self.background.unwrap_or_else(own)), ..self }
    }
}

impl Default for RenderSettings {
    fn default() -> Self {
        Self { background: None, statistic_channels: COLOR_CHANNELS, learned_channels: MAX_CHANNELS }
    }
}
