//! Pruning by a measured error: removes Gaussians that the training images hardly need.
//!
//! The order of removal comes from an estimate for each Gaussian. The number comes from pictures drawn without the removed
//! ones. Estimates alone do not give it, because neighbours that are removed together cost more than the sum of both.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tcgs_core::{Activated, Camera, Gaussians, Image, View, activate, seen_colors};
use tcgs_metrics::psnr;
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings, settings::MAX_CHANNELS};

use crate::parameters::Parameters;
use crate::unseen::are_in_images;

/// Bisection ends when the number of Gaussians to remove is known within `1 / PRECISION` of all.
const PRECISION: usize = 128;

/// Largest share of the Gaussians that one call removes. The others need iterations to take over.
const MOST_AT_ONCE: f32 = 0.4;

/// Without the statistic of densification.
const SETTINGS: RenderSettings = RenderSettings { background: [0.0; MAX_CHANNELS], statistic_channels: 0 };

/// Gaussians that stay when as many are removed as the training images allow.
///
/// A Gaussian outside of all images stays, because no image tells whether it is needed.
///
/// - `is_hidden`: `[N]` whether a mask hides the Gaussian
/// - `views`: the training views, in the order of the cameras' gains and offsets
/// - `share`: by how much the mean squared error of all views may grow, as a share of it
/// - returns: indices, ascending
pub(crate) fn needed(parameters: &Parameters, is_hidden: &[bool], views: &[View], share: f32, seed: u64) -> Vec<usize> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera.clone()).collect();
    let errors = removal_errors(&parameters.gaussians, is_hidden, &cameras, seed);
    let is_shown = are_in_images(parameters.gaussians.means(), &cameras);
    let mut order: Vec<usize> = (0..errors.len()).filter(|&i| is_shown[i]).collect();
    order.sort_by(|&a, &b| errors[a].total_cmp(&errors[b]));
    let error_without = |removed: &[usize]| -> f64 {
        let mut is_hidden = is_hidden.to_vec();
        removed.iter().for_each(|&i| is_hidden[i] = true);
        let mut sum = 0.0;
        draw_all(&parameters.gaussians, &is_hidden, &cameras, |position, drawn| {
            let Ok((output, _)) = CpuRasterizer.forward(drawn, &cameras[position], &SETTINGS);
            let picture = parameters.seen_by_camera(position, output.image);
            sum += 10.0_f64.powf(-0.1 * psnr(&picture, &views[position].image));
        });
        sum
    };
    let most = f64::from(1.0 + share) * error_without(&[]);
    // All of `low` may go, and not all of `high`.
    let (mut low, mut high) = (0, (order.len() as f32 * MOST_AT_ONCE) as usize + 1);
    while high - low > 1 + errors.len() / PRECISION {
        let middle = low.midpoint(high);
        if error_without(&order[..middle]) <= most { low = middle } else { high = middle }
    }
    let mut keeps = vec![true; errors.len()];
    order[..low].iter().for_each(|&i| keeps[i] = false);
    (0..keeps.len()).filter(|&i| keeps[i]).collect()
}

/// Gives the Gaussians as each camera sees them, one camera after another.
fn draw_all(gaussians: &Gaussians, is_hidden: &[bool], cameras: &[Camera], mut see: impl FnMut(usize, &Activated)) {
    let mut activated = activate(gaussians);
    let opacities = activated.opacities.iter_mut().zip(is_hidden);
    opacities.filter(|(_, is_hidden)| **is_hidden).for_each(|(opacity, _)| *opacity = 0.0);
    for (position, camera) in cameras.iter().enumerate() {
        if gaussians.layout().sh_degree() > 0 {
            activated.colors = seen_colors(gaussians, camera);
        }
        see(position, &activated);
    }
}

/// Estimates, for each Gaussian, the sum of squared changes of all colour values of all pictures when it is removed.
///
/// A pixel is affine in the opacity of each Gaussian, so a removal changes it by opacity times derivative. Hutchinson (1989):
/// the sum of squares of these changes is the expected square of their sum with random signs. One backward pass with random
/// signs as `∂L/∂image` gives one sample for every Gaussian.
///
/// - `is_hidden`: `[N]`
/// - returns: `[N]`
fn removal_errors(gaussians: &Gaussians, is_hidden: &[bool], cameras: &[Camera], seed: u64) -> Vec<f32> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut errors = vec![0.0; gaussians.num_gaussians()];
    draw_all(gaussians, is_hidden, cameras, |position, drawn| {
        let camera = &cameras[position];
        let Ok((_, saved)) = CpuRasterizer.forward(drawn, camera, &SETTINGS);
        let mut signs = Image::filled(camera.width, camera.height, 3, 1.0);
        signs.data.iter_mut().filter(|_| random.random()).for_each(|sign| *sign = -1.0);
        let Ok(grads) = CpuRasterizer.backward(drawn, camera, &SETTINGS, &saved, &signs);
        let changes = drawn.opacities.iter().zip(&grads.activated.v_opacities).map(|(o, v)| o * v);
        errors.iter_mut().zip(changes).for_each(|(error, change)| *error += change * change);
    });
    errors
}

