//! A small capture written to a temporary folder, for tests to spoil.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use tcgs_capture::{Capture, CaptureError};
use tcgs_core::Camera;
use tcgs_interchange::NpzWriter;
use tempfile::TempDir;

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
    /// Images are there; metas and points wait for [`Self::write`].
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

    /// Opens what was written.
    pub fn open(&self) -> Result<Capture, CaptureError> {
        Capture::open(self.path())
    }

    /// Why it cannot be opened, as one line without the folder's name.
    pub fn problem(&self) -> String {
        self.shorten(self.open().unwrap_err())
    }

    /// A message without the folder's name.
    pub fn shorten(&self, error: CaptureError) -> String {
        let message = error.to_string();
        assert!(!message.contains('\n'), "{message}");
        let short = message.strip_prefix(&self.path().display().to_string()).unwrap();
        short.trim_start_matches('/').to_owned()
    }
}

/// Every image has one colour.
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
