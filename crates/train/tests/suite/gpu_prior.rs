//! The losses on motion on the GPU against those on the CPU, and against another program's vectors.

use crate::golden::shared;
use crate::support::{Random, gpu, packed, relative_l2};
use tcgs_core::{Attribute, GaussianGrads, Gaussians};
use tcgs_interchange::NpzReader;
use tcgs_render::gpu::Gpu;
use tcgs_train::engine::cpu::{MotionPrior, PriorGrads};
use tcgs_train::engine::gpu::testing::{MotionPriorKernels, Packing, PriorBuffers, StepUniform, prior_rows};
use tcgs_train::{LossTerms, Neighbors, WeightConfig};

const ALL: WeightConfig = WeightConfig {
    rigid: 4.0,
    rot: 3.0,
    iso: 2.0,
    floor: 5.0,
    background: 20.0,
    soft_color: 0.01,
    stillness: 0.3,
    ..WeightConfig::NONE
};

/// Three timesteps: the first, the one before, and now.
struct Motion {
    is_foreground: Vec<bool>,
    first: Gaussians,
    previous: Gaussians,
    now: Gaussians,
}

impl Motion {
    /// - `moves`: size of the motion in scene units, and of the change of rotations
    fn random(is_foreground: Vec<bool>, moves: f32, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let n = is_foreground.len();
        let mut first = Gaussians::zeros(n);
        first.means_mut().fill_with(|| random.row(0.1));
        first.quats_mut().fill_with(|| random.row(1.0));
        first.colors_mut().fill_with(|| random.row(1.0));
        let mut moved = |from: &Gaussians| {
            let mut to = from.clone();
            to.means_mut().iter_mut().flatten().for_each(|x| *x += random.within(moves));
            to.quats_mut().iter_mut().flatten().for_each(|x| *x += random.within(moves));
            to.colors_mut().iter_mut().flatten().for_each(|x| *x += random.within(moves));
            to
        };
        let previous = moved(&first);
        let mut now = moved(&previous);
        now.colors_mut()[0] = previous.colors()[0];
        Self { is_foreground, first, previous, now }
    }

    fn neighbors(&self) -> Neighbors<f32> {
        Neighbors::new(self.first.means(), &self.is_foreground)
    }
}

/// Stillness of each Gaussian.
fn stillness(num_gaussians: usize) -> Vec<f32> {
    (0..num_gaussians).map(|i| (i % 5) as f32 / 4.0).collect()
}

fn cpu_losses(motion: &Motion, weights: &WeightConfig) -> (LossTerms, GaussianGrads) {
    let Motion { is_foreground, first, previous, now } = motion;
    let prior = MotionPrior::new(
        motion.neighbors().into(),
        is_foreground,
        first.means(),
        first.quats(),
        previous.means(),
        previous.quats(),
        previous.colors(),
    );
    let prior = prior.with_stillness(&stillness(now.num_gaussians()), previous.means(), previous.quats());
    let mut v = GaussianGrads::zeros(now.num_gaussians());
    let views = v.views_mut();
    let grads = PriorGrads { v_means: views.means, v_quats: views.quats, v_colors: views.colors };
    let losses = prior.losses(now.means(), now.quats(), now.colors(), weights, grads);
    (losses, v)
}

