//! How much each parameter moves the pictures: `S(θ)`, paper Eq. 7.

use rayon::prelude::*;
use tcgs_core::{Camera, Gaussians, Image, Sensitivity, activate, activate_bwd, seen_colors, seen_colors_bwd};
use tcgs_render::{Rasterizer, RenderSettings};

/// `S(θ) = Σ_k |∂Q_k/∂θ| / Σ_k N_k`: `Q_k` the sum of all colour values of image `k` over black,
/// unclamped, `N_k` its number of pixels.
///
/// - `rasterizer`: renders, and takes gradients back
/// - `gaussians`: `[N]`, stored form; the sensitivities are with respect to it
/// - `cameras`: of the training views, one rendering each
/// - returns: of the same columns, all values >= 0, colour per unit of the parameter
///
/// Paper, Eq. 7; the absolute value is taken per view as in Niedermayr et al. 2024.
///
/// # Errors
/// What the renderer fails with; [`CpuRasterizer`](tcgs_render::CpuRasterizer) never does.
pub fn sensitivity<R: Rasterizer>(
    rasterizer: &R,
    gaussians: &Gaussians,
    cameras: &[Camera],
) -> Result<Sensitivity, R::Error> {
    let mut activated = activate(gaussians);
    let has_harmonics = gaussians.layout().sh_degree() > 0;
    let settings = RenderSettings::default();
    let mut sum = Sensitivity::zeros_of(gaussians.layout(), gaussians.num_gaussians());
    for camera in cameras {
        if has_harmonics {
            activated.colors = seen_colors(gaussians, camera);
        }
        let (_, saved) = rasterizer.forward(&activated, camera, &settings)?;
        let ones = Image::filled(camera.width, camera.height, 3, 1.0);
        let render = rasterizer.backward(&activated, camera, &settings, &saved, &ones)?;
        let mut v = activate_bwd(gaussians, &activated, &render.activated);
        if has_harmonics {
            seen_colors_bwd(gaussians, camera, &mut v);
        }
        for attribute in gaussians.layout().attributes() {
            sum.values_mut(attribute).par_iter_mut().zip(v.values(attribute)).for_each(|(s, v)| *s += v.abs());
        }
    }
    let num_pixels: usize = cameras.iter().map(|c| c.width * c.height).sum();
    for attribute in gaussians.layout().attributes() {
        sum.values_mut(attribute).par_iter_mut().for_each(|s| *s /= num_pixels.max(1) as f32);
    }
    Ok(sum)
}
