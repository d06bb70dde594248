//! Helpers of tests.

pub mod engines;

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tcgs_core::{Attribute, Column, Columns, Layout};
use tcgs_render::gpu::{Gpu, GpuChoice};

/// The GPU for tests, by the name in `TCGS_TEST_GPU`, or Mesa's software adapter.
pub fn gpu() -> Option<Gpu> {
    let name = std::env::var("TCGS_TEST_GPU").unwrap_or_else(|_| "llvmpipe".into());
    match Gpu::open(GpuChoice::Named(&name)) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            assert!(std::env::var("REQUIRE_GPU").is_err(), "{error}");
            // Bypasses the capture of passing tests, so that a skip is visible.
            let _ = writeln!(std::io::stderr(), "skipped: {error}");
            None
        }
    }
}

/// Copies a folder. The copy of the folder that a run writes to is a run that was stopped.
pub fn copy_folder(from: &Path, to: &Path) {
    std::fs::create_dir(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let (from, to) = (entry.as_ref().unwrap().path(), to.join(entry.unwrap().file_name()));
        if from.is_dir() { copy_folder(&from, &to) } else { std::fs::copy(&from, &to).map(drop).unwrap() }
    }
}

/// Random numbers that are the same in every run.
pub struct Random(Pcg64Mcg);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(Pcg64Mcg::seed_from_u64(seed))
    }

    /// Uniform within `±size`.
    pub fn within(&mut self, size: f32) -> f32 {
        self.0.random_range(-size..size)
    }

    pub fn row<const D: usize>(&mut self, size: f32) -> [f32; D] {
        std::array::from_fn(|_| self.within(size))
    }

    pub fn below(&mut self, end: usize) -> usize {
        self.0.random_range(0..end)
    }
}

/// Columns as the GPU holds them, `[values * N]`; mask logits are zero.
pub fn packed<Role>(columns: &Columns<Role>) -> Vec<f32> {
    let layout = columns.layout();
    let mut all: Vec<f32> = layout.attributes().flat_map(|a| columns.values(a).iter().copied()).collect();
    all.resize((layout.components() + 1) * columns.num_gaussians(), 0.0);
    all
}

/// The base layout with three columns that nothing draws: `wetness[2]`, which is quantised; `age[1]`, which neither
/// varies nor is quantised; `glow[5]`, quantised.
pub fn further_layout() -> Arc<Layout> {
    let mut layout = Layout::default();
    layout.push("wetness", 2, Column::like(Attribute::Color));
    layout.push("age", 1, Column { varies: false, quantized: false, ..Column::like(Attribute::LogScale) });
    layout.push("glow", 5, Column::like(Attribute::Quat));
    Arc::new(layout)
}

/// `‖found − expected‖ / ‖expected‖`; the numerator alone if nothing is expected.
pub fn relative_l2(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|x| x * x).sum::<f64>().sqrt();
    let error = norm(&mut found.iter().zip(expected).map(|(&a, &b)| f64::from(a) - f64::from(b)));
    let size = norm(&mut expected.iter().map(|&b| f64::from(b)));
    if size > 0.0 { error / size } else { error }
}
