//! Cameras that a file brings along, as views to start from: application data, as `docs/FORMAT.md` says.

use serde::Deserialize;
use tcgs_core::{Camera, normalize, rotmat_from_quat};

/// Name of the data.
pub const VIEWS: &str = "tcgs.views";

/// A camera of the capture that the scene was made of.
#[derive(Clone, Debug, PartialEq)]
pub struct FileCamera {
    /// Its name in the capture.
    pub name: String,
    /// Where it stood and what it saw.
    pub camera: Camera,
}

#[derive(Deserialize)]
struct Views {
    views: Vec<View>,
}

#[derive(Deserialize)]
struct View {
    name: String,
    width: usize,
    height: usize,
    focal: [f64; 2],
    principal: [f64; 2],
    position: [f64; 3],
    /// World from camera, `w, x, y, z`.
    rotation: [f64; 4],
}

/// The cameras among the data of applications. Views are a courtesy: what cannot be read is left out.
///
/// - `data`: names and bytes
pub fn read_cameras(data: &[(String, Vec<u8>)]) -> Vec<FileCamera> {
    let of_views = data.iter().filter(|(name, _)| name == VIEWS);
    let parsed = of_views.filter_map(|(_, bytes)| serde_json::from_slice::<Views>(bytes).ok());
    parsed.flat_map(|views| views.views).filter_map(View::camera).collect()
}

impl View {
    fn camera(self) -> Option<FileCamera> {
        let world_from_camera = rotmat_from_quat(normalize(self.rotation));
        let row = |i: usize| {
            let axis = [0, 1, 2].map(|j| world_from_camera[j][i]);
            let along: f64 = (0..3).map(|j| axis[j] * self.position[j]).sum();
            [axis[0], axis[1], axis[2], -along]
        };
        let rows = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
        let ([fx, fy], [cx, cy]) = (self.focal, self.principal);
        let intrinsics = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
        let camera = Camera::new(self.width, self.height, intrinsics, rows).ok()?;
        Some(FileCamera { name: self.name, camera })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(json: &str) -> Vec<FileCamera> {
        read_cameras(&[("other".into(), b"{}".to_vec()), (VIEWS.into(), json.as_bytes().to_vec())])
    }

    #[test]
    fn views_become_cameras() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        // Turned by a right angle about y: the camera looks along x.
        let json = format!(
            r#"{{"views": [{{"name": "7", "width": 64, "height": 48, "focal": [50, 51], "principal": [32, 23.5],
                "position": [1, 2, 3], "rotation": [{half}, 0, {half}, 0], "more": []}}]}}"#
        );
        let cameras = read(&json);
        assert_eq!(cameras.len(), 1);
        let FileCamera { name, camera } = &cameras[0];
        assert_eq!(
            (name.as_str(), camera.width, camera.focal, camera.principal),
            ("7", 64, [50.0, 51.0], [32.0, 23.5])
        );
        for (found, expected) in camera.center().iter().zip([1.0, 2.0, 3.0]) {
            assert!((found - expected).abs() < 1e-12);
        }
        for (found, expected) in camera.forward().iter().zip([1.0, 0.0, 0.0]) {
            assert!((found - expected).abs() < 1e-12, "{:?}", camera.forward());
        }
    }

    #[test]
    fn what_is_no_view_is_left_out() {
        assert!(read("no json").is_empty());
        assert!(read(r#"{"views": [{"name": 7}]}"#).is_empty());
        let zero = r#"{"views": [{"name": "a", "width": 0, "height": 1, "focal": [1, 1], "principal": [0, 0],
            "position": [0, 0, 0], "rotation": [0, 0, 0, 0]}]}"#;
        assert!(read(zero).is_empty());
        assert!(read_cameras(&[]).is_empty());
    }
}
