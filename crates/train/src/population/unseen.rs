//! Points outside of all training images: no loss constrains them, but other cameras see them.

use rayon::prelude::*;
use tcgs_core::{Camera, Pinhole};

use crate::parameters::Parameters;

/// Standard deviations within which a Gaussian covers anything.
const REACH: f32 = 3.0;

/// Whether each point is in the image of a camera, hidden or not.
///
/// - `points`: `[P, 3]`, scene units
/// - returns: `[P]`
pub fn are_in_images(points: &[[f32; 3]], cameras: &[Camera]) -> Vec<bool> {
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(Pinhole::new).collect();
    points.par_iter().map(|&point| pinholes.iter().any(|pinhole| pinhole.pixel(point).is_some())).collect()
}

/// Moves the Gaussians that reach into no image to the end.
///
/// - `cameras`: cameras of the images
/// - returns: how many of them reach into no image
pub(super) fn unseen_last(parameters: &mut Parameters, cameras: &[Camera]) -> usize {
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(Pinhole::new).collect();
    let Parameters { gaussians, .. } = &*parameters;
    let reaches_in: Vec<bool> = (gaussians.means().par_iter(), gaussians.log_scales())
        .into_par_iter()
        .map(|(&mean, log_scales)| {
            let reach = REACH * log_scales.iter().copied().fold(f32::NEG_INFINITY, f32::max).exp();
            pinholes.iter().any(|pinhole| outside_by(pinhole, mean) < reach)
        })
        .collect();
    let (mut order, unseen): (Vec<usize>, Vec<usize>) = (0..reaches_in.len()).partition(|&i| reaches_in[i]);
    order.extend(&unseen);
    *parameters = parameters.select(&order);
    unseen.len()
}

/// A lower bound of the distance between a point and what a camera sees, scene units; 0 or less inside.
fn outside_by(pinhole: &Pinhole<f32>, point: [f32; 3]) -> f32 {
    let [x, y, z] = pinhole.camera_point(point);
    let size = [pinhole.width as f32, pinhole.height as f32];
    // Distances from the planes through the camera and an edge of the image.
    let beyond = |i: usize, at: f32| {
        let (focal, low, high) = (pinhole.focal[i], pinhole.principal[i], size[i] - pinhole.principal[i]);
        (-(at * focal + z * low) / focal.hypot(low)).max((at * focal - z * high) / focal.hypot(high))
    };
    beyond(0, x).max(beyond(1, y)).max(-z)
}

#[cfg(test)]
mod tests {
    use tcgs_core::PointCloud;

    use super::*;

    #[test]
    fn what_is_hidden_is_in_the_image() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
        let points = [[0.0, 0.0, -5.0], [0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 0.0, 5.0]];
        assert_eq!(are_in_images(&points, &[camera]), [false, true, false, true]);
    }

    #[test]
    fn what_reaches_into_no_image_goes_to_the_end() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
        // Beside the image; behind the camera; in the image; just outside of it; behind the camera, but very large.
        let points = vec![[9.0, 0.0, 0.0], [0.0, 0.0, -5.0], [0.0; 3], [2.2, 0.0, 0.0], [0.0, 0.0, -7.0]];
        let cloud = PointCloud { colors: points.clone(), points, foreground: vec![false; 5] };
        let mut parameters = Parameters::from_cloud(&cloud, 1, 0.0);
        let scales = [0.3_f32, 0.3, 0.3, 0.3, 1.1].map(|scale| [scale.ln(); 3]);
        parameters.gaussians.log_scales_mut().copy_from_slice(&scales);
        let num_unseen = unseen_last(&mut parameters, std::slice::from_ref(&camera));
        let means = [[0.0; 3], [2.2, 0.0, 0.0], [0.0, 0.0, -7.0], [9.0, 0.0, 0.0], [0.0, 0.0, -5.0]];
        assert_eq!((parameters.gaussians.means(), num_unseen), (&means[..], 2));
        assert_eq!(parameters.gaussians.colors(), means, "in the same order");
        // The edge of the image is a plane through the camera: this one comes within three standard deviations of it.
        let edge = (32.0_f64 / 60.0).atan();
        let beside = (2.2_f64.atan2(4.0) - edge).sin() * 2.2_f64.hypot(4.0);
        assert!(beside > 0.0 && (f64::from(outside_by(&Pinhole::new(&camera), means[1])) - beside).abs() < 1e-5);
    }
}
