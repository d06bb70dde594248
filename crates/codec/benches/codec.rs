//! Keypoint selection, compression, encoding and decoding. Every bench checks its result first.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use tcgs_codec::{CompressSettings, DecodeLimits, SceneInfo, compress, decode, encode, select_keypoints};

#[path = "../tests/scenes/mod.rs"]
mod scenes;

fn keypoints(criterion: &mut Criterion) {
    // The paper's length; a walk needs all of its keypoints, the slowest case.
    let random = &mut scenes::Random(5);
    let tracks: Vec<Vec<f32>> = (0..1000)
        .map(|_| {
            let mut x = 0.0;
            (0..150)
                .map(|_| {
                    x += 0.01 * random.normal();
                    x
                })
                .collect()
        })
        .collect();
    let run = || tracks.iter().map(|t| select_keypoints(black_box(t), 30, 1e-5).len()).sum::<usize>();
    assert!((20_000..=30_000).contains(&run()), "{} keypoints", run());
    let mut group = criterion.benchmark_group("keypoints");
    group.throughput(Throughput::Elements(tracks.len() as u64));
    group.bench_function("1000 walks of 150 timesteps", |b| b.iter(run));
    group.finish();
}

fn scene(criterion: &mut Criterion) {
    let num_gaussians = 20_000;
    let scene = scenes::room(num_gaussians, 30);
    let bit_map = scenes::mixed_widths(num_gaussians);
    let run = || compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default());
    let compact = run();
    let file = encode(&compact);
    assert_eq!(decode(&file, &DecodeLimits::default()).expect("a file just written"), compact);
    let mut group = criterion.benchmark_group("20000 Gaussians, 30 timesteps");
    group.sample_size(10);
    group.throughput(Throughput::Elements(num_gaussians as u64));
    group.bench_function("compress", |b| b.iter(run));
    group.bench_function("encode", |b| b.iter(|| encode(black_box(&compact))));
    group.bench_function("decode", |b| b.iter(|| decode(black_box(&file), &DecodeLimits::default())));
    group.bench_function("one timestep", |b| b.iter(|| compact.at(black_box(15))));
    group.finish();
}

criterion_group!(benches, keypoints, scene);
criterion_main!(benches);
