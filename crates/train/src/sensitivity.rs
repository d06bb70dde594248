//! How much each parameter moves the pictures: `S(θ)`, paper Eq. 7.

use rayon::prelude::*;
use tcgs_core::{Camera, Gaussians, Image, Sensitivity, activate, activate_bwd, seen_colors, seen_colors_bwd};
use tcgs_render::{Rasterizer, RenderSettings};

/// `S(θ) = Σ_k |∂Q_k/∂θ| / Σ_k N_k`: `Q_k` the sum of all colour values of image `k` on the
/// background, unclamped, `N_k` its number of pixels.
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

#[cfg(test)]
mod tests {
    use tcgs_core::{Attribute, BaseColumns};
    use tcgs_render::CpuRasterizer;

    use super::*;

    /// Sum of all values of a picture.
    fn brightness(gaussians: &Gaussians, camera: &Camera) -> f64 {
        let drawn = CpuRasterizer.forward(&activate(gaussians), camera, &RenderSettings::default());
        let Ok((output, _)) = drawn;
        output.image.data.iter().map(|&v| f64::from(v)).sum()
    }

    #[test]
    fn sensitivities_are_central_differences_of_the_pictures() {
        let gaussians = Gaussians::from(BaseColumns {
            means: vec![[-0.5, 0.1, 0.0], [0.5, 0.0, 0.2], [0.0, -0.4, -0.2]],
            quats: vec![[1.0, 0.0, 0.1, 0.0], [0.9, 0.0, 0.0, 0.4], [1.0, 0.2, 0.0, 0.0]],
            log_scales: vec![[-1.5, -1.3, -1.6], [-1.0, -2.0, -1.8], [-2.0, -1.2, -1.7]],
            logit_opacities: vec![2.0, 1.0, 0.5],
            colors: vec![[0.9, 0.3, 0.2], [0.2, 0.5, 0.9], [0.95, 0.8, 0.3]],
        });
        // The first two see the scene from both sides: absolute values are taken of each picture, not of the sum.
        let camera = |from| Camera::look_at(from, [0.0; 3], [0.0, -1.0, 0.0], 60.0, 72, 54);
        let cameras = [camera([0.0, 0.0, -2.5]), camera([0.3, 0.2, 2.5]), camera([2.0, -0.5, -1.0])];
        let num_pixels = 3.0 * 72.0 * 54.0;
        let Ok(found) = sensitivity(&CpuRasterizer, &gaussians, &cameras);
        for attribute in Attribute::BASE {
            let (mut off, mut size) = (0.0, 0.0);
            for (i, &found) in found.values(attribute).iter().enumerate() {
                let moved = |by: f32| {
                    let mut moved = gaussians.clone();
                    moved.values_mut(attribute)[i] += by;
                    moved
                };
                let (ahead, back) = (moved(0.01), moved(-0.01));
                let slope = |camera| ((brightness(&ahead, camera) - brightness(&back, camera)) / 0.02).abs();
                let expected = cameras.iter().map(slope).sum::<f64>() / num_pixels;
                off += (f64::from(found) - expected).powi(2);
                size += expected * expected;
            }
            // Where a Gaussian is cut off changes with it.
            let error = (off / size).sqrt();
            assert!(error < 0.03, "{attribute:?}: relative L2 {error}");
        }
    }
}
