//! The synthetic capture: a textured room with a glossy vase, three moving objects, and a fourth that enters later,
//! with exact cameras and masks, rendered by ray casting.
//!
//! What lives here: the poses of the cameras, and the files that are written. `scene` places and moves the bodies in
//! the room, `texture` colours them, `trace` intersects rays with them, `points` samples their surfaces. The scene is
//! soft (low-frequency textures, one wide reflection, weak moving shadows), so that a few thousand Gaussians can
//! represent it.

mod points;
mod scene;
mod texture;
mod trace;

use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;
use tcgs_core::{Camera, Image, Pinhole};
use tcgs_interchange::create_folders;

use crate::{
    CaptureError,
    points::{POINTS_FILE, write_points},
};
use scene::SyntheticScene;
pub use scene::ball_at;

/// Frames per second of the synthetic capture: the bodies' speeds and the ball's gravity are set for this rate.
pub const SYNTHETIC_FRAME_RATE: f64 = 30.0;

/// Distance of the cameras from the room's middle, along the floor, scene units (metres).
const ARC_RADIUS: f64 = 2.35;
/// Angle between the first and the last camera, as seen from the room's middle.
const ARC_ANGLE: f64 = 2.9;
/// Heights of training cameras, in turn; test cameras stand between.
const CAMERA_HEIGHTS: [f64; 2] = [0.95, 1.75];
/// Target of all cameras, near the middle of the objects' paths.
const TARGET: [f64; 3] = [0.0, -0.82, 0.2];
/// Focal length over image width: a horizontal field of view of 63 degrees.
const FOCAL_PER_WIDTH: f64 = 0.82;
/// Colour samples along each side of a pixel.
const SUPERSAMPLES: usize = 2;

/// Settings of [`write_synthetic`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SyntheticSettings {
    /// Image width in pixels; default 128.
    pub width: usize,
    /// Image height in pixels; default 96.
    pub height: usize,
    /// Number of training cameras, at least two more than test cameras; default 12.
    pub num_train_cameras: usize,
    /// Number of test cameras, each between two training cameras; default 2.
    pub num_test_cameras: usize,
    /// Number of frames of every camera, at [`SYNTHETIC_FRAME_RATE`]; default 24. The motion does not depend on it.
    pub num_timesteps: usize,
    /// Number of initial points, a third of them on the moving objects; default 8000.
    pub num_points: usize,
    /// Seed of the initial points' positions; default 0. The images do not depend on it.
    pub seed: u64,
}

impl Default for SyntheticSettings {
    fn default() -> Self {
        Self {
            width: 128,
            height: 96,
            num_train_cameras: 12,
            num_test_cameras: 2,
            num_timesteps: 24,
            num_points: 8000,
            seed: 0,
        }
    }
}

/// Renders the synthetic capture into a folder, as a capture of the kind
/// [`CaptureKind::PANOPTIC`](crate::CaptureKind::PANOPTIC): `train_meta.json`, `test_meta.json`,
/// `ims/CAMERA/FRAME.png`, `seg/CAMERA/FRAME.png` (1 where a moving object is seen, for test cameras too) and
/// `init_pt_cld.npz`. The scene unit is the metre. Equal settings give equal bytes.
///
/// - `dir`: the folder; created if it does not exist. Existing files of these names are overwritten.
///
/// ```
/// use tcgs_capture::{Capture, CaptureKind, SyntheticSettings, write_synthetic};
/// let folder = tempfile::tempdir()?;
/// let settings = SyntheticSettings { width: 32, height: 24, num_timesteps: 1, ..Default::default() };
/// write_synthetic(folder.path(), &settings)?;
/// assert_eq!(Capture::open(folder.path())?.kind(), CaptureKind::PANOPTIC);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`CaptureError`] if a file cannot be written.
///
/// # Panics
/// If width, height, timesteps or points are 0, or the training cameras are not at least two more than the test
/// cameras.
pub fn write_synthetic(dir: &Path, settings: &SyntheticSettings) -> Result<(), CaptureError> {
    let sizes = [settings.width, settings.height, settings.num_timesteps, settings.num_points];
    assert!(sizes.iter().all(|&size| size > 0), "width, height, timesteps and points of {sizes:?}");
    let cameras = cameras(settings);
    for camera in &cameras {
        for folder in ["ims", "seg"] {
            let path = dir.join(folder).join(camera.id.to_string());
            create_folders(&path).map_err(|error| failed(&path, error))?;
        }
    }
    write_meta(&dir.join("train_meta.json"), settings, cameras.iter().filter(|camera| !camera.test))?;
    write_meta(&dir.join("test_meta.json"), settings, cameras.iter().filter(|camera| camera.test))?;
    let (path, cloud) = (dir.join(POINTS_FILE), points::sample(settings.num_points, settings.seed));
    let written = std::fs::File::create(&path).and_then(|file| write_points(file, &cloud));
    written.map_err(|error| failed(&path, error))?;

    let scenes: Vec<SyntheticScene> = (0..settings.num_timesteps).map(SyntheticScene::at).collect();
    let jobs: Vec<(&NumberedCamera, usize)> =
        cameras.iter().flat_map(|camera| (0..settings.num_timesteps).map(move |timestep| (camera, timestep))).collect();
    jobs.into_par_iter().try_for_each(|(camera, timestep)| {
        let (image, mask) = render(&scenes[timestep], &camera.camera);
        let write = |folder: &str, bytes: &[u8], color| {
            let path = dir.join(folder).join(file_name(camera.id, timestep));
            image::save_buffer(&path, bytes, settings.width as u32, settings.height as u32, color)
                .map_err(|error| failed(&path, error))
        };
        write("ims", &image.to_rgb8(), image::ColorType::Rgb8)?;
        write("seg", &mask.iter().map(|&m| u8::from(m)).collect::<Vec<_>>(), image::ColorType::L8)
    })
}

