//! Pruning by a measured error: removes Gaussians that the training images hardly need.
//!
//! The order of removal comes from an estimate for each Gaussian. The number comes from pictures drawn without the
//! removed ones. Estimates alone do not give it, because neighbours that are removed together cost more than the sum of
//! both.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tcgs_core::{
    Activated, Camera, Gaussians, Image, Pinhole, View, activate, cameras_around, seen_colors, squared_distance,
};
use tcgs_metrics::psnr;
use tcgs_render::settings::MAX_CHANNELS;
use tcgs_render::{CpuRasterizer, CpuTiles, Rasterizer, RenderSettings};

use super::unseen::are_in_images;
use crate::parameters::corrected;

/// Bisection ends when the number of Gaussians to remove is known within `1 / PRECISION` of all.
const PRECISION: usize = 128;

/// Views that judge how many may go, at most: more cost time, since each is drawn several times.
const MOST_JUDGES: usize = 32;

/// Pictures from around the cameras, of all timesteps together.
const NUM_AROUND: usize = 128;

/// Shorter side of the pictures that tell what shows, pixels, at least; below twice as much.
const SMALL: usize = 90;

/// How many times as much of a Gaussian a picture from around has to show as any training image, so that it stays.
const FROM_AROUND: f32 = 4.0;

/// Without the statistic of densification.
const SETTINGS: RenderSettings =
    RenderSettings { background: None, statistic_channels: 0, learned_channels: MAX_CHANNELS };

/// Gaussians at one timestep, and the images that they should match.
#[derive(Clone, Copy, Debug)]
pub struct TimestepViews<'a> {
    /// As they are at the timestep.
    pub gaussians: &'a Gaussians,
    /// `[N]` whether a Gaussian is not drawn: it is masked out, or not alive.
    pub is_hidden: &'a [bool],
    /// Training views.
    pub views: &'a [View],
    /// `[views]` gain, as its logarithm, and offset of each view's camera, by channel.
    pub corrections: &'a [[[f32; 3]; 2]],
}

/// Which Gaussians are removed.
#[derive(Clone, Copy, Debug)]
pub struct Removal<'a> {
    /// By how much the mean squared error of all views may grow, as a share of it.
    pub share: f32,
    /// Largest share of the Gaussians that is removed.
    pub most: f32,
    /// `[N]` what each Gaussian costs: the one with the least error for its cost goes first. None: all cost the same.
    pub costs: Option<&'a [f32]>,
    /// Seed of the random signs.
    pub seed: u64,
}

/// Gaussians that stay after a removal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Needed {
    /// Indices, ascending.
    pub rows: Vec<usize>,
    /// Gaussians among them that cameras around the training cameras show, and training images hardly. No image tells
    /// their opacities. Indices, ascending.
    pub around: Vec<usize>,
}

