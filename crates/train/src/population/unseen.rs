//! Points outside of all training images: no loss constrains them, but other cameras see them.

use rayon::prelude::*;
use tcgs_core::{
    Camera, Gaussians, Pinhole, PointCloud, dot, mean_vector, normalize, quat_mul, rotmat_from_unit_quat, sub,
};

use crate::parameters::MIN_SQUARED_DISTANCE;

/// Standard deviations at which a disc ends before an image. Three leave a dark rim.
const REACH: f32 = 2.0;

/// Thickness of a disc, as a share of its smaller radius.
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
/// into an image, where it would cover trained Gaussians. They shrink most towards the nearest image, and less along
/// its edge.
///
/// - `num_unseen`: how many these are, the last ones
pub(crate) fn keep_out(gaussians: &mut Gaussians, num_unseen: usize, cameras: &[Camera]) {
    let first = gaussians.num_gaussians() - num_unseen;
    let pinholes: Vec<Pinhole<f32>> = cameras.iter().map(Pinhole::new).collect();
    let middle = mean_vector(pinholes.iter().map(|pinhole| pinhole.center));
    let v = gaussians.views_mut();
    (&mut v.log_scales[first..], &mut v.quats[first..], &v.means[first..]).into_par_iter().for_each(
        |(log_scales, quat, &mean)| {
            let edges: Vec<(f32, [f32; 3])> = pinholes.iter().map(|pinhole| edge(pinhole, mean)).collect();
            let scales;
            (*quat, scales) = disc(facing(sub(middle, mean)), log_scales[0].exp(), &edges);
            *log_scales = scales.map(f32::ln);
        },
    );
}

/// The largest disc up to a radius that ends before images. It is as large across the nearest edge as this allows, and
/// then as large along it as all edges allow.
///
/// - `faces`: rotation whose third axis is the disc's
/// - `edges`: distance from an edge of each image, scene units, and the unit normal of the edge's plane
/// - returns: rotation, as a unit quaternion, and scales
fn disc(faces: [f32; 4], radius: f32, edges: &[(f32, [f32; 3])]) -> ([f32; 4], [f32; 3]) {
    let (nearest, normal) = edges.iter().fold((f32::INFINITY, [1.0, 0.0, 0.0]), |a, &b| if b.0 < a.0 { b } else { a });
    let [x, y, _] = axes_of(faces);
    let half_turn = 0.5 * dot(normal, y).atan2(dot(normal, x));
    let quat = quat_mul(faces, [half_turn.cos(), 0.0, 0.0, half_turn.sin()]);
    let axes = axes_of(quat);
    let across = radius.min((nearest / REACH).max(MIN_SQUARED_DISTANCE.sqrt()));
    // A disc ends at an edge if its standard deviation across it is the distance from it, divided by the reach.
    let along = edges.iter().map(|&(distance, normal)| {
        let [a, b, c] = axes.map(|axis| dot(axis, normal).powi(2));
        let rest = (distance / REACH).powi(2) - across * across * (a + FLATNESS * FLATNESS * c);
        (rest / b.max(1e-6)).max(0.0).sqrt()
    });
    let along = along.fold(radius, f32::min).max(across);
    (quat, [across, along, FLATNESS * across])
}

/// A rotation that turns the third axis towards a direction, as a unit quaternion.
fn facing(direction: [f32; 3]) -> [f32; 4] {
    let [x, y, z] = normalize(direction);
    // Half of the way from the axis to the direction. Opposite directions have no such way.
    if z > -0.999 { normalize([1.0 + z, -y, x, 0.0]) } else { [0.0, 1.0, 0.0, 0.0] }
}

/// The axes of a rotation, as unit vectors.
fn axes_of(unit_quat: [f32; 4]) -> [[f32; 3]; 3] {
    let rotation = rotmat_from_unit_quat(unit_quat);
    std::array::from_fn(|axis| rotation.map(|row| row[axis]))
}

/// The plane between a point and what a camera sees that is farthest from the point: through the camera and an edge of
/// the image, or across the camera's axis.
///
/// - returns: the distance from the plane, scene units, 0 or less inside; the plane's unit normal towards the point
fn edge(pinhole: &Pinhole<f32>, point: [f32; 3]) -> (f32, [f32; 3]) {
    let at = pinhole.camera_point(point);
    let ([fx, fy], [cx, cy]) = (pinhole.focal, pinhole.principal);
    let [right, bottom] = [pinhole.width as f32 - cx, pinhole.height as f32 - cy];
    let normals = [[-fx, 0.0, -cx], [fx, 0.0, -right], [0.0, -fy, -cy], [0.0, fy, -bottom], [0.0, 0.0, -1.0]];
    let planes = normals.map(normalize).map(|normal| (dot(normal, at), normal));
    let (distance, normal) = planes.into_iter().fold(planes[0], |a, b| if b.0 > a.0 { b } else { a });
    let of_world = |c: usize| (0..3).map(|row| pinhole.rotation[row][c] * normal[row]).sum();
    (distance, std::array::from_fn(of_world))
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
            let axis = axes_of(after.quats()[i])[2];
            let towards = normalize([-x, -y, -4.0 - z]);
            assert!(tcgs_core::distance(axis, towards) < 1e-5, "{i}: {axis:?} instead of {towards:?}");
            let [a, b, c] = after.log_scales()[i];
            assert!(a <= b && (c - a - FLATNESS.ln()).abs() < 1e-5, "{i}");
        }
    }

    #[test]
    fn a_disc_ends_before_all_images_and_is_longer_along_the_nearest_edge() {
        let camera = |x: f64| Camera::look_at([x, 0.5, -4.0], [0.3 * x, 0.0, 0.0], [0.0, -1.0, 0.0], 60.0, 64, 48);
        let cameras = [camera(-0.5), camera(0.5), camera(0.0)];
        let points: Vec<[f32; 3]> = (0..40)
            .map(|i| 0.157 * i as f32)
            .map(|angle| [2.9 * angle.cos() + 0.3, 2.7 * angle.sin(), 0.1 * angle.sin()])
            .filter(|&point| !are_in_images(&[point], &cameras)[0])
            .collect();
        let count = points.len();
        assert!(count > 20);
        let cloud = PointCloud { colors: points.clone(), points: points.clone(), foreground: vec![false; count] };
        let mut discs = Parameters::from_cloud(&cloud, 1, 0.0).gaussians;
        discs.log_scales_mut().fill([0.0; 3]);
        keep_out(&mut discs, count, &cameras);
        let pinholes = cameras.each_ref().map(Pinhole::<f32>::new);
        let mut num_long = 0;
        for ((&mean, &quat), log_scales) in points.iter().zip(discs.quats()).zip(discs.log_scales()) {
            let ([first, second, _], [across, along, _]) = (axes_of(quat), log_scales.map(f32::exp));
            for turn in 0..32 {
                let (sin, cos) = (turn as f32 / 32.0 * std::f32::consts::TAU).sin_cos();
                let scaled = [0.999 * REACH * across * cos, 0.999 * REACH * along * sin];
                let border: [f32; 3] = std::array::from_fn(|c| mean[c] + scaled[0] * first[c] + scaled[1] * second[c]);
                assert!(pinholes.iter().all(|pinhole| pinhole.pixel(border).is_none()), "{mean:?} reaches {border:?}");
            }
            num_long += usize::from(along > 2.0 * across);
        }
        assert!(2 * num_long > count, "{num_long} of {count}");
    }
}
