//! Removing Gaussians that the training images hardly need: pruning by a measured error.
//!
//! Who goes first is estimated, Gaussian by Gaussian; how many go is measured with pictures drawn without them, since errors
//! of removed neighbours add up to more than their sum.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use tcgs_core::{Activated, Camera, Image, View, activate, seen_colors};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};

use crate::parameters::Parameters;
use crate::unseen::are_in_images;

/// The number of Gaussians to remove is found up to this share of all.
const PRECISION: usize = 128;

/// Which Gaussians stay when as many are removed as the training images allow.
///
/// Those that are in no image stay: no image tells whether they are needed.
///
/// - `is_drawn`: `[N]` whether a Gaussian is drawn now
/// - `views`: the training views, in the order of the cameras' gains and offsets
/// - `share`: by how much the mean squared error of all views may grow, as a share of it
/// - returns: indices, ascending
pub(crate) fn needed(parameters: &Parameters, is_drawn: &[bool], views: &[View], share: f32, seed: u64) -> Vec<usize> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera.clone()).collect();
    let drawn: Vec<Activated> = cameras.iter().map(|camera| seen_by(parameters, is_drawn, camera)).collect();
    let errors = removal_errors(&drawn, &cameras, seed);
    let is_shown = are_in_images(parameters.gaussians.means(), &cameras);
    let mut order: Vec<usize> = (0..errors.len()).filter(|&i| is_shown[i]).collect();
    order.sort_by(|&a, &b| errors[a].total_cmp(&errors[b]));
    let error_without = |removed: &[usize]| -> f64 {
        let errors = drawn.iter().zip(views).enumerate().map(|(position, (drawn, view))| {
            let mut left = drawn.clone();
            removed.iter().for_each(|&i| left.opacities[i] = 0.0);
            let Ok((output, _)) = CpuRasterizer.forward(&left, &view.camera, &RenderSettings::default());
            let picture = parameters.seen_by_camera(position, output.image);
            squared_error(&picture, &view.image)
        });
        errors.sum()
    };
    let most = error_without(&[]) * f64::from(1.0 + share);
    // All of `low` may go, and not all of `high`.
    let (mut low, mut high) = (0, order.len());
    while high - low > 1 + errors.len() / PRECISION {
        let middle = low.midpoint(high);
        if error_without(&order[..middle]) <= most { low = middle } else { high = middle }
    }
    let mut keeps = vec![true; errors.len()];
    order[..low].iter().for_each(|&i| keeps[i] = false);
    (0..keeps.len()).filter(|&i| keeps[i]).collect()
}

/// The Gaussians as a camera sees them.
fn seen_by(parameters: &Parameters, is_drawn: &[bool], camera: &Camera) -> Activated {
    let gaussians = &parameters.gaussians;
    let mut activated = activate(gaussians);
    if gaussians.layout().sh_degree() > 0 {
        activated.colors = seen_colors(gaussians, camera);
    }
    let drawn = activated.opacities.iter_mut().zip(is_drawn);
    drawn.filter(|(_, is_drawn)| !**is_drawn).for_each(|(opacity, _)| *opacity = 0.0);
    activated
}

/// How much the pictures change when one Gaussian is removed: an estimate of the sum of squared changes of all colour
/// values of all pictures.
///
/// A pixel is affine in the opacity of each Gaussian, so that a removal changes it by opacity times derivative. The sum of
/// these squares is the mean, over random signs of all colour values, of the square of the signed sum (Hutchinson 1989): one
/// backward pass a picture is one sample of every Gaussian at once.
///
/// - `drawn`: of each camera
/// - returns: `[N]`
fn removal_errors(drawn: &[Activated], cameras: &[Camera], seed: u64) -> Vec<f32> {
    let settings = RenderSettings { statistic_channels: 0, ..RenderSettings::default() };
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut errors = vec![0.0; drawn.first().map_or(0, Activated::num_gaussians)];
    for (drawn, camera) in drawn.iter().zip(cameras) {
        let Ok((_, saved)) = CpuRasterizer.forward(drawn, camera, &settings);
        let mut signs = Image::filled(camera.width, camera.height, 3, 1.0);
        signs.data.iter_mut().filter(|_| random.random()).for_each(|sign| *sign = -1.0);
        let Ok(grads) = CpuRasterizer.backward(drawn, camera, &settings, &saved, &signs);
        errors.par_iter_mut().zip(&drawn.opacities).zip(&grads.activated.v_opacities).for_each(
            |((error, opacity), v_opacity): ((&mut f32, &f32), &f32)| *error += (opacity * v_opacity).powi(2),
        );
    }
    errors
}

fn squared_error(a: &Image, b: &Image) -> f64 {
    let squares = a.data.par_iter().zip(&b.data).map(|(a, b)| f64::from((a.clamp(0.0, 1.0) - b).powi(2)));
    // In parts, so that the sum is the same with any number of threads.
    squares.collect::<Vec<_>>().chunks(1 << 12).map(|part| part.iter().sum::<f64>()).sum()
}
