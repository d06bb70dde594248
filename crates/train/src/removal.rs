//! What removing a Gaussian does to the pictures: how much the mean squared error grows.
//!
//! A picture is linear in a Gaussian's alpha, so its removal changes each value by the alpha times the derivative to it. Of these
//! changes the sum of squares matters, and one backward gives a weighted sum of them. With random signs for weights the square of that
//! sum is the sum of squares in the mean: products of different values cancel. Each view is one draw.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use tcgs_core::{Activated, Camera, Image, View};
use tcgs_render::{Rasterizer, RenderSettings};

use crate::parameters::Parameters;

/// What removals do to the pictures of some views.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RemovalErrors {
    /// `[N]`, mean square of the change of the pictures if the Gaussian is removed alone, estimated.
    pub of_each: Vec<f32>,
    /// Mean squared error of the pictures as they are.
    pub now: f32,
}

impl RemovalErrors {
    /// The Gaussians that stay if those are removed that matter least, as long as the error grows by no more than a share of what it
    /// is. Errors of different Gaussians add up.
    ///
    /// - returns: indices, ascending; never none
    pub fn keep(&self, share: f32) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.of_each.len()).collect();
        order.sort_by(|&a, &b| self.of_each[a].total_cmp(&self.of_each[b]).then(a.cmp(&b)));
        let most = f64::from(share * self.now);
        let mut sum = 0.0;
        let num_removed = order
            .iter()
            .take_while(|&&i| {
                sum += f64::from(self.of_each[i]);
                sum <= most
            })
            .count();
        let mut keep = order.split_off(num_removed.min(order.len().saturating_sub(1)));
        keep.sort_unstable();
        keep
    }
}

/// What the removal of each Gaussian does to the pictures of some views.
///
/// - `drawn`: what a camera sees, three channels
/// - `parameters`: of which `drawn` is; the cameras' gains and offsets are those of `views`
/// - `seed`: of the random signs
///
/// # Errors
/// What the renderer fails with.
pub(crate) fn removal_errors<R: Rasterizer>(
    rasterizer: &R,
    drawn: impl Fn(&Camera) -> std::sync::Arc<Activated>,
    parameters: &Parameters,
    views: &[View],
    seed: u64,
) -> Result<RemovalErrors, R::Error> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut of_each = vec![0.0_f32; parameters.num_gaussians()];
    let settings = RenderSettings { statistic_channels: 0, ..RenderSettings::default() };
    let (mut num_values, mut squares) = (0, 0.0);
    for (i, view) in views.iter().enumerate() {
        let seen = drawn(&view.camera);
        let (output, saved) = rasterizer.forward(&seen, &view.camera, &settings)?;
        let found = parameters.seen_by_camera(i, output.image);
        let of_view = found.data.iter().zip(&view.image.data).map(|(a, b)| f64::from((a - b) * (a - b)));
        squares += of_view.sum::<f64>();
        num_values += found.data.len();
        let mut signs = Image::filled(view.camera.width, view.camera.height, 3, 1.0);
        for values in signs.data.chunks_mut(64) {
            let bits: u64 = random.random();
            values.iter_mut().enumerate().for_each(|(bit, value)| *value -= 2.0 * (bits >> bit & 1) as f32);
        }
        let grads = rasterizer.backward(&seen, &view.camera, &settings, &saved, &signs)?;
        (&mut of_each, &seen.opacities, &grads.activated.v_opacities)
            .into_par_iter()
            .for_each(|(sum, opacity, v)| *sum += (opacity * v).powi(2));
    }
    let share = 1.0 / num_values.max(1) as f32;
    of_each.iter_mut().for_each(|sum| *sum *= share);
    Ok(RemovalErrors { of_each, now: (squares / num_values.max(1) as f64) as f32 })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use tcgs_core::{BaseColumns, Gaussians, activate};
    use tcgs_render::CpuRasterizer;

    use super::*;

    #[test]
    fn errors_are_those_of_pictures_without_each() {
        let gaussians = Gaussians::from(BaseColumns {
            means: vec![[-0.5, 0.1, 0.0], [0.5, 0.0, 0.2], [0.0, -0.4, -0.2], [0.0, 0.0, 9.0]],
            quats: vec![[1.0, 0.0, 0.1, 0.0], [0.9, 0.0, 0.0, 0.4], [1.0, 0.2, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]],
            log_scales: vec![[-1.5, -1.3, -1.6], [-1.0, -2.0, -1.8], [-2.0, -1.2, -1.7], [-3.0; 3]],
            logit_opacities: vec![2.0, 1.0, 0.5, -2.0],
            colors: vec![[0.9, 0.3, 0.2], [0.2, 0.5, 0.9], [0.95, 0.8, 0.3], [0.1; 3]],
        });
        let activated = Arc::new(activate(&gaussians));
        let render = |scene: &Activated, camera: &Camera| {
            let Ok((output, _)) = CpuRasterizer.forward(scene, camera, &RenderSettings::default());
            output.image
        };
        // Many draws of two cameras.
        let cameras = [[0.3, 0.0, -2.5], [1.5, -0.5, -2.0]]
            .map(|from| Camera::look_at(from, [0.0; 3], [0.0, -1.0, 0.0], 60.0, 72, 54));
        let view = |i: usize| View {
            image: Image {
                data: render(&activated, &cameras[i % 2]).data.iter().map(|x| x + 0.1).collect(),
                ..Image::filled(72, 54, 3, 0.0)
            },
            camera: cameras[i % 2].clone(),
            segmentation: None,
            frame: 0,
            camera_id: i,
        };
        let views: Vec<View> = (0..2000).map(view).collect();
        let parameters = Parameters {
            gaussians: gaussians.clone(),
            camera_gains: vec![[0.0; 3]; views.len()],
            camera_offsets: vec![[0.0; 3]; views.len()],
            ..Parameters::default()
        };
        let Ok(found) = removal_errors(&CpuRasterizer, |_| Arc::clone(&activated), &parameters, &views, 0);
        assert!((found.now - 0.01).abs() < 1e-5, "{}", found.now);
        for i in 0..4 {
            let without = activated.select(&(0..4).filter(|&other| other != i).collect::<Vec<_>>());
            let squares: f32 = cameras
                .iter()
                .flat_map(|camera| {
                    let (a, b) = (render(&activated, camera).data, render(&without, camera).data);
                    a.into_iter().zip(b).map(|(a, b)| (a - b) * (a - b)).collect::<Vec<_>>()
                })
                .sum();
            let expected = squares / (2.0 * 3.0 * 72.0 * 54.0);
            let off = (found.of_each[i] - expected).abs();
            assert!(off <= 0.08 * expected, "{i}: {} for {expected}", found.of_each[i]);
        }
    }

    #[test]
    fn those_that_matter_least_go_up_to_a_share() {
        let errors = RemovalErrors { of_each: vec![0.3, 0.0, 0.1, 0.05, 0.2], now: 1.0 };
        assert_eq!(errors.keep(0.0), [0, 2, 3, 4]);
        assert_eq!(errors.keep(0.16), [0, 4]);
        assert_eq!(errors.keep(9.0), [0]);
    }
}
