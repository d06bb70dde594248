//! The space around the training cameras and between them. Nothing stands there: it would hide the scene.

use rayon::prelude::*;
use tcgs_core::{Camera, Pinhole, cameras_between, distance};

/// Radius of the space around a camera, as a share of the distance from which on there are points. Likewise the depth
/// of the free part of what it sees.
const SHARE: f32 = 0.5;

/// Share of the initial points that may stand nearer to a camera than that distance, by mistake.
const OUTLIERS: f32 = 1e-3;

/// Number of cameras between the training cameras that have such a space, too.
const NUM_BETWEEN: usize = 64;

/// A ball around each training camera and around cameras between these, and the foremost part of what each sees.
/// Gaussians there would show in few training images, and hide the scene from other cameras.
#[derive(Clone, Debug, Default)]
pub(crate) struct FreeSpace {
    spaces: Vec<CameraSpace>,
}

/// The free space of one camera.
#[derive(Clone, Debug)]
struct CameraSpace {
    pinhole: Pinhole<f32>,
    /// Radius of the ball, scene units.
    radius: f32,
    /// Depth up to which the part of space that the camera sees is free, scene units.
    depth: f32,
}

impl FreeSpace {
    /// - `points`: the initial points, `[P, 3]`, at least one
    pub fn around(cameras: &[Camera], points: &[[f32; 3]]) -> Self {
        let cameras = [cameras, &cameras_between(cameras, 0..NUM_BETWEEN)].concat();
        let num_outliers = (OUTLIERS * points.len() as f32) as usize;
        // Distance from which on there are points; 0 if all may be mistakes.
        let nearest = |mut distances: Vec<f32>| {
            let has_more = distances.len() > num_outliers;
            if has_more { *distances.select_nth_unstable_by(num_outliers, f32::total_cmp).1 } else { 0.0 }
        };
        let space = |camera: &Camera| {
            let pinhole = Pinhole::<f32>::new(camera);
            let of_points = points.iter().map(|&point| distance(pinhole.center, point)).collect();
            let of_seen = points.iter().filter_map(|&point| Some(pinhole.pixel(point)?.1)).collect();
            let [radius, depth] = [of_points, of_seen].map(|distances| SHARE * nearest(distances));
            CameraSpace { pinhole, radius, depth }
        };
        Self { spaces: cameras.par_iter().map(space).collect() }
    }

    /// Whether each point is in the space around a camera.
    ///
    /// - `points`: `[P, 3]`, scene units
    /// - returns: `[P]`
    pub fn holds(&self, points: &[[f32; 3]]) -> Vec<bool> {
        points.par_iter().map(|&point| self.spaces.iter().any(|space| space.holds(point))).collect()
    }
}

impl CameraSpace {
    fn holds(&self, point: [f32; 3]) -> bool {
        let is_before = || self.pinhole.pixel(point).is_some_and(|(_, depth)| depth < self.depth);
        distance(self.pinhole.center, point) < self.radius || is_before()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_space_around_a_camera_reaches_half_way_to_the_points() {
        let camera = |x| Camera::look_at([x, 0.0, -4.0], [x, 0.0, 0.0], [0.0, -1.0, 0.0], 60.0, 64, 48);
        let wall = |i: usize| [0.01 * (i % 50) as f32, 0.01 * (i / 50) as f32, 0.0];
        let mut points: Vec<[f32; 3]> = (0..2000).map(wall).collect();
        // By mistake.
        points.extend([[0.0, 0.0, -3.5]; 2]);
        let space = FreeSpace::around(&[camera(0.0), camera(10.0)], &points);
        let places = [
            [0.0, 0.0, -3.5],
            [1.0, 0.0, -4.0],
            [0.0, 0.0, -2.1],
            [0.0, 0.0, -1.9],
            [10.0, 3.0, -4.0],
            [3.0, 0.0, -4.0],
        ];
        assert_eq!(space.holds(&places), [true, true, true, false, true, true], "the last is between the cameras");
        assert_eq!(FreeSpace::default().holds(&places), [false; 6]);
    }

    #[test]
    fn a_wall_behind_a_camera_does_not_fill_the_space_before_it() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 60.0, 64, 48);
        let wall = |z: f32| (0..1000).map(move |i| [0.01 * (i % 50) as f32, 0.01 * (i / 50) as f32, z]);
        let points: Vec<[f32; 3]> = wall(0.0).chain(wall(-4.2)).collect();
        let space = FreeSpace::around(&[camera], &points);
        let places = [[0.0, 0.0, -3.95], [0.0, 0.0, -4.05], [0.0, 0.0, -2.1], [0.0, 0.0, -1.9], [3.0, 0.0, -3.0]];
        assert_eq!(space.holds(&places), [true, true, true, false, false], "the last is beside the image");
    }
}