/// Gaussians that stay when as many are removed as the images allow.
///
/// A Gaussian outside of all images stays, because no image tells whether it is needed. So does one that only cameras
/// around the training cameras show, such as a piece of the wall behind a person.
///
/// - `timesteps`: with the same Gaussians, at least one
pub fn needed(timesteps: &[TimestepViews<'_>], removal: &Removal<'_>) -> Needed {
    let mut errors = vec![0.0; timesteps[0].gaussians.num_gaussians()];
    // Largest visible sizes in training images, and in pictures from around.
    let mut largest = [errors.clone(), errors.clone()];
    let mut is_in_images = vec![false; errors.len()];
    let num_around = NUM_AROUND.div_ceil(timesteps.len());
    for (i, timestep) in timesteps.iter().enumerate() {
        let cameras: Vec<Camera> = timestep.views.iter().map(|view| view.camera.clone()).collect();
        let of_timestep = removal_errors(timestep.gaussians, timestep.is_hidden, &cameras, removal.seed + i as u64);
        errors.iter_mut().zip(of_timestep).for_each(|(sum, error)| *sum += error);
        let are_in = are_in_images(timestep.gaussians.means(), &cameras);
        is_in_images.iter_mut().zip(are_in).for_each(|(is_in_images, is_in)| *is_in_images |= is_in);
        let around = cameras_around(&cameras, i * num_around..(i + 1) * num_around);
        for (largest, cameras) in largest.iter_mut().zip([cameras, around]) {
            raise_to_sizes(largest, timestep, &cameras);
        }
    }
    let [of_images, of_around] = largest;
    let is_around = |i: usize| of_around[i] > FROM_AROUND * of_images[i];
    let may_go = |&i: &usize| is_in_images[i] && !is_around(i);
    let mut order: Vec<usize> = (0..errors.len()).filter(may_go).collect();
    if let Some(costs) = removal.costs {
        errors.iter_mut().zip(costs).for_each(|(error, cost)| *error /= cost);
    }
    order.sort_by(|&a, &b| errors[a].total_cmp(&errors[b]));
    let stride = judge_stride(timesteps.iter().map(|timestep| timestep.views.len()).sum());
    let error_without =
        |removed: &[usize]| -> f64 { timesteps.iter().map(|timestep| timestep.error_without(removed, stride)).sum() };
    let most = f64::from(1.0 + removal.share) * error_without(&[]);
    // All of `low` may go, and not all of `high`.
    let (mut low, mut high) = (0, (order.len() as f32 * removal.most) as usize + 1);
    while high - low > 1 + errors.len() / PRECISION {
        let middle = low.midpoint(high);
        if error_without(&order[..middle]) <= most { low = middle } else { high = middle }
    }
    let mut keeps = vec![true; errors.len()];
    order[..low].iter().for_each(|&i| keeps[i] = false);
    Needed {
        rows: (0..keeps.len()).filter(|&i| keeps[i]).collect(),
        around: (0..keeps.len()).filter(|&i| is_around(i)).collect(),
    }
}

/// Raises the largest visible size of each Gaussian to what these cameras see of it: its share of a picture times its
/// squared distance. So a Gaussian close to a camera does not seem hidden from all others.
fn raise_to_sizes(largest: &mut [f32], timestep: &TimestepViews<'_>, cameras: &[Camera]) {
    let small = |camera: &Camera| camera.downscaled((camera.width.min(camera.height) / SMALL).max(1));
    let cameras: Vec<Camera> = cameras.iter().map(small).collect();
    draw_all(timestep.gaussians, timestep.is_hidden, &cameras, |position, drawn| {
        let camera = &cameras[position];
        let equal = Image::filled(camera.width, camera.height, 1, 1.0 / (camera.width * camera.height) as f32);
        let shares = CpuTiles::new(drawn, camera).weights(&equal);
        let center = Pinhole::<f32>::new(camera).center;
        for ((largest, share), &mean) in largest.iter_mut().zip(shares).zip(&drawn.means) {
            *largest = largest.max(share * squared_distance(mean, center));
        }
    });
}

/// Of so many views every how-many-th judges, for [`TimestepViews::error_without`].
pub fn judge_stride(num_views: usize) -> usize {
    num_views.div_ceil(MOST_JUDGES).max(1)
}

impl TimestepViews<'_> {
    /// Mean squared errors of every `stride`th view, summed.
    ///
    /// - `removed`: indices of Gaussians that are not drawn either
    pub fn error_without(&self, removed: &[usize], stride: usize) -> f64 {
        let mut is_hidden = self.is_hidden.to_vec();
        removed.iter().for_each(|&i| is_hidden[i] = true);
        let judges: Vec<usize> = (0..self.views.len()).step_by(stride).collect();
        let cameras: Vec<Camera> = judges.iter().map(|&judge| self.views[judge].camera.clone()).collect();
        let mut sum = 0.0;
        draw_all(self.gaussians, &is_hidden, &cameras, |position, drawn| {
            let judge = judges[position];
            let Ok((output, _)) = CpuRasterizer.forward(drawn, &cameras[position], &SETTINGS);
            let picture = corrected(output.image, self.corrections[judge]);
            sum += 10.0_f64.powf(-0.1 * psnr(&picture, &self.views[judge].image));
        });
        sum
    }
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
/// A pixel is affine in the opacity of each Gaussian, so a removal changes it by opacity times derivative. Hutchinson
/// (1989): the sum of squares of these changes is the expected square of their sum with random signs. One backward pass
/// with random signs as `∂L/∂image` gives one sample for every Gaussian.
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
    fn scene() -> (Gaussians, Vec<View>) {
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
        (gaussians, views.into())
    }

    #[test]
    fn the_mean_over_random_signs_is_what_a_removal_changes() {
        let (gaussians, views) = scene();
        let gaussians = &gaussians;
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
        let (gaussians, views) = scene();
        let stay_by = |share, is_hidden: [bool; 5], costs: Option<&[f32]>| {
            let timestep = TimestepViews {
                gaussians: &gaussians,
                is_hidden: &is_hidden,
                views: &views,
                corrections: &[[[0.0; 3]; 2]; 2],
            };
            needed(&[timestep], &Removal { share, most: 0.4, costs, seed: 3 }).rows
        };
        let stay = |share, is_hidden| stay_by(share, is_hidden, None);
        // The last changes no picture, and is in none.
        assert_eq!(stay(1e-3, [false; 5]), [0, 1, 2, 4], "what others hide goes");
        assert_eq!(stay(1e6, [false; 5]), [0, 1, 2, 4], "of four in images at most one at once");
        assert_eq!(stay(-0.1, [false; 5]), [0, 1, 2, 3, 4], "the error cannot become less");
        assert_eq!(stay(0.0, [true, false, false, false, false]), [1, 2, 3, 4], "what a mask hides goes first");
        let costs = [1.0, 1e9, 1.0, 1e-9, 1.0];
        assert_eq!(stay_by(1e6, [false; 5], Some(&costs)), [0, 2, 3, 4], "what costs most for its error goes first");
    }

    #[test]
    fn what_is_hidden_from_the_training_cameras_alone_stays() {
        let behind = |third| BaseColumns {
            means: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], third, [1.0, 0.8, 0.5]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 4],
            log_scales: vec![[-0.7; 3], [-0.7; 3], [-2.5; 3], [-2.5; 3]],
            logit_opacities: vec![9.0, 9.0, 3.0, 3.0],
            colors: vec![[0.9, 0.3, 0.2], [0.2, 0.5, 0.9], [0.9, 0.8, 0.3], [0.1, 0.9, 0.1]],
        };
        let stay = |gaussians: &Gaussians| {
            let views = [-2.0, 2.0].map(|x| {
                let camera = Camera::look_at([x, 0.0, -4.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], 60.0, 72, 54);
                let Ok((drawn, _)) = CpuRasterizer.forward(&activate(gaussians), &camera, &SETTINGS);
                View { camera, image: drawn.image, segmentation: None, frame: 0, camera_id: usize::from(x > 0.0) }
            });
            let corrections = &[[[0.0; 3]; 2]; 2];
            let timestep = TimestepViews { gaussians, is_hidden: &[false; 4], views: &views, corrections };
            let needed = needed(&[timestep], &Removal { share: 1e9, most: 0.4, costs: None, seed: 3 });
            (needed.rows, needed.around)
        };
        // Each camera has one of the first two before the third. From half-way it shows between them.
        assert_eq!(
            stay(&behind([0.0, 0.0, 4.0]).into()),
            (vec![0, 1, 2], vec![2]),
            "the fourth is in the images, and the only one that may go"
        );
        // Here the second hides it from everywhere.
        assert_eq!(stay(&behind([1.0, 0.0, 0.5]).into()), (vec![0, 1, 3], vec![]));
    }

    #[test]
    fn what_is_close_to_a_camera_between_is_not_taken_for_hidden() {
        // One camera before the other, so that those between come close to the first Gaussian. Nothing hides it.
        let gaussians = Gaussians::from(BaseColumns {
            means: vec![[0.25, 0.0, -1.6], [0.0, 0.0, 5.0]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 2],
            log_scales: vec![[-2.5; 3], [-0.7; 3]],
            logit_opacities: vec![3.0, 9.0],
            colors: vec![[0.9, 0.8, 0.3], [0.2, 0.5, 0.9]],
        });
        let views = [[0.0, 0.0, -4.0], [0.5, 0.0, 0.0]].map(|center: [f64; 3]| {
            let target = [center[0], 0.0, 9.0];
            let camera = Camera::look_at(center, target, [0.0, -1.0, 0.0], 60.0, 72, 54);
            let Ok((drawn, _)) = CpuRasterizer.forward(&activate(&gaussians), &camera, &SETTINGS);
            View { camera, image: drawn.image, segmentation: None, frame: 0, camera_id: usize::from(center[2] > -1.0) }
        });
        let corrections = &[[[0.0; 3]; 2]; 2];
        let timestep = TimestepViews { gaussians: &gaussians, is_hidden: &[false; 2], views: &views, corrections };
        let needed = needed(&[timestep], &Removal { share: 1e9, most: 0.5, costs: None, seed: 3 });
        assert_eq!((needed.rows, needed.around), (vec![1], vec![]));
    }
}
