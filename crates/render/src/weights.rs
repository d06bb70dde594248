//! Each Gaussian's share of the pixels.

use tcgs_core::{Activated, Camera, Image};

use crate::{Rasterizer, RenderSettings};

/// A camera's image is halved if its shorter side has at least this many pixels.
const MIN_HALVED: usize = 128;

/// Step between the camera's pixels at which weights are sampled, in either direction: 1 or 2.
pub fn weights_step(camera: &Camera) -> usize {
    1 + usize::from(camera.width.min(camera.height) >= MIN_HALVED)
}

/// The blending weight of every Gaussian, summed over pixels: the number of pixels that it would fill alone.
///
/// The gradient of `Σ pixels v · picture` to a Gaussian's colour is `Σ pixels v · weight`.
///
/// - `drawn`: `[N]`; its colours do not matter
/// - `shares`: `[C, H, W]` of the camera's size, each pixel's weight in each of `C` sums
/// - returns: `[N, C]`, pixels
///
/// ```
/// use tcgs_core::{Activated, Camera, Image};
/// use tcgs_render::{CpuRasterizer, blending_weights};
/// let camera = Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
/// // Two behind each other: the first takes nine tenths of every pixel, and leaves a tenth of the second's nine.
/// let two = Activated {
///     means: vec![[0.0; 3], [0.0, 0.0, 1.0]],
///     quats: vec![[1.0, 0.0, 0.0, 0.0]; 2],
///     scales: vec![[100.0, 100.0, 0.01]; 2],
///     opacities: vec![0.9; 2],
///     colors: vec![0.0; 6],
///     num_channels: 3,
///     is_antialiased: false,
/// };
/// let ones = Image::filled(64, 48, 1, 1.0);
/// let Ok(weights) = blending_weights(&CpuRasterizer, &two, &camera, &ones);
/// assert!((weights[0] / (64.0 * 48.0) - 0.9).abs() < 0.01 && (weights[1] / weights[0] - 0.1).abs() < 0.01);
/// ```
///
/// # Errors
/// The renderer's error.
pub fn blending_weights<R: Rasterizer>(
    rasterizer: &R,
    drawn: &Activated,
    camera: &Camera,
    shares: &Image,
) -> Result<Vec<f32>, R::Error> {
    let channels = shares.num_channels;
    let black =
        Activated { colors: vec![0.0; channels * drawn.num_gaussians()], num_channels: channels, ..drawn.clone() };
    let settings = RenderSettings { statistic_channels: 0, ..RenderSettings::default() };
    let (_, saved) = rasterizer.forward(&black, camera, &settings)?;
    let grads = rasterizer.backward(&black, camera, &settings, &saved, shares)?;
    Ok(grads.activated.v_colors)
}
