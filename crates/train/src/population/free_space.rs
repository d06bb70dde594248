//! The space around the training cameras and between them. Nothing stands there: it would hide the scene.

use rayon::prelude::*;
use tcgs_core::{Camera, Pinhole, cameras_between, distance};

/// Radius of the space around a camera, as a share of the distance from which on there are points.
const SHARE: f32 = 0.5;

/// Share of the initial points that may stand nearer to a camera than that distance, by mistake.
const OUTLIERS: f32 = 1e-3;

/// Number of cameras between the training cameras that have such a space, too.
const NUM_BETWEEN: usize = 64;

/// A ball around each training camera, and around cameras between these. Gaussians in it would show in few training
/// images, and hide the scene from other cameras.
#[derive(Clone, Debug, Default)]
pub(crate) struct FreeSpace {
    /// Centres and radii, scene units.
    balls: Vec<([f32; 3], f32)>,
}

impl FreeSpace {
    /// - `points`: the initial points, `[P, 3]`, at least one
    pub fn around(cameras: &[Camera], points: &[[f32; 3]]) -> Self {
        let cameras = [cameras, &cameras_between(cameras, 0..NUM_BETWEEN)].concat();
        let num_outliers = (OUTLIERS * points.len() as f32) as usize;
        let ball = |camera: &Camera| {
            let center = Pinhole::<f32>::new(camera).center;
            let mut distances: Vec<f32> = points.iter().map(|&point| distance(center, point)).collect();
            let (_, nearest, _) = distances.select_nth_unstable_by(num_outliers, f32::total_cmp);
            (center, SHARE * *nearest)
        };
        Self { balls: cameras.par_iter().map(ball).collect() }
    }

    /// Whether each point is in the space around a camera.
    ///
    /// - `points`: `[P, 3]`, scene units
    /// - returns: `[P]`
    pub fn holds(&self, points: &[[f32; 3]]) -> Vec<bool> {
        let is_held = |&point: &[f32; 3]| self.balls.iter().any(|&(center, radius)| distance(center, point) < radius);
        points.par_iter().map(is_held).collect()
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
}
