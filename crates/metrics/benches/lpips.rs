//! LPIPS of a pair at Panoptic's size, with both networks. Needs the weights that `TCGS_LPIPS_WEIGHTS` names: the speed
//! does not depend on the weights, but the bench's check of its result does.

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use tcgs_core::Image;
use tcgs_metrics::{Backbone, InputRange, Lpips};

fn wave(phase: f32) -> Image {
    let mut image = Image::filled(640, 360, 3, 0.0);
    for (i, value) in image.data.iter_mut().enumerate() {
        *value = 0.5 + 0.4 * ((i % 640) as f32 * 0.1 + (i / 640) as f32 * 0.07 + phase).sin();
    }
    image
}

fn bench(criterion: &mut Criterion) {
    let Some(path) = std::env::var_os("TCGS_LPIPS_WEIGHTS") else {
        eprintln!("skipped: TCGS_LPIPS_WEIGHTS names no file; scripts/fetch_lpips_weights.py makes one");
        return;
    };
    let lpips = Lpips::read(Path::new(&path)).expect("weights");
    let (a, b) = (wave(0.0), wave(0.3));
    let mut group = criterion.benchmark_group("lpips");
    group.sample_size(10);
    for backbone in Backbone::ALL {
        let distance = || lpips.distance(backbone, InputRange::Signed, black_box(&a), &b).expect("large enough");
        assert_eq!(lpips.distance(backbone, InputRange::Signed, &a, &a), Some(0.0));
        assert!((0.01..1.0).contains(&distance()), "{}", distance());
        group.bench_function(backbone.name(), |b| b.iter(distance));
    }
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
