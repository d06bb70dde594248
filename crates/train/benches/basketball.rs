//! Rendering and whole training iterations on the basketball capture's initial cloud, filled up to 100,000 Gaussians
//! with slightly moved copies. Runs at a quarter of the images' size and at full size. The goal at a quarter is 60 ms
//! for forward and backward of five channels on two cores.

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use tcgs_capture::{Capture, Split};
use tcgs_core::{Image, PointCloud};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};
use tcgs_train::engine::cpu::{CpuEngine, drawn};
use tcgs_train::engine::{Engine, Step, Target};
use tcgs_train::{Dropout, Parameters, Phase, Schedule, State, TrainConfig};

const NUM_GAUSSIANS: usize = 100_000;

fn filled(mut cloud: PointCloud) -> PointCloud {
    let n = cloud.points.len();
    for i in 0..NUM_GAUSSIANS - n {
        let point = cloud.points[i * 17 % n];
        cloud.points.push(point.map(|x| x + 0.01));
        cloud.colors.push(cloud.colors[i * 17 % n]);
        cloud.foreground.push(cloud.foreground[i * 17 % n]);
    }
    cloud
}

fn basketball(criterion: &mut Criterion) {
    let path = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data/panoptic_basketball"));
    if !path.exists() {
        eprintln!("skipped: {} is absent", path.display());
        return;
    }
    let capture = Capture::open(path).expect("the capture opens");
    let cloud = filled(capture.point_cloud().expect("the cloud is read"));
    let config = TrainConfig::default();
    for downscale in [4, 1] {
        let views = capture.views(Split::Train, 0, downscale).expect("the images are read");
        let parameters = Parameters::from_cloud(&cloud, views.len(), config.mask.initial_logit);
        let mut engine = CpuEngine::new(State::new(parameters));
        let target = Target::new(&views[0], true);
        engine.begin([target.clone()].into(), None).expect("the CPU never fails");
        let drawn = drawn(engine.state().expect("the CPU does not fail"), &config.mask, true);
        let settings = RenderSettings::default();
        let (output, saved) = CpuRasterizer.forward(&drawn, &target.camera, &settings).expect("the CPU never fails");
        let seen = output.transmittance.iter().filter(|&&t| t < 0.1).count();
        assert!(2 * seen > output.transmittance.len(), "the cloud fills most of the image");
        let v_image = Image::filled(target.image.width, target.image.height, 5, 1.0);

        let mut group = criterion.benchmark_group(format!("{}x{}", target.image.width, target.image.height));
        group.sample_size(20);
        group.bench_function("forward", |b| {
            b.iter(|| {
                CpuRasterizer.forward(black_box(&drawn), &target.camera, &settings).expect("the CPU never fails")
            });
        });
        group.bench_function("forward + backward", |b| {
            b.iter(|| {
                let (_, saved) =
                    CpuRasterizer.forward(black_box(&drawn), &target.camera, &settings).expect("the CPU never fails");
                CpuRasterizer
                    .backward(&drawn, &target.camera, &settings, &saved, &v_image)
                    .expect("the CPU never fails")
            });
        });
        group.bench_function("backward", |b| {
            b.iter(|| {
                CpuRasterizer
                    .backward(black_box(&drawn), &target.camera, &settings, &saved, &v_image)
                    .expect("the CPU never fails")
            });
        });
        let schedule = Schedule::new(&config, 3.37);
        let step = Step {
            camera: 0,
            // Nothing moves, so that every iteration is the same work.
            rates: tcgs_train::Rates { mean: 0.0, ..schedule.rates(Phase::First, 0) },
            weights: &config.weights,
            mask: &config.mask,
            counts_gradients: true,
            dropout: Dropout::default(),
            moves_gaussians: true,
        };
        group.bench_function("losses and gradients of an iteration", |b| {
            b.iter(|| engine.forward_backward(black_box(&step)));
        });
        group.finish();
    }
}

criterion_group!(benches, basketball);
criterion_main!(benches);
