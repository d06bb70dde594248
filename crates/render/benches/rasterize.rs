//! Forward and backward on a fixed random scene: 100,000 small Gaussians, five channels, at the two
//! sizes that training uses (a quarter of the Panoptic images, and all of them).

#[path = "../tests/suite/support/mod.rs"]
mod support;

use criterion::{Criterion, criterion_group, criterion_main};
use support::{random_scene, test_camera};
use tcgs_core::Image;
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};

fn rasterize(criterion: &mut Criterion) {
    let mut gaussians = random_scene(100_000, 5, 1);
    for scale in gaussians.scales.iter_mut() {
        // About the size of the basketball capture's initial Gaussians.
        *scale = scale.map(|s| 0.1 * s);
    }
    let settings = RenderSettings::default();
    for (width, height) in [(160, 90), (640, 360)] {
        let camera = test_camera(width, height);
        let v_image = Image::filled(width, height, 5, 1.0);
        let (output, saved) = CpuRasterizer.forward(&gaussians, &camera, &settings).expect("the CPU never fails");
        let covered = output.transmittance.iter().filter(|&&t| t < 0.5).count();
        assert!(2 * covered > output.transmittance.len(), "the scene must fill the image");
        let mut group = criterion.benchmark_group(format!("{width}x{height}"));
        group.sample_size(20);
        group.bench_function("forward", |b| {
            b.iter(|| CpuRasterizer.forward(&gaussians, &camera, &settings).expect("the CPU never fails"))
        });
        group.bench_function("backward", |b| {
            b.iter(|| {
                CpuRasterizer.backward(&gaussians, &camera, &settings, &saved, &v_image).expect("the CPU never fails")
            });
        });
        group.finish();
    }
}

criterion_group!(benches, rasterize);
criterion_main!(benches);
