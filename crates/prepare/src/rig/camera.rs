//! A camera while its numbers are sought: lens and pose, its rays, the effect of a small change.

use tcgs_capture::{Crop, DescribedCamera, Lens};
use tcgs_core::{add_scaled, cross, dot, normalize, rotmat_from_vector};

/// Number of a camera's free parameters: rotation vector (3, radians, camera axes), translation (3, scene units, camera
/// axes), the logarithm of both focal lengths, and `k1`.
pub(super) const PARAMETERS: usize = 8;
/// Indices into a change of the parameters.
pub(super) const LOG_FOCAL: usize = 6;
pub(super) const K1: usize = 7;

/// A camera of a rig.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RigCamera {
    pub lens: Lens,
    /// `[3][4]` row-major, camera axes x right, y down, z forward.
    pub camera_from_world: [[f64; 4]; 3],
}

impl RigCamera {
    pub fn new(camera: &DescribedCamera) -> Self {
        let k: [f64; 8] = std::array::from_fn(|i| camera.distortion.get(i).copied().unwrap_or(0.0));
        let lens = Lens {
            width: camera.size[0],
            height: camera.size[1],
            focal: camera.focal,
            principal: camera.principal,
            radial: [k[0], k[1], k[4], k[5], k[6], k[7]],
            tangential: [k[2], k[3]],
            crop: Crop::default(),
        };
        Self { lens, camera_from_world: camera.camera_from_world }
    }

    /// Writes lens and pose into a description.
    pub fn put_into(&self, camera: &mut DescribedCamera) {
        let [k1, k2, k3, k4, k5, k6] = self.lens.radial;
        let [p1, p2] = self.lens.tangential;
        camera.focal = self.lens.focal;
        camera.principal = self.lens.principal;
        camera.distortion = vec![k1, k2, p1, p2, k3, k4, k5, k6];
        camera.camera_from_world = self.camera_from_world;
    }

    /// A point in camera axes.
    pub fn camera_point(&self, point: [f64; 3]) -> [f64; 3] {
        self.camera_from_world.map(|[a, b, c, t]| dot([a, b, c], point) + t)
    }

    /// Projection of a point, pixels of the distorted image; `None` behind the camera.
    pub fn project(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        let [x, y, z] = self.camera_point(point);
        if z <= 0.0 {
            return None;
        }
        let ([fx, fy], [cx, cy]) = (self.lens.focal, self.lens.principal);
        Some(self.lens.bend([fx * x / z + cx, fy * y / z + cy]))
    }

    /// Optical centre in the world.
    pub fn center(&self) -> [f64; 3] {
        let m = self.camera_from_world;
        std::array::from_fn(|i| -(0..3).map(|row| m[row][i] * m[row][3]).sum::<f64>())
    }

    /// Unit direction of view in the world.
    pub fn forward(&self) -> [f64; 3] {
        let [x, y, z, _] = self.camera_from_world[2];
        [x, y, z]
    }

    /// Unit direction in the world of a pixel of the distorted image.
    pub fn ray(&self, pixel: [f64; 2]) -> [f64; 3] {
        // Distortion is a small correction, so the fixed-point iteration converges within a few steps.
        let mut straight = pixel;
        for _ in 0..20 {
            let bent = self.lens.bend(straight);
            let error = [pixel[0] - bent[0], pixel[1] - bent[1]];
            straight = [straight[0] + error[0], straight[1] + error[1]];
            if error[0].abs() + error[1].abs() < 1e-6 {
                break;
            }
        }
        let ([fx, fy], [cx, cy]) = (self.lens.focal, self.lens.principal);
        let local = [(straight[0] - cx) / fx, (straight[1] - cy) / fy, 1.0];
        let m = self.camera_from_world;
        normalize(std::array::from_fn(|i| (0..3).map(|row| m[row][i] * local[row]).sum()))
    }

    /// The camera after a small change.
    pub fn moved(&self, change: &[f64; PARAMETERS]) -> Self {
        let mut moved = self.clone();
        let turn = rotmat_from_vector([change[0], change[1], change[2]]);
        for row in 0..3 {
            for column in 0..4 {
                moved.camera_from_world[row][column] =
                    (0..3).map(|k| turn[row][k] * self.camera_from_world[k][column]).sum();
            }
            moved.camera_from_world[row][3] += change[3 + row];
        }
        let factor = change[LOG_FOCAL].exp();
        moved.lens.focal = self.lens.focal.map(|f| f * factor);
        moved.lens.radial[0] += change[K1];
        moved
    }

    /// Makes the rotation orthonormal again after many small changes.
    pub fn straightened(mut self) -> Self {
        let m = self.camera_from_world.map(|[a, b, c, _]| [a, b, c]);
        let x = normalize(m[0]);
        let y = normalize(add_scaled(m[1], -dot(x, m[1]), x));
        let z = cross(x, y);
        for (row, axis) in [x, y, z].into_iter().enumerate() {
            self.camera_from_world[row][..3].copy_from_slice(&axis);
        }
        self
    }
}