/// Losses and gradients; the latter are added `times` times to a gradient of `start`.
fn gpu_losses(gpu: &Gpu, motion: &Motion, weights: &WeightConfig, start: f32, times: usize) -> (LossTerms, Vec<f32>) {
    let n = motion.now.num_gaussians();
    let neighbors = motion.neighbors();
    let num_foreground = neighbors.foreground.len();
    let rows = prior_rows(n, num_foreground);
    let params = gpu.upload("params", &packed(&motion.now)).unwrap();
    let grads = gpu.upload("grads", &vec![start; 15 * n]).unwrap();
    let partials = gpu.upload("partials", &vec![f32::NAN; 8 * rows]).unwrap();
    let packing = Packing::new(motion.now.layout());
    let step = gpu.uniform("step", StepUniform::size(&packing)).unwrap();
    let settings = StepUniform {
        num_gaussians: n as u32,
        num_foreground: num_foreground as u32,
        per_node: neighbors.per_node as u32,
        num_background: (n - num_foreground) as u32,
        flags: StepUniform::HAS_PRIOR,
        weights: weights.values(),
        ..Default::default()
    };
    gpu.queue().write_buffer(&step, 0, &settings.bytes(&vec![[0.0; 4]; packing.num_groups()]));
    let buffers = PriorBuffers { params: &params, grads: &grads, step: &step, partials: &partials };
    let first = &motion.first;
    let kernels = MotionPriorKernels::new(gpu, &packing, &neighbors, first.means(), first.quats(), &buffers).unwrap();
    kernels.begin(gpu, &motion.previous, &stillness(n)).unwrap();
    for _ in 0..times {
        let mut encoder = gpu.encoder();
        kernels.record(&mut encoder.begin_compute_pass(&Default::default()));
        gpu.submit(encoder);
    }

    let partials: Vec<f32> = gpu.read(&partials, 8 * rows).unwrap();
    let sum = |column: usize, count: usize| {
        partials[column..].iter().step_by(8).map(|&x| f64::from(x)).sum::<f64>() / count.max(1) as f64
    };
    let num_edges = num_foreground * neighbors.per_node;
    let losses = LossTerms {
        rigid: sum(0, num_edges),
        rot: sum(1, num_edges),
        iso: sum(2, num_edges),
        floor: sum(3, num_foreground),
        background: sum(4, n - num_foreground),
        soft_color: sum(5, n),
        stillness: sum(6, n),
        ..LossTerms::default()
    };
    assert_eq!(sum(7, 1), 0.0);
    (losses, gpu.read(&grads, 15 * n).unwrap())
}

fn values(losses: &LossTerms) -> [f64; 7] {
    let LossTerms { rigid, rot, iso, floor, background, stillness, soft_color, .. } = *losses;
    [rigid, rot, iso, floor, background, soft_color, stillness]
}

/// Compares losses and gradients with the CPU's, the latter by attribute, and for foreground and background apart.
/// Returns the worst relative error of either.
fn compare(gpu: &Gpu, motion: &Motion, weights: &WeightConfig) -> [f64; 2] {
    let (expected_losses, v) = cpu_losses(motion, weights);
    let (losses, found) = gpu_losses(gpu, motion, weights, 0.0, 1);
    let error = |(a, b): (f64, f64)| if b == 0.0 { a.abs() } else { (a / b - 1.0).abs() };
    let of_losses = values(&losses).into_iter().zip(values(&expected_losses)).map(error).fold(0.0, f64::max);
    let expected = packed(&v);
    let n = v.num_gaussians();
    let mut of_gradients: f64 = 0.0;
    for is_foreground in [false, true] {
        for (first, components) in [(0, 3), (3, 4), (7, 3), (10, 1), (11, 3), (14, 1)] {
            let part = |all: &[f32]| -> Vec<f32> {
                let rows = all[first * n..(first + components) * n].chunks(components);
                let of_kind = rows.zip(&motion.is_foreground).filter(|&(_, &f)| f == is_foreground);
                of_kind.flat_map(|(row, _)| row).copied().collect()
            };
            of_gradients = of_gradients.max(relative_l2(&part(&found), &part(&expected)));
        }
    }
    [of_losses, of_gradients]
}

