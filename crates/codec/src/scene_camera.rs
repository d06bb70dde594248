//! Cameras that a file brings along.

use tcgs_core::{Camera, CameraError};

/// A camera of the capture that a scene was made of: a view to start from. With the precision of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SceneCamera {
    /// Its name in the capture, at most 65535 bytes.
    pub name: String,
    /// Width and height of its pictures, pixels.
    pub size: [u32; 2],
    /// `fx, fy`, pixels.
    pub focal: [f32; 2],
    /// `cx, cy`, pixels.
    pub principal: [f32; 2],
    /// `[3][4]` row-major: the rigid transform without its last row.
    pub camera_from_world: [[f32; 4]; 3],
}

impl SceneCamera {
    /// A camera under a name.
    pub fn new(name: String, camera: &Camera) -> Self {
        Self {
            name,
            size: [camera.width as u32, camera.height as u32],
            focal: camera.focal.map(|x| x as f32),
            principal: camera.principal.map(|x| x as f32),
            camera_from_world: std::array::from_fn(|row| camera.camera_from_world[row].map(|x| x as f32)),
        }
    }

    /// As others take it.
    ///
    /// # Errors
    /// [`CameraError`] if the numbers make no camera.
    pub fn camera(&self) -> Result<Camera, CameraError> {
        let [[fx, fy], [cx, cy]] = [self.focal, self.principal].map(|pair| pair.map(f64::from));
        let [x, y, z] = self.camera_from_world.map(|row| row.map(f64::from));
        let intrinsics = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
        Camera::new(self.size[0] as usize, self.size[1] as usize, intrinsics, [x, y, z, [0.0, 0.0, 0.0, 1.0]])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_comes_back() {
        let camera = Camera::look_at([1.0, -2.0, 3.0], [0.2, 0.1, -0.5], [0.0, -1.0, 0.0], 60.0, 64, 48);
        let back = SceneCamera::new("a".into(), &camera).camera().unwrap();
        assert_eq!((back.width, back.height, back.focal, back.principal), (64, 48, [60.0; 2], [32.0, 24.0]));
        for (a, b) in back.camera_from_world.as_flattened().iter().zip(camera.camera_from_world.as_flattened()) {
            assert!((a - b).abs() < 1e-6);
        }
        let mut broken = SceneCamera::new("b".into(), &camera);
        broken.camera_from_world[0][0] = f32::NAN;
        assert!(broken.camera().is_err());
    }
}