/// Pixels of a view of the synthetic capture whose surface no training camera saw at timestep 0.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Late {
    /// `[H, W]`, pixels of an object that was not there.
    pub arrived: Vec<bool>,
    /// `[H, W]`, pixels of static surfaces that were hidden.
    pub uncovered: Vec<bool>,
}

impl Late {
    /// Finds late pixels in one view of the capture that [`write_synthetic`] writes.
    ///
    /// - `camera`: anywhere in the room
    ///
    /// ```
    /// use tcgs_capture::{Late, SyntheticSettings};
    /// use tcgs_core::Camera;
    /// let camera = Camera::look_at([0.0, -1.3, -2.3], [-1.0, -1.5, 0.9], [0.0, -1.0, 0.0], 50.0, 64, 48);
    /// let late = |timestep| Late::in_view(&SyntheticSettings::default(), &camera, timestep);
    /// assert!(!late(0).arrived.contains(&true) && late(20).arrived.contains(&true));
    /// ```
    pub fn in_view(settings: &SyntheticSettings, camera: &Camera, timestep: usize) -> Self {
        let (before, now) = (SyntheticScene::at(0), SyntheticScene::at(timestep));
        let cameras: Vec<Camera> = cameras(settings).into_iter().filter(|c| !c.test).map(|c| c.camera).collect();
        let pinholes: Vec<Pinhole<f64>> = cameras.iter().map(Pinhole::new).collect();
        let (center, pinhole) = (camera.center(), Pinhole::new(camera));
        let of_pixel = |pixel: usize| {
            let hit = now.hit(center, tcgs_core::normalize(pinhole.ray(pinhole.pixel_center(pixel))));
            let was_seen = |from: &Pinhole<f64>| from.pixel(hit.position()).is_some() && before.sees(from.center, &hit);
            let is_hidden = || !hit.is_moving(&now) && !pinholes.iter().any(was_seen);
            [hit.has_arrived(&before), is_hidden()]
        };
        let pixels: Vec<[bool; 2]> = (0..camera.width * camera.height).into_par_iter().map(of_pixel).collect();
        Self { arrived: pixels.iter().map(|p| p[0]).collect(), uncovered: pixels.iter().map(|p| p[1]).collect() }
    }
}

struct NumberedCamera {
    id: usize,
    test: bool,
    camera: Camera,
}

/// All cameras, evenly along an arc, test cameras among the training cameras and never at the ends.
fn cameras(settings: &SyntheticSettings) -> Vec<NumberedCamera> {
    let (num_train, num_test) = (settings.num_train_cameras, settings.num_test_cameras);
    assert!(num_train >= num_test + 2, "{num_train} training cameras for {num_test} test cameras between them");
    let num_cameras = num_train + num_test;
    let test_ids: Vec<usize> = (1..=num_test).map(|i| i * num_cameras / (num_test + 1)).collect();
    let mut num_placed = 0;
    (0..num_cameras)
        .map(|id| {
            let test = test_ids.contains(&id);
            let height =
                if test { (CAMERA_HEIGHTS[0] + CAMERA_HEIGHTS[1]) / 2.0 } else { CAMERA_HEIGHTS[num_placed % 2] };
            num_placed += usize::from(!test);
            let angle = ARC_ANGLE * (id as f64 / (num_cameras - 1) as f64 - 0.5);
            let center = [ARC_RADIUS * angle.sin(), -height, -ARC_RADIUS * angle.cos()];
            let focal_px = FOCAL_PER_WIDTH * settings.width as f64;
            let up = [0.0, -1.0, 0.0];
            let camera = Camera::look_at(center, TARGET, up, focal_px, settings.width, settings.height);
            NumberedCamera { id, test, camera }
        })
        .collect()
}