#[cfg(test)]
mod tests {
    use tcgs_core::BaseColumns;

    use super::*;

    /// Three Gaussians in the image, one hidden behind the first, one outside of the image.
    fn scene() -> (Parameters, Vec<View>) {
        let gaussians = Gaussians::from(BaseColumns {
            means: vec![[-0.4, 0.0, 0.0], [0.1, 0.3, -0.1], [0.4, -0.1, 0.1], [-1.6, 0.0, 9.0], [40.0, 0.0, 0.0]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 5],
            log_scales: vec![[-1.2; 3], [-2.0; 3], [-1.5; 3], [-2.5; 3], [-1.0; 3]],
            logit_opacities: vec![6.0, -2.5, 1.0, 1.0, 3.0],
            colors: vec![[0.9, 0.3, 0.2], [0.2, 0.5, 0.9], [0.9, 0.8, 0.3], [0.1, 0.9, 0.1], [1.0; 3]],
        });
        let camera = |x| Camera::look_at([x, 0.0, -3.0], [x, 0.0, 0.0], [0.0, -1.0, 0.0], 60.0, 72, 54);
        let views = [-0.05, 0.05].map(|x| {
            let camera = camera(x);
            let Ok((drawn, _)) = CpuRasterizer.forward(&activate(&gaussians), &camera, &SETTINGS);
            let mut image = drawn.image;
            // An error that training has not removed yet.
            image.data.iter_mut().enumerate().for_each(|(i, value)| *value += 0.02 * (i % 7) as f32);
            View { camera, image, segmentation: None, frame: 0, camera_id: usize::from(x > 0.0) }
        });
        let parameters = Parameters {
            gaussians,
            mask_logits: vec![1.0; 5],
            foreground: vec![true; 5],
            camera_gains: vec![[0.0; 3]; 2],
            camera_offsets: vec![[0.0; 3]; 2],
        };
        (parameters, views.into())
    }

    #[test]
    fn the_mean_over_random_signs_is_what_a_removal_changes() {
        let (parameters, views) = scene();
        let gaussians = &parameters.gaussians;
        let cameras: Vec<Camera> = views.iter().map(|view| view.camera.clone()).collect();
        let pictures = |is_hidden: &[bool]| {
            let mut all = Vec::new();
            draw_all(gaussians, is_hidden, &cameras, |position, drawn| {
                let Ok((output, _)) = CpuRasterizer.forward(drawn, &cameras[position], &SETTINGS);
                all.extend(output.image.data);
            });
            all
        };
        let whole = pictures(&[false; 5]);
        let mut means = [0.0; 5];
        for seed in 0..400 {
            let errors = removal_errors(gaussians, &[false; 5], &cameras, seed);
            means.iter_mut().zip(errors).for_each(|(mean, error)| *mean += f64::from(error) / 400.0);
        }
        for i in 0..3 {
            let mut without = [false; 5];
            without[i] = true;
            let change = |(a, b): (&f32, f32)| f64::from(a - b).powi(2);
            let expected: f64 = whole.iter().zip(pictures(&without)).map(change).sum();
            // The mean of 400 squares of about normal numbers is within 7 % in two of three cases.
            assert!((means[i] / expected - 1.0).abs() < 0.2, "Gaussian {i}: {}, expected {expected}", means[i]);
        }
        assert!(means[3] < 0.1 * means[1] && means[4] == 0.0, "{means:?}");
    }

    #[test]
    fn as_many_go_as_the_error_allows_and_those_in_no_image_stay() {
        let (parameters, views) = scene();
        let stay = |share, is_hidden: [bool; 5]| needed(&parameters, &is_hidden, &views, share, 3);
        // The last changes no picture, and is in none.
        assert_eq!(stay(1e-3, [false; 5]), [0, 1, 2, 4], "what others hide goes");
        assert_eq!(stay(1e6, [false; 5]), [0, 1, 2, 4], "of four in images at most one at once");
        assert_eq!(stay(-0.1, [false; 5]), [0, 1, 2, 3, 4], "the error cannot become less");
        assert_eq!(stay(0.0, [true, false, false, false, false]), [1, 2, 3, 4], "what a mask hides goes first");
    }
}