#[test]
fn losses_and_gradients_are_those_of_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let mixed = |n: usize, every: usize| (0..n).map(|i| i % every != 0).collect::<Vec<bool>>();
    for (name, is_foreground) in [
        ("foreground and background", mixed(1001, 3)),
        ("no background", vec![true; 700]),
        ("few foreground", (0..300).map(|i| i % 30 == 7).collect()),
        ("one foreground", (0..20).map(|i| i == 7).collect()),
        ("no foreground", vec![false; 270]),
        ("two neighbours", vec![true; 2]),
    ] {
        let motion = Motion::random(is_foreground, 0.05, 11);
        let errors = compare(&gpu, &motion, &ALL);
        eprintln!("{name}: {errors:?}");
        assert!(errors.iter().all(|&e| e < 1e-5), "{name}: losses, gradients differ by {errors:?}");
    }
}

/// The gradients of [`cpu_losses`] in double precision.
fn exact_gradients(motion: &Motion, weights: &WeightConfig) -> Vec<f32> {
    fn wide<const D: usize>(rows: &[[f32; D]]) -> Vec<[f64; D]> {
        rows.iter().map(|row| row.map(f64::from)).collect()
    }
    let Motion { is_foreground, first, previous, now } = motion;
    let Neighbors { foreground, per_node, indices, weights: falloffs, distances, .. } = motion.neighbors();
    let [falloffs, distances] = [falloffs, distances].map(|values| values.into_iter().map(f64::from).collect());
    let prior = MotionPrior::new(
        Neighbors::from_edges(foreground, per_node, indices, falloffs, distances).into(),
        is_foreground,
        &wide(first.means()),
        &wide(first.quats()),
        &wide(previous.means()),
        &wide(previous.quats()),
        &wide(previous.colors()),
    );
    let n = now.num_gaussians();
    let (mut v_means, mut v_quats, mut v_colors) = (vec![[0.0; 3]; n], vec![[0.0; 4]; n], vec![[0.0; 3]; n]);
    let grads = PriorGrads { v_means: &mut v_means, v_quats: &mut v_quats, v_colors: &mut v_colors };
    prior.losses(&wide(now.means()), &wide(now.quats()), &wide(now.colors()), weights, grads);
    v_means.as_flattened().iter().chain(v_quats.as_flattened()).map(|&v| v as f32).collect()
}

#[test]
fn rounding_costs_no_more_than_on_the_cpu() {
    let Some(gpu) = gpu() else { return };
    // Differences of nearly equal numbers: a small motion, far from the origin.
    for moves in [1e-2, 1e-3] {
        let mut motion = Motion::random(vec![true; 900], moves, 17);
        for gaussians in [&mut motion.first, &mut motion.previous, &mut motion.now] {
            gaussians.means_mut().iter_mut().flatten().for_each(|x| *x += 1.5);
        }
        for (name, weights) in [
            ("rigid", WeightConfig { rigid: 1.0, ..WeightConfig::NONE }),
            ("rot", WeightConfig { rot: 1.0, ..WeightConfig::NONE }),
            ("iso", WeightConfig { iso: 1.0, ..WeightConfig::NONE }),
        ] {
            let exact = exact_gradients(&motion, &weights);
            let (_, v) = cpu_losses(&motion, &weights);
            let of_cpu = relative_l2(&packed(&v)[..exact.len()], &exact);
            let (_, v) = gpu_losses(&gpu, &motion, &weights, 0.0, 1);
            let of_gpu = relative_l2(&v[..exact.len()], &exact);
            eprintln!("{name} at {moves}: CPU {of_cpu:.1e}, GPU {of_gpu:.1e}");
            assert!(of_gpu < 1.5 * of_cpu + 1e-6, "{name} at {moves}: CPU {of_cpu:.1e}, GPU {of_gpu:.1e}");
        }
    }
}

