//! Keypoint selection, compression, encoding and decoding. Every bench checks its result first.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use tcgs_codec::{
    Archive, CompressSettings, DecodeLimits, Opening, Sampler, SceneInfo, Segment, compress, decode, encode,
    select_keypoints,
};

#[path = "../tests/suite/support/scenes.rs"]
mod scenes;

fn keypoints(criterion: &mut Criterion) {
    // The paper's length. A random walk needs all of its keypoints, the slowest case.
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
    let run = || tracks.iter().map(|t| select_keypoints(black_box(t), 30, 1e-5).expect("finite").len()).sum::<usize>();
    assert!((20_000..=30_000).contains(&run()), "{} keypoints", run());
    let mut group = criterion.benchmark_group("keypoints");
    group.throughput(Throughput::Elements(tracks.len() as u64));
    group.bench_function("1000 walks of 150 timesteps", |b| b.iter(run));
    group.finish();
}

/// Gaussians and timesteps of the scene: two segments.
const NUM_GAUSSIANS: usize = 20_000;
const NUM_TIMESTEPS: usize = 100;

/// Measures on one thread, and separately: bytes to keypoints, keypoints to floats. A rate of 60 million
/// Gaussian-timesteps per second for both is 300 timesteps of 200,000 Gaussians, ten times 30 per second.
fn scene(criterion: &mut Criterion) {
    let scene = scenes::room(NUM_GAUSSIANS, NUM_TIMESTEPS);
    let bit_map = scenes::mixed_widths(NUM_GAUSSIANS);
    let run = || {
        compress(&scene, &bit_map, None, SceneInfo::of(&scene), &CompressSettings::default()).expect("a legal scene")
    };
    let compact = run();
    let file = encode(&compact).expect("a legal scene");
    let limits = DecodeLimits::default();
    assert_eq!(decode(&file, &limits).expect("a file just written"), compact);
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let segments = || -> Vec<Segment> {
        let Ok(Opening::Ready(mut archive)) = Archive::open(&file, &limits) else { panic!("a file just written") };
        let mut archive = archive.open_cohort(0, &[]).expect("the only one");
        let layers = archive.num_layers();
        let bytes = |range: std::ops::Range<u64>| &file[range.start as usize..range.end as usize];
        archive.read_shared(bytes(archive.shared_range(layers))).expect("whole");
        let segment = |i| archive.read_segment(i, bytes(archive.segment_range(i, layers))).expect("whole");
        (0..archive.num_segments()).map(segment).collect()
    };
    let floats = |segments: &[Segment]| -> f32 {
        let all = |segment: &Segment| -> f32 {
            let mut sampler = Sampler::new(segment);
            segment.timesteps().map(|t| black_box(sampler.at(t)).means()[0][0]).sum()
        };
        segments.iter().map(all).sum()
    };
    let decoded = segments();
    let expected: f32 = decoded.iter().flat_map(Segment::timesteps).map(|t| compact.at(t).means()[0][0]).sum();
    assert!((floats(&decoded) - expected).abs() < 1e-3 * expected.abs());
    println!(
        "{} bytes; a segment holds {} bytes of keypoints, {} of floats",
        file.len(),
        decoded[0].bytes(),
        decoded[0].timesteps().len() * NUM_GAUSSIANS * 14 * 4
    );

    let mut group = criterion.benchmark_group(format!("{NUM_GAUSSIANS} Gaussians, {NUM_TIMESTEPS} timesteps"));
    group.sample_size(10);
    group.throughput(Throughput::Elements((NUM_GAUSSIANS * NUM_TIMESTEPS) as u64));
    group.bench_function("compress", |b| b.iter(run));
    group.bench_function("encode", |b| b.iter(|| encode(black_box(&compact))));
    group.bench_function("decode whole", |b| b.iter(|| decode(black_box(&file), &limits)));
    group.bench_function("bytes to keypoints, one thread", |b| b.iter(|| one_thread.install(segments)));
    group.bench_function("keypoints to floats, one thread", |b| b.iter(|| floats(black_box(&decoded))));
    group.throughput(Throughput::Elements(NUM_GAUSSIANS as u64));
    group.bench_function("one timestep alone", |b| b.iter(|| compact.at(black_box(15))));
    group.finish();
}

/// Measures the steps of decoding the file in `TCGS_FILE`, on one thread.
fn named_file(criterion: &mut Criterion) {
    let Some(path) = std::env::var_os("TCGS_FILE") else { return };
    let file = std::fs::read(path).expect("TCGS_FILE names a file");
    let limits = DecodeLimits::default();
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
    let bytes = |range: std::ops::Range<u64>| &file[range.start as usize..range.end as usize];
    let open = || {
        let Ok(Opening::Ready(mut archive)) = Archive::open(&file, &limits) else { panic!("not a whole file") };
        let mut archive = archive.open_cohort(0, &[]).expect("the only one");
        archive.read_shared(bytes(archive.shared_range(archive.num_layers()))).expect("whole");
        archive
    };
    let archive = one_thread.install(open);
    let first = bytes(archive.segment_range(0, archive.num_layers()));
    let read = || archive.read_segment(0, first).expect("whole");
    let segment = one_thread.install(read);
    let mut sampler = Sampler::new(&segment);
    let mut group = criterion.benchmark_group("file");
    group.bench_function("the shared part", |b| b.iter(|| one_thread.install(open)));
    group.bench_function(format!("first segment, {:?}", segment.timesteps()), |b| b.iter(|| one_thread.install(read)));
    group.bench_function("its keypoints to floats", |b| b.iter(|| Sampler::new(black_box(&segment))));
    group.bench_function("all its timesteps", |b| {
        b.iter(|| segment.timesteps().map(|t| sampler.at(black_box(t)).means()[0][0]).sum::<f32>());
    });
    group.finish();
}

criterion_group!(benches, keypoints, scene, named_file);
criterion_main!(benches);
