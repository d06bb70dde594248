//! Points outside of all training images: no loss constrains them, but other cameras see them.

use rayon::prelude::*;
use tcgs_core::{Camera, Pinhole, PointCloud};

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

#[cfg(test)]
mod tests {
    use super::*;

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
}