#[test]
fn a_weight_of_zero_leaves_a_loss_out() {
    let Some(gpu) = gpu() else { return };
    let motion = Motion::random((0..600).map(|i| i % 3 != 0).collect(), 0.05, 5);
    for weights in [
        WeightConfig { rigid: 0.0, rot: 0.0, ..ALL },
        WeightConfig { rigid: 0.0, rot: 0.0, iso: 0.0, ..ALL },
        WeightConfig { floor: 0.0, background: 0.0, soft_color: 0.0, stillness: 0.0, ..ALL },
        WeightConfig { stillness: 0.0, ..ALL },
        WeightConfig::NONE,
    ] {
        let errors = compare(&gpu, &motion, &weights);
        assert!(errors.iter().all(|&e| e < 1e-5), "{weights:?}: losses, gradients differ by {errors:?}");
    }
}

#[test]
fn gradients_add_to_those_that_stand_and_are_the_same_every_time() {
    let Some(gpu) = gpu() else { return };
    let motion = Motion::random((0..600).map(|i| i % 3 != 0).collect(), 0.05, 5);
    let (losses, once) = gpu_losses(&gpu, &motion, &ALL, 0.5, 1);
    assert_eq!((losses, once.clone()), gpu_losses(&gpu, &motion, &ALL, 0.5, 1));
    let (_, alone) = gpu_losses(&gpu, &motion, &ALL, 0.0, 1);
    let (_, twice) = gpu_losses(&gpu, &motion, &ALL, 0.5, 2);
    for i in 0..alone.len() {
        assert!((once[i] - (0.5 + alone[i])).abs() <= 1e-6, "{i}");
        assert!((twice[i] - (0.5 + 2.0 * alone[i])).abs() <= 1e-6, "{i}");
    }
}

#[test]
fn losses_and_gradients_equal_the_reference() {
    let Some(path) = shared("golden/motion_prior.npz") else { return };
    let Some(gpu) = gpu() else { return };
    let mut archive = NpzReader::open(&path).unwrap();
    let is_foreground: Vec<bool> = archive.array_of("is_fg").unwrap().values;
    let mut get = |name: &str| -> Vec<f32> { archive.array_of(name).unwrap().values };
    let colors = get("colors");
    let [first, previous, now] = ["t0", "t1", "t2"].map(|time| {
        let mut gaussians = Gaussians::zeros(is_foreground.len());
        gaussians.values_mut(Attribute::Mean).copy_from_slice(&get(&format!("means_{time}")));
        gaussians.values_mut(Attribute::Quat).copy_from_slice(&get(&format!("quats_{time}")));
        gaussians.values_mut(Attribute::Color).copy_from_slice(&colors);
        gaussians
    });
    let motion = Motion { is_foreground, first, previous, now };
    let n = motion.now.num_gaussians();
    for (i, name) in ["rigid", "rot", "iso", "floor", "bg"].into_iter().enumerate() {
        let on = |this: usize| f32::from(u8::from(i == this));
        let weights = WeightConfig {
            rigid: on(0),
            rot: on(1),
            iso: on(2),
            floor: on(3),
            background: on(4),
            soft_color: 0.0,
            ..WeightConfig::NONE
        };
        let (losses, v) = gpu_losses(&gpu, &motion, &weights, 0.0, 1);
        let expected: Vec<f64> = NpzReader::open(&path).unwrap().array_of(&format!("loss_{name}")).unwrap().values;
        assert!((values(&losses)[i] / expected[0] - 1.0).abs() < 1e-4, "{name}: {losses:?} against {expected:?}");
        for (found, key) in [(&v[..3 * n], format!("v_means_{name}")), (&v[3 * n..7 * n], format!("v_quats_{name}"))] {
            let error = relative_l2(found, &get(&key));
            // Tolerances are those of the CPU: the reference's neighbours are as rounded as ours.
            assert!(error < 2e-3, "{key}: relative L2 {error}");
        }
        let errors = compare(&gpu, &motion, &weights);
        eprintln!("{name}: against the CPU {errors:?}");
        assert!(errors.iter().all(|&e| e < 1e-5), "{name}: losses, gradients differ from the CPU's by {errors:?}");
    }
}
