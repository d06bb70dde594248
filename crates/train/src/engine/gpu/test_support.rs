//! Helpers of this module's tests.

use std::io::Write;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use tcgs_core::{BaseColumns, Gaussians, Layout};
use tcgs_render::device::Coverage;
use tcgs_render::gpu::{Gpu, GpuChoice};

use crate::engine::device::{Packing, StepUniform};
use crate::fake_quant::{FakeQuantizers, step_gradient_scale};

/// The GPU that tests run on: named by `TCGS_TEST_GPU`, or Mesa's software one. `None`, with a message, if
/// there is none, unless `REQUIRE_GPU` is set.
pub(super) fn gpu() -> Option<Gpu> {
    let name = std::env::var("TCGS_TEST_GPU").unwrap_or_else(|_| "llvmpipe".into());
    match Gpu::open(GpuChoice::Named(&name)) {
        Ok(gpu) => Some(gpu),
        Err(error) => {
            assert!(std::env::var_os("REQUIRE_GPU").is_none(), "{error}");
            let _ = writeln!(std::io::stderr(), "skipped: {error}");
            None
        }
    }
}

/// Numbers in `[low, high)`.
pub(super) fn random(seed: u64, len: usize, low: f32, high: f32) -> Vec<f32> {
    let mut rng = Pcg64::seed_from_u64(seed);
    (0..len).map(|_| rng.random_range(low..high)).collect()
}

/// The same in rows.
pub(super) fn random_rows<const D: usize>(seed: u64, len: usize, low: f32, high: f32) -> Vec<[f32; D]> {
    random(seed, D * len, low, high).as_chunks::<D>().0.to_vec()
}

/// `‖found − expected‖ / ‖expected‖`
pub(super) fn relative_error(found: &[f32], expected: &[f32]) -> f64 {
    assert_eq!(found.len(), expected.len());
    let sum = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    let difference = sum(&mut found.iter().zip(expected).map(|(a, b)| f64::from(*a) - f64::from(*b)));
    let norm = sum(&mut expected.iter().map(|b| f64::from(*b)));
    if difference == 0.0 { 0.0 } else { difference / norm }
}

/// Asserts that two arrays agree; prints the difference.
#[track_caller]
pub(super) fn assert_close(what: &str, found: &[f32], expected: &[f32], tolerance: f64) {
    let error = relative_error(found, expected);
    println!("{what}: relative error {error:.2e}");
    assert!(error <= tolerance, "{what}: relative error {error:e}, at most {tolerance:e}");
}

/// Records with `record` in one pass, runs it, and waits.
pub(super) fn run(gpu: &Gpu, record: impl FnOnce(&mut wgpu::ComputePass<'_>)) {
    let mut encoder = gpu.encoder();
    record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()));
    gpu.submit(encoder);
    gpu.wait().expect("the GPU works");
}

/// The uniform of an iteration of the base layout; missing rates are 0.
pub(super) fn uniform(gpu: &Gpu, step: &StepUniform, rates: &[[f32; 4]]) -> wgpu::Buffer {
    uniform_of(gpu, &Packing::new(&Layout::base()), step, rates)
}

/// The same for any layout.
pub(super) fn uniform_of(gpu: &Gpu, packing: &Packing, step: &StepUniform, rates: &[[f32; 4]]) -> wgpu::Buffer {
    let mut all = rates.to_vec();
    all.resize(packing.num_groups(), [0.0; 4]);
    let buffer = gpu.uniform("step", StepUniform::size(packing)).expect("memory");
    gpu.queue().write_buffer(&buffer, 0, &step.bytes(&all));
    buffer
}

/// Gaussians in stored form, quaternions of any length.
pub(super) fn random_gaussians(seed: u64, n: usize) -> Gaussians {
    Gaussians::from(BaseColumns {
        means: random_rows(seed, n, -3.0, 3.0),
        quats: random_rows(seed + 1, n, -1.0, 1.0),
        log_scales: random_rows(seed + 2, n, -6.0, 1.0),
        logit_opacities: random(seed + 3, n, -5.0, 5.0),
        colors: random_rows(seed + 4, n, -0.2, 1.2),
    })
}

/// Quantizers as the shaders read them.
pub(super) struct QuantizerTables {
    /// `[N]`
    pub groups: Vec<u32>,
    /// `[256]`
    pub starts: Vec<u32>,
    /// `[Q]`
    pub quantizers: Vec<[f32; 4]>,
    /// `[Q]`
    pub gradient_scales: Vec<f32>,
}

impl QuantizerTables {
    pub(super) fn new(q: &FakeQuantizers) -> Self {
        let (mut starts, mut gradient_scales) = (vec![0; 256], Vec::new());
        let mut groups = vec![0; q.bit_map.num_gaussians()];
        for (number, &(attribute, width)) in q.groups.iter().enumerate() {
            starts[number] = gradient_scales.len() as u32;
            let members: Vec<usize> =
                (0..groups.len()).filter(|&n| q.bit_map.widths[attribute.index()][n] == width).collect();
            for &n in &members {
                groups[n] |= (number as u32) << (8 * (attribute.index() - 1));
            }
            let components = attribute.components();
            gradient_scales.extend(vec![step_gradient_scale(width, members.len() * components); components]);
        }
        let quantizers =
            q.quantizers.iter().map(|q| [q.step, q.offset, q.min_code() as f32, q.max_code() as f32]).collect();
        Self { groups, starts, quantizers, gradient_scales }
    }
}

/// Parses and validates every shader of this module, and counts the buffers that its entry points use.
#[test]
fn shaders_are_valid_and_within_limits() {
    use wgpu::naga::{AddressSpace, front, valid};
    let mut layout = Layout::default();
    layout.push("harmonics", 45, tcgs_core::Column::like(tcgs_core::Attribute::Color));
    let of = |packing: &Packing| {
        [
            super::activate::shader(packing),
            super::adam::shader(packing),
            super::sums::shader(packing),
            super::image_loss::shader(packing, Coverage::Whole),
            super::image_loss::shader(packing, Coverage::Listed),
            super::motion_prior::shader(packing),
            super::fake_quant::shader(packing),
        ]
    };
    let packings = [Layout::base(), std::sync::Arc::new(layout)].map(|layout| Packing::new(&layout));
    let seen = (0..=3).map(|degree| super::seen::shader(&Packing::new(&Layout::with_harmonics(degree))));
    let shaders = packings.iter().flat_map(of).chain(seen);
    for shader in shaders {
        let module = front::wgsl::parse_str(&shader).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&shader)));
        let info = valid::Validator::new(valid::ValidationFlags::all(), valid::Capabilities::empty())
            .validate(&module)
            .unwrap_or_else(|e| panic!("{}", e.emit_to_string(&shader)));
        let mut layouter = wgpu::naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).expect("sizes");
        for (index, entry) in module.entry_points.iter().enumerate() {
            let used = || module.global_variables.iter().filter(|(v, _)| !info.get_entry_point(index)[*v].is_empty());
            let storage = used().filter(|(_, v)| matches!(v.space, AddressSpace::Storage { .. })).count();
            let shared = used().filter(|(_, v)| v.space == AddressSpace::WorkGroup);
            let bytes: u32 = shared.map(|(_, v)| layouter[v.ty].size).sum();
            println!("{}: {storage} storage buffers, {bytes} bytes of workgroup memory", entry.name);
            assert!(storage <= 10 && bytes <= 16_384, "{}: {storage} buffers, {bytes} bytes", entry.name);
        }
    }
}
