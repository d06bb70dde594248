//! SSIM and its gradient at the sizes that training uses: colour and segmentation, five channels,
//! of a quarter-size and of a full Panoptic image.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use tcgs_core::Image;
use tcgs_metrics::{ssim, ssim_grad};

fn wave(width: usize, height: usize, phase: f32) -> Image {
    let mut image = Image::filled(width, height, 5, 0.0);
    for (i, value) in image.data.iter_mut().enumerate() {
        *value = 0.5 + 0.4 * ((i % width) as f32 * 0.1 + (i / width) as f32 * 0.07 + phase).sin();
    }
    image
}

fn bench(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("ssim");
    for (width, height) in [(160, 90), (640, 360)] {
        let (x, y) = (wave(width, height, 0.0), wave(width, height, 0.3));
        let mut v = Image::filled(width, height, 5, 0.0);
        let means = ssim_grad(&x, &y, &[1.0; 5], &mut v);
        assert!(means.iter().all(|m| (0.8..0.99).contains(m)), "{means:?}");
        group.bench_function(BenchmarkId::new("value", width), |b| b.iter(|| ssim(black_box(&x), &y)));
        group.bench_function(BenchmarkId::new("gradient", width), |b| {
            b.iter(|| ssim_grad(black_box(&x), &y, &[1.0; 5], &mut v));
        });
        assert!(v.data.iter().all(|v| v.is_finite()));
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
