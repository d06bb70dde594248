//! A small capture in a temporary folder, for tests to spoil.

mod needs;
#[cfg(feature = "video")]
pub mod numbered;

use std::path::{MAIN_SEPARATOR, Path, PathBuf};

use serde_json::{Value, json};
use tcgs_capture::{Capture, CaptureError};
use tcgs_core::Camera;
use tcgs_interchange::NpzWriter;
use tempfile::TempDir;

#[cfg(feature = "video")]
pub use needs::has_ffmpeg;
pub use needs::real_folder;

pub const WIDTH: u32 = 16;
pub const HEIGHT: u32 = 12;
pub const NUM_FRAMES: usize = 2;

/// Training cameras 1, 2, 4, 5; test camera 3. Two frames of 16x12 pixels.
pub struct Small {
    pub folder: TempDir,
    pub train_meta: Value,
    pub test_meta: Value,
    /// `[P, 7]`
    pub points: Vec<[f32; 7]>,
}

impl Small {
    /// Writes the images; [`Self::write`] writes metas and points.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (train, test) = ([1, 2, 4, 5], [3]);
        for id in train.into_iter().chain(test) {
            for kind in ["ims", "seg"] {
                std::fs::create_dir_all(folder.path().join(format!("{kind}/{id}"))).unwrap();
            }
            for t in 0..NUM_FRAMES {
                let color = color(id, t);
                image::RgbImage::from_pixel(WIDTH, HEIGHT, image::Rgb(color)).save(image_path(&folder, id, t)).unwrap();
                if id != 3 {
                    // The left half is foreground.
                    let mask = image::GrayImage::from_fn(WIDTH, HEIGHT, |x, _| image::Luma([u8::from(x < WIDTH / 2)]));
                    mask.save(mask_path(&folder, id, t)).unwrap();
                }
            }
        }
        let points = (0..100).map(|i| {
            let angle = i as f32;
            [0.3 * angle.cos(), 0.01 * (i % 20) as f32, 0.3 * angle.sin(), 0.1, 0.5, 1.0, f32::from(u8::from(i < 40))]
        });
        Self { train_meta: meta(&train), test_meta: meta(&test), points: points.collect(), folder }
    }

    pub fn path(&self) -> &Path {
        self.folder.path()
    }

    pub fn image(&self, id: usize, t: usize) -> PathBuf {
        image_path(&self.folder, id, t)
    }

    pub fn mask(&self, id: usize, t: usize) -> PathBuf {
        mask_path(&self.folder, id, t)
    }

    /// Writes metas and points.
    pub fn write(&self) {
        std::fs::write(self.path().join("train_meta.json"), self.train_meta.to_string()).unwrap();
        std::fs::write(self.path().join("test_meta.json"), self.test_meta.to_string()).unwrap();
        self.write_points(&[self.points.len(), 7], self.points.as_flattened());
    }

    pub fn write_points(&self, shape: &[usize], values: &[f32]) {
        let mut npz = NpzWriter::new(std::fs::File::create(self.path().join("init_pt_cld.npz")).unwrap());
        npz.array("data", shape, [values]).unwrap();
        npz.finish().unwrap();
    }

    /// Opens the written capture.
    pub fn open(&self) -> Result<Capture, CaptureError> {
        Capture::open(self.path())
    }

    /// The error of opening the capture, as one line without the folder's name.
    pub fn problem(&self) -> String {
        self.shorten(self.open().unwrap_err())
    }

    /// A message without the folder's name.
    pub fn shorten(&self, error: CaptureError) -> String {
        shorten(self.path(), &error)
    }
}

/// A message of one line without a folder's name.
pub fn shorten(folder: &Path, error: &CaptureError) -> String {
    let message = error.to_string();
    assert!(!message.contains('\n'), "{message}");
    let short = message.strip_prefix(&folder.display().to_string());
    let short = short.unwrap_or_else(|| panic!("{message}")).trim_start_matches(MAIN_SEPARATOR);
    // Windows has another separator, which the file's name alone may hold.
    let end_of_name = short.find(": ").unwrap_or(0);
    format!("{}{}", short[..end_of_name].replace(MAIN_SEPARATOR, "/"), &short[end_of_name..])
}

/// The error of opening a folder.
pub fn problem(folder: &Path) -> String {
    shorten(folder, &Capture::open(folder).unwrap_err())
}

