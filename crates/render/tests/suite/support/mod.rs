//! Support for the tests: the f64 oracle, random scenes, and other programs' vectors.

#![allow(dead_code)] // a bench uses a part, and so do the tests of the CPU alone
#![allow(clippy::unwrap_used)] // clippy does not count a bench as a test

use std::io::Write;
pub mod oracle;

use std::path::PathBuf;

use tcgs_core::{Activated, Camera, normalize};
use tcgs_interchange::NpzReader;
#[cfg(feature = "gpu")]
use tcgs_render::gpu::{Gpu, GpuChoice};

/// Path of a test vector, or `None` with a message where the vectors are absent.
pub fn golden(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/golden")).join(name);
    if path.exists() {
        return Some(path);
    }
    assert!(std::env::var_os("REQUIRE_GOLDEN").is_none(), "{} is required and absent", path.display());
    // Written past the test harness's capture, so that a skip is visible.
    let _ = writeln!(std::io::stderr(), "skipped: {} is absent", path.display());
    None
}

/// The GPU that tests run on, or `None` with a message where there is none: `TCGS_TEST_GPU`, by default Mesa's
/// software.
#[cfg(feature = "gpu")]
pub fn gpu() -> Option<Gpu> {
    let name = std::env::var("TCGS_TEST_GPU").unwrap_or_else(|_| "llvmpipe".into());
    Gpu::open(GpuChoice::Named(&name))
        .map_err(|error| {
            assert!(std::env::var("REQUIRE_GPU").is_err(), "a GPU is required: {error}");
            let _ = writeln!(std::io::stderr(), "skipped: {error}");
        })
        .ok()
}

/// Arrays of one `.npz` file.
pub struct Arrays(NpzReader);

impl Arrays {
    pub fn open(path: &std::path::Path) -> Self {
        Self(NpzReader::open(path).unwrap())
    }

    pub fn f32(&mut self, name: &str) -> Vec<f32> {
        self.0.array_of(name).unwrap().values
    }

    pub fn f64(&mut self, name: &str) -> Vec<f64> {
        self.0.array_of(name).unwrap().values
    }

    pub fn i64(&mut self, name: &str) -> Vec<i64> {
        self.0.array_of(name).unwrap().values
    }

    /// The scene of a `raster_*.npz`.
    pub fn scene(&mut self) -> (Activated, Camera) {
        let size = self.i64("size_wh");
        let (k, camera_from_world) = (self.f64("k"), self.f64("camera_from_world"));
        let gaussians = Activated {
            means: rows(&self.f32("means")),
            quats: rows(&self.f32("quats_wxyz")).into_iter().map(normalize).collect(),
            scales: rows(&self.f32("scales")),
            opacities: self.f32("opacities"),
            colors: self.f32("colors"),
            num_channels: 3,
            is_antialiased: false,
            background: Vec::new(),
        };
        (gaussians, camera(size[0] as usize, size[1] as usize, &k, &camera_from_world))
    }
}

pub fn camera(width: usize, height: usize, k: &[f64], camera_from_world: &[f64]) -> Camera {
    Camera::new(
        width,
        height,
        std::array::from_fn(|i| std::array::from_fn(|j| k[3 * i + j])),
        std::array::from_fn(|i| std::array::from_fn(|j| camera_from_world[4 * i + j])),
    )
    .unwrap()
}

pub fn rows<const D: usize>(values: &[f32]) -> Vec<[f32; D]> {
    values.as_chunks::<D>().0.to_vec()
}

/// `‖found − expected‖ / ‖expected‖`.
pub fn relative_l2(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let norm = |it: &mut dyn Iterator<Item = f64>| it.map(|x| x * x).sum::<f64>().sqrt();
    norm(&mut found.iter().zip(expected).map(|(a, b)| f64::from(a - b)))
        / norm(&mut expected.iter().map(|&b| f64::from(b)))
}

/// A deterministic stream of numbers in `[0, 1)`.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 40) as f32 / (1 << 24) as f32
    }

    pub fn range(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.next()
    }
}

/// Gaussians in and around the view of [`test_camera`], some of them nearly opaque.
pub fn random_scene(num_gaussians: usize, num_channels: usize, seed: u64) -> Activated {
    let mut r = Random(seed);
    let mut out = Activated { num_channels, ..Activated::default() };
    for _ in 0..num_gaussians {
        out.means.push([r.range(-1.2, 1.2), r.range(-1.0, 1.0), r.range(-1.0, 1.0)]);
        out.quats.push(normalize([r.range(-1.0, 1.0), r.range(-1.0, 1.0), r.range(-1.0, 1.0), r.range(0.1, 1.0)]));
        out.scales.push([r.range(0.02, 0.3), r.range(0.02, 0.3), r.range(0.02, 0.3)]);
        out.opacities.push(r.range(0.05, 0.95));
        out.colors.extend((0..num_channels).map(|_| r.next()));
    }
    out
}

pub fn test_camera(width: usize, height: usize) -> Camera {
    Camera::look_at([0.2, -0.3, -3.0], [0.0; 3], [0.0, -1.0, 0.0], 0.9 * width as f64, width, height)
}
