//! Points outside of all training images: no loss constrains them, but other cameras see them.

use rayon::prelude::*;
use tcgs_core::{Camera, Gaussians, Pinhole, PointCloud, normalize, sub};

use crate::parameters::MIN_SQUARED_DISTANCE;

/// Standard deviations at which a disc ends before an image. Three leave a dark rim.
const REACH: f32 = 2.0;

/// Thickness of a disc, as a share of its radius.
const FLATNESS: f32 = 0.1;

/// Whether each point is in the image of a camera, hidden or not.
///
/// - `points`: `[P, 3]`, scene units
/// - returns: `[P]`
pub fn are_in_images(points: &[[f32; 3]], cameras: &[Camera]) -> Vec<bool> {
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(Pinhole::new).collect();
    points.par_iter().map(|&point| pinholes.iter().any(|pinhole| pinhole.pixel(point).is_some())).collect()
}

/// Moves the points that are in no image to the end.
///
/// - `cameras`: cameras of the images
/// - returns: the points, and how many of them are in no image
pub(super) fn unseen_last(cloud: &PointCloud, cameras: &[Camera]) -> (PointCloud, usize) {
    let is_seen = are_in_images(&cloud.points, cameras);
    let (mut order, unseen): (Vec<usize>, Vec<usize>) = (0..is_seen.len()).partition(|&i| is_seen[i]);
    let num_unseen = unseen.len();
    order.extend(unseen);
    let ordered = PointCloud {
        points: order.iter().map(|&i| cloud.points[i]).collect(),
        colors: order.iter().map(|&i| cloud.colors[i]).collect(),
        foreground: order.iter().map(|&i| cloud.foreground[i]).collect(),
    };
    (ordered, num_unseen)
}

/// Makes discs of the Gaussians that are in no image, which face the middle of the cameras. They close the shell around
/// the scene: balls would reach into the room, and veil cameras close to its walls. The discs shrink until none reaches
/// into an image, where it would cover trained Gaussians.
///
/// - `num_unseen`: how many these are, the last ones
pub(crate) fn keep_out(gaussians: &mut Gaussians, num_unseen: usize, cameras: &[Camera]) {
    let first = gaussians.num_gaussians() - num_unseen;
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(Pinhole::new).collect();
    let sum = pinholes.iter().fold([0.0; 3], |sum: [f32; 3], at| std::array::from_fn(|c| sum[c] + at.center[c]));
    let middle = sum.map(|x| x / cameras.len() as f32);
    let v = gaussians.views_mut();
    (&mut v.log_scales[first..], &mut v.quats[first..], &v.means[first..]).into_par_iter().for_each(
        |(log_scales, quat, &mean)| {
            let limit = pinholes.iter().map(|pinhole| outside_by(pinhole, mean)).fold(f32::INFINITY, f32::min);
            let largest = (limit / REACH).max(MIN_SQUARED_DISTANCE.sqrt()).ln();
            *log_scales = log_scales.map(|log_scale| log_scale.min(largest));
            log_scales[2] += FLATNESS.ln();
            *quat = facing(sub(middle, mean));
        },
    );
}

/// A rotation that turns the third axis towards a direction, as a unit quaternion.
fn facing(direction: [f32; 3]) -> [f32; 4] {
    let [x, y, z] = normalize(direction);
    // Half of the way from the axis to the direction. Opposite directions have no such way.
    if z > -0.999 { normalize([1.0 + z, -y, x, 0.0]) } else { [0.0, 1.0, 0.0, 0.0] }
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
    use crate::parameters::Parameters;

    #[test]
    fn what_is_hidden_is_in_the_image_and_what_is_outside_comes_last() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
        let points = vec![[0.0, 0.0, -5.0], [0.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 0.0, 5.0]];
        assert_eq!(are_in_images(&points, std::slice::from_ref(&camera)), [false, true, false, true]);
        let colors = points.clone();
        let (ordered, num_unseen) = unseen_last(&PointCloud { points, colors, foreground: vec![false; 4] }, &[camera]);
        assert_eq!((ordered.points.len(), num_unseen), (4, 2));
        assert_eq!(ordered.colors, [[0.0, 0.0, 0.0], [0.0, 0.0, 5.0], [0.0, 0.0, -5.0], [9.0, 0.0, 0.0]]);
    }

    #[test]
    fn what_is_in_no_image_does_not_reach_into_one() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
        // In the image; beside it, near and far; behind the camera.
        let points = vec![[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [9.0, 0.0, 0.0], [0.0, 0.0, -6.0]];
        let cloud = PointCloud { colors: points.clone(), points, foreground: vec![false; 4] };
        let before = Parameters::from_cloud(&cloud, 1, 0.0).gaussians;
        let mut after = before.clone();
        keep_out(&mut after, 3, std::slice::from_ref(&camera));
        let scales = |of: &Gaussians| -> Vec<f32> { of.log_scales().iter().map(|s| s[0].exp()).collect() };
        let (before, after) = (scales(&before), scales(&after));
        assert_eq!(after[0], before[0], "what is in the image stays as it is");
        assert!(after.iter().zip(&before).all(|(after, before)| after <= before));
        // The edge of the image is a plane through the camera.
        let edge = (32.0_f64 / 60.0).atan();
        for (i, from_camera) in [(1, [3.0_f64, 4.0]), (2, [9.0, 4.0])] {
            let distance = (from_camera[0].atan2(from_camera[1]) - edge).sin() * from_camera[0].hypot(from_camera[1]);
            let expected = (distance / f64::from(REACH)).min(f64::from(before[i]));
            assert!((f64::from(after[i]) - expected).abs() < 1e-4, "{i}: {} instead of {expected}", after[i]);
        }
        assert!((after[3] - before[3].min(2.0 / REACH)).abs() < 1e-4, "{}", after[3]);
    }

    #[test]
    fn what_is_in_no_image_is_a_disc_that_faces_the_cameras() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
        let points = vec![[0.0; 3], [9.0, 2.0, 0.0], [0.0, 0.0, -6.0], [0.1, 0.0, -9.0]];
        let cloud = PointCloud { colors: points.clone(), points: points.clone(), foreground: vec![false; 4] };
        let before = Parameters::from_cloud(&cloud, 1, 0.0).gaussians;
        let mut after = before.clone();
        keep_out(&mut after, 3, std::slice::from_ref(&camera));
        assert_eq!((after.quats()[0], after.log_scales()[0]), (before.quats()[0], before.log_scales()[0]));
        for (i, &[x, y, z]) in points.iter().enumerate().skip(1) {
            let axis = tcgs_core::rotmat_from_unit_quat(after.quats()[i]).map(|row| row[2]);
            let towards = normalize([-x, -y, -4.0 - z]);
            assert!(tcgs_core::distance(axis, towards) < 1e-5, "{i}: {axis:?} instead of {towards:?}");
            let [a, b, c] = after.log_scales()[i];
            assert!(a == b && (c - a - FLATNESS.ln()).abs() < 1e-5, "{i}");
        }
    }
}