/// The camera of another size and number on the circle of [`camera`].
pub fn camera_of(id: usize, of: usize, width: usize, height: usize) -> Camera {
    let angle = id as f64 * std::f64::consts::TAU / of as f64;
    let center = [2.0 * angle.cos(), -0.5, 2.0 * angle.sin()];
    Camera::look_at(center, [0.0; 3], [0.0, -1.0, 0.0], 0.875 * width as f64, width, height)
}

/// Asserts that two cameras are equal up to rounding.
pub fn assert_close(found: &Camera, expected: &Camera) {
    let numbers = |camera: &Camera| -> Vec<f64> {
        let sizes = [camera.width as f64, camera.height as f64];
        [&sizes[..], &camera.focal, &camera.principal, camera.camera_from_world.as_flattened()].concat()
    };
    for (a, b) in numbers(found).iter().zip(numbers(expected)) {
        assert!((a - b).abs() < 2e-6 * (1.0 + b.abs()), "{found:?}, expected {expected:?}");
    }
}

/// A few red points around the origin, which the cameras see.
pub fn write_ply(path: &Path) {
    let mut text = String::from("ply\nformat ascii 1.0\nelement vertex 50\n");
    for (kind, name) in [("float", "x"), ("float", "y"), ("float", "z")] {
        text += &format!("property {kind} {name}\n");
    }
    text += "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n";
    for i in 0..50 {
        let angle = f64::from(i);
        text += &format!("{} {} {} 255 0 0\n", 0.3 * angle.cos(), 0.01 * f64::from(i % 20), 0.3 * angle.sin());
    }
    std::fs::write(path, text).unwrap();
}

/// Quaternion `[w, x, y, z]` of a camera's rotation.
pub fn quat(camera: &Camera) -> [f64; 4] {
    let m = &camera.camera_from_world;
    // The largest component first (Shepperd 1978).
    let squares = [
        1.0 + m[0][0] + m[1][1] + m[2][2],
        1.0 + m[0][0] - m[1][1] - m[2][2],
        1.0 - m[0][0] + m[1][1] - m[2][2],
        1.0 - m[0][0] - m[1][1] + m[2][2],
    ];
    let largest = (0..4).max_by(|&a, &b| squares[a].total_cmp(&squares[b])).unwrap();
    let s = squares[largest].sqrt() * 2.0;
    let q = match largest {
        0 => [s * s / 4.0, m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]],
        1 => [m[2][1] - m[1][2], s * s / 4.0, m[0][1] + m[1][0], m[0][2] + m[2][0]],
        2 => [m[0][2] - m[2][0], m[0][1] + m[1][0], s * s / 4.0, m[1][2] + m[2][1]],
        _ => [m[1][0] - m[0][1], m[0][2] + m[2][0], m[1][2] + m[2][1], s * s / 4.0],
    };
    q.map(|x| x / s)
}

/// A picture of one colour.
pub fn write_image(path: &Path, width: u32, height: u32, color: [u8; 3]) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::RgbImage::from_pixel(width, height, image::Rgb(color)).save(path).unwrap();
}

/// The single colour of an image.
pub fn color(id: usize, t: usize) -> [u8; 3] {
    [10 * id as u8, 100 * t as u8, 200]
}

/// Cameras 0 to 7 stand on a circle around the origin.
pub fn camera(id: usize) -> Camera {
    let angle = id as f64 * std::f64::consts::TAU / 8.0;
    let center = [2.0 * angle.cos(), -0.5, 2.0 * angle.sin()];
    Camera::look_at(center, [0.0; 3], [0.0, -1.0, 0.0], 14.0, WIDTH as usize, HEIGHT as usize)
}

fn meta(ids: &[usize]) -> Value {
    let each = |of: &dyn Fn(usize, usize) -> Value| -> Value {
        (0..NUM_FRAMES).map(|t| ids.iter().map(|&id| of(id, t)).collect::<Value>()).collect()
    };
    json!({
        "w": WIDTH,
        "h": HEIGHT,
        "k": each(&|_, _| json!([[14.0, 0.0, 8.0], [0.0, 14.0, 6.0], [0, 0, 1]])),
        "w2c": each(&|id, _| json!(camera(id).camera_from_world)),
        "fn": each(&|id, t| json!(format!("{id}/{t:06}.png"))),
        "cam_id": each(&|id, _| json!(id)),
    })
}

fn image_path(folder: &TempDir, id: usize, t: usize) -> PathBuf {
    folder.path().join(format!("ims/{id}/{t:06}.png"))
}

fn mask_path(folder: &TempDir, id: usize, t: usize) -> PathBuf {
    folder.path().join(format!("seg/{id}/{t:06}.png"))
}
