//! Cameras stored in a file, from which a player may show the scene: application data named [`VIEWS`]
//! (`docs/FORMAT.md`, "Views"). No decoder needs these cameras, and a decoder ignores those that it cannot read.

use serde::Deserialize;
use serde_json::{Value, json};
use tcgs_core::{Camera, length, normalize, rotmat_from_quat};

/// Name of the application data with cameras.
pub const VIEWS: &str = "tcgs.views";

/// Longest data that are parsed: 4,000 cameras take as much, and parsed JSON takes a multiple of its text.
const MAX_BYTES: usize = 1 << 20;
/// Largest side of a view in pixels; larger views are left out. Products of two sides then fit into an integer of 32
/// bits.
const MAX_SIDE: usize = 1 << 15;
/// Largest deviation of a rotation quaternion's length from 1; five decimals are written.
const MAX_LENGTH_ERROR: f64 = 1e-3;

/// A named camera of the capture from which a scene was trained.
#[derive(Clone, Debug, PartialEq)]
pub struct FileCamera {
    /// Name of the camera in the capture.
    pub name: String,
    /// Intrinsics and pose.
    pub camera: Camera,
}

#[derive(Deserialize)]
struct Views {
    views: Vec<Value>,
}

#[derive(Deserialize)]
struct View {
    name: String,
    width: usize,
    height: usize,
    focal: [f64; 2],
    principal: [f64; 2],
    position: [f64; 3],
    /// Rotation from camera to world, `w, x, y, z`.
    rotation: [f64; 4],
}

/// Cameras as application data, for [`encode_with`](crate::encode_with) under the name [`VIEWS`].
///
/// Focal lengths and principal points are rounded to 0.01 pixels, positions to four decimals in scene units, and
/// components of rotations to five decimals. Further digits would double the text without a visible effect.
///
/// - `cameras`: a player starts with the first camera
/// - returns: JSON in UTF-8 (`docs/FORMAT.md`, "Views")
///
/// ```
/// use tcgs_codec::{FileCamera, VIEWS, read_views, write_views};
/// use tcgs_core::Camera;
///
/// let camera = Camera::look_at([0.0, -1.0, 3.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48);
/// let bytes = write_views(&[FileCamera { name: "7".into(), camera }]);
/// let read = read_views(&[(VIEWS.into(), bytes)]);
/// assert_eq!((read[0].name.as_str(), read[0].camera.width), ("7", 64));
/// ```
pub fn write_views(cameras: &[FileCamera]) -> Vec<u8> {
    let views: Vec<Value> = cameras.iter().map(view).collect();
    json!({ "views": views }).to_string().into_bytes()
}

/// Cameras in the application data of a file; the inverse of [`write_views`] apart from rounding.
///
/// - `data`: names and bytes of application data, as [`application_data`](crate::application_data) gives them
/// - returns: the cameras of all data named [`VIEWS`], in their order. Invalid cameras are left out, and so are data
///   that are not JSON or longer than 1 MiB, so no input is an error
pub fn read_views(data: &[(String, Vec<u8>)]) -> Vec<FileCamera> {
    let of_views = data.iter().filter(|(name, bytes)| name == VIEWS && bytes.len() <= MAX_BYTES);
    let parsed = of_views.filter_map(|(_, bytes)| serde_json::from_slice::<Views>(bytes).ok());
    let views = parsed.flat_map(|views| views.views).filter_map(|view| serde_json::from_value::<View>(view).ok());
    views.filter_map(View::camera).collect()
}

impl View {
    fn camera(self) -> Option<FileCamera> {
        // The comparisons are false for NaN, too.
        let is_unit = (length(self.rotation) - 1.0).abs() <= MAX_LENGTH_ERROR;
        if !is_unit || self.width > MAX_SIDE || self.height > MAX_SIDE {
            return None;
        }
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

fn view(of: &FileCamera) -> Value {
    let camera = &of.camera;
    json!({
        "name": of.name,
        "width": camera.width,
        "height": camera.height,
        "focal": camera.focal.map(|x| rounded(x, 1e2)),
        "principal": camera.principal.map(|x| rounded(x, 1e2)),
        "position": camera.center().map(|x| rounded(x, 1e4)),
        "rotation": world_from_camera(&camera.camera_from_world).map(|x| rounded(x, 1e5)),
    })
}

/// Rounds a number to a fraction of one.
///
/// - `parts`: reciprocal of that fraction
fn rounded(x: f64, parts: f64) -> f64 {
    (x * parts).round() / parts
}

/// The rotation from camera to world as a unit quaternion `w, x, y, z`.
fn world_from_camera(camera_from_world: &[[f64; 4]; 4]) -> [f64; 4] {
    let r = |i: usize, j: usize| camera_from_world[j][i];
    // Each row is the quaternion times four times one of its components; the longest row is the most accurate.
    let rows = [
        [1.0 + r(0, 0) + r(1, 1) + r(2, 2), r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1)],
        [r(2, 1) - r(1, 2), 1.0 + r(0, 0) - r(1, 1) - r(2, 2), r(0, 1) + r(1, 0), r(0, 2) + r(2, 0)],
        [r(0, 2) - r(2, 0), r(0, 1) + r(1, 0), 1.0 - r(0, 0) + r(1, 1) - r(2, 2), r(1, 2) + r(2, 1)],
        [r(1, 0) - r(0, 1), r(0, 2) + r(2, 0), r(1, 2) + r(2, 1), 1.0 - r(0, 0) - r(1, 1) + r(2, 2)],
    ];
    let longest = (1..4).fold(0, |best, i| if rows[i][i] > rows[best][best] { i } else { best });
    normalize(rows[longest])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(json: &str) -> Vec<FileCamera> {
        read_views(&[("other".into(), b"{}".to_vec()), (VIEWS.into(), json.as_bytes().to_vec())])
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
        let huge = zero.replace("\"width\": 0", "\"width\": 1000000").replace("[0, 0, 0, 0]", "[1, 0, 0, 0]");
        assert!(read(&huge).is_empty());
        assert_eq!(read(&huge.replace("1000000", "1000")).len(), 1);
        // A zero quaternion is not a rotation: normalised, it would be the identity.
        assert!(read(&zero.replace("\"width\": 0", "\"width\": 10")).is_empty());
        // An invalid camera does not invalidate the others.
        let both = huge.replace("1000000", "1000").replace("[{", "[7, {\"name\": 7}, {");
        assert_eq!(read(&both).len(), 1);
        let long = format!("{}{}", huge.replace("1000000", "1000"), " ".repeat(MAX_BYTES));
        assert!(read(&long).is_empty());
        assert!(read_views(&[]).is_empty());
    }

    #[test]
    fn rotations_are_those_of_the_cameras() {
        for target in [[1.0, 0.0, 0.0], [0.0, 0.1, 1.0], [-1.0, 2.0, -3.0], [0.1, -1.0, -5.0], [-4.0, 0.1, 0.2]] {
            let camera = Camera::look_at([0.0; 3], target, [0.1, -1.0, 0.0], 50.0, 64, 48);
            let matrix = rotmat_from_quat(world_from_camera(&camera.camera_from_world));
            for (i, row) in matrix.iter().enumerate() {
                for (j, x) in row.iter().enumerate() {
                    assert!((x - camera.camera_from_world[j][i]).abs() < 1e-12, "{target:?}: {matrix:?}");
                }
            }
        }
    }
}