/// Colour averaged over samples of each pixel, and whether its centre shows a moving object.
fn render(scene: &SyntheticScene, camera: &Camera) -> (Image, Vec<bool>) {
    let mut image = Image::filled(camera.width, camera.height, 3, 0.0);
    let num_pixels = image.num_pixels();
    let mut mask = vec![false; num_pixels];
    let (center, pinhole) = (camera.center(), Pinhole::new(camera));
    for (pixel, mask) in mask.iter_mut().enumerate() {
        let corner = [(pixel % camera.width) as f64, (pixel / camera.width) as f64];
        let ray = |dx: f64, dy: f64| tcgs_core::normalize(pinhole.ray([corner[0] + dx, corner[1] + dy]));
        *mask = scene.hit(center, ray(0.5, 0.5)).is_moving(scene);
        let mut sum = [0.0; 3];
        for sample in 0..SUPERSAMPLES * SUPERSAMPLES {
            let at = |i: usize| (i as f64 + 0.5) / SUPERSAMPLES as f64;
            let direction = ray(at(sample % SUPERSAMPLES), at(sample / SUPERSAMPLES));
            let color = scene.color_along(direction, &scene.hit(center, direction));
            sum = std::array::from_fn(|i| sum[i] + color[i]);
        }
        for (channel, sum) in sum.into_iter().enumerate() {
            image.data[channel * num_pixels + pixel] = (sum / (SUPERSAMPLES * SUPERSAMPLES) as f64) as f32;
        }
    }
    (image, mask)
}

/// `train_meta.json` and `test_meta.json` of Dynamic 3D Gaussians: outer lists are timesteps, inner cameras.
#[derive(Serialize)]
struct Meta {
    w: usize,
    h: usize,
    k: Vec<Vec<[[f64; 3]; 3]>>,
    w2c: Vec<Vec<[[f64; 4]; 4]>>,
    r#fn: Vec<Vec<String>>,
    cam_id: Vec<Vec<usize>>,
}

fn write_meta<'a>(
    path: &Path,
    settings: &SyntheticSettings,
    cameras: impl Iterator<Item = &'a NumberedCamera>,
) -> Result<(), CaptureError> {
    let cameras: Vec<_> = cameras.collect();
    let k = |camera: &Camera| {
        let ([fx, fy], [cx, cy]) = (camera.focal, camera.principal);
        [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]
    };
    let timesteps = 0..settings.num_timesteps;
    let meta = Meta {
        w: settings.width,
        h: settings.height,
        k: timesteps.clone().map(|_| cameras.iter().map(|c| k(&c.camera)).collect()).collect(),
        w2c: timesteps.clone().map(|_| cameras.iter().map(|c| c.camera.camera_from_world).collect()).collect(),
        r#fn: timesteps.clone().map(|t| cameras.iter().map(|c| file_name(c.id, t)).collect()).collect(),
        cam_id: timesteps.map(|_| cameras.iter().map(|c| c.id).collect()).collect(),
    };
    let json = serde_json::to_vec(&meta).map_err(|error| failed(path, error))?;
    std::fs::write(path, json).map_err(|error| failed(path, error))
}

/// File name of a camera's image at a timestep, below `ims` and `seg`.
fn file_name(camera_id: usize, timestep: usize) -> String {
    format!("{camera_id}/{timestep:06}.png")
}

/// Errors of pictures and files alike: only writing can fail in a folder of our own.
fn failed(path: &Path, error: impl std::fmt::Display) -> CaptureError {
    CaptureError::invalid(path, format!("writing failed: {error}"))
}

/// Distance of a point from the nearest surface of the synthetic scene at the first timestep, metres.
///
/// - `moving`: whether the surfaces of moving bodies are meant, or those of static ones
pub fn distance_from_surface(point: [f32; 3], moving: bool) -> f64 {
    SyntheticScene::at(0).distance(point.map(f64::from), moving)
}

#[cfg(test)]
mod tests;
