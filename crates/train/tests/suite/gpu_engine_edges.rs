//! The two engines side by side at odd sizes and numbers, and the failures of the GPU engine.

use crate::support::engines::{assert_same, bits, config, quantized, state, step, target, with_harmonics, with_past};
use crate::support::{Random, further_layout, gpu, relative_l2};
use tcgs_codec::{BitMap, CompressSettings, SceneInfo, compress};
use tcgs_core::{Attribute, Camera, DynamicGaussians, Gaussians, View};
use tcgs_render::gpu::{Gpu, GpuError, GpuRasterizer};
use tcgs_render::{CpuRasterizer, Rasterizer};
use tcgs_train::engine::cpu::CpuEngine;
use tcgs_train::engine::gpu::GpuEngine;
use tcgs_train::engine::{Engine, Target};
use tcgs_train::{LossTerms, Phase, RefineConfig, Refiner, Row, Schedule, State, TrainConfig, TrainError};

/// One iteration on each of `cameras`.
fn run(
    engine: &mut dyn Engine,
    targets: &[Target],
    cameras: &[usize],
    config: &TrainConfig,
    phase: Phase,
) -> Result<Vec<LossTerms>, TrainError> {
    engine.begin(targets.to_vec().into(), None)?;
    let schedule = Schedule::new(config, 2.0);
    for (iteration, &camera) in cameras.iter().enumerate() {
        let rates = schedule.rates(phase, iteration);
        engine.step(&step(camera, rates, config))?;
    }
    engine.wait()?;
    engine.losses()
}

fn compare(
    name: &str,
    gpu: &Gpu,
    start: &State,
    targets: &[Target],
    cameras: &[usize],
    config: &TrainConfig,
    phase: Phase,
) {
    let (mut a, mut b) = (CpuEngine::new(start.clone()), GpuEngine::new(gpu, start.clone()));
    let expected = run(&mut a, targets, cameras, config, phase).unwrap();
    let found = run(&mut b, targets, cameras, config, phase).unwrap();
    assert_same(name, config, (&expected, a.state().unwrap()), (&found, b.state().unwrap()));
}

#[test]
fn odd_sizes() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let sizes = [[1, 1], [17, 33], [48, 5]];
    for channels in [3, 5] {
        for (name, n, foreground) in
            [("one", 1, 0), ("two", 2, 0), ("mixed", 300, 3), ("front", 40, 1), ("back", 30, 0)]
        {
            let targets: Vec<Target> = sizes.iter().enumerate().map(|(i, &s)| target(s, channels, i as u64)).collect();
            let start = state(n, 3, |i| foreground > 0 && i % foreground == 0);
            let name = format!("{name}, {channels} channels");
            compare(&name, &gpu, &start, &targets, &[1, 0, 2, 1], &config, Phase::First);
            compare(&format!("{name}, later"), &gpu, &with_past(start), &targets, &[1, 0, 2, 1], &config, Phase::Rest);
        }
    }
}

#[test]
fn without_masks_and_with_one_camera() {
    let Some(gpu) = gpu() else { return };
    let config = TrainConfig::preset(tcgs_train::Preset::D3dgs);
    let targets = [target([40, 30], 5, 4)];
    let start = state(200, 1, |i| i % 2 == 0);
    compare("d3dgs", &gpu, &start, &targets, &[0; 4], &config, Phase::First);
    compare("d3dgs later", &gpu, &with_past(start), &targets, &[0; 4], &config, Phase::Rest);
}

#[test]
fn quantised_with_and_without_offsets() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let targets = [target([40, 30], 5, 4), target([33, 20], 5, 5)];
    for learned_offset in [true, false] {
        let start = quantized(state(150, 2, |i| i % 2 == 0), learned_offset);
        let name = format!("learned offsets: {learned_offset}");
        // One iteration only: in the next a code may be rounded the other way.
        compare(&name, &gpu, &start, &targets, &[1], &config, Phase::First);
        compare(&format!("{name}, later"), &gpu, &with_past(start), &targets, &[1], &config, Phase::Rest);
    }
}

#[test]
fn the_last_gaussians_can_stay_as_they_are() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let targets = [target([40, 30], 5, 4), target([33, 20], 5, 5)];
    for start in [state(150, 2, |i| i % 2 == 0), quantized(state(150, 2, |i| i % 2 == 0), true)] {
        let start = State { num_fixed: 30, ..start };
        compare("fixed", &gpu, &start, &targets, &[1], &config, Phase::First);
        let mut engine = GpuEngine::new(&gpu, start.clone());
        run(&mut engine, &targets, &[1, 0], &config, Phase::First).unwrap();
        let [before, after] = [&start, engine.state().unwrap()].map(|state| state.parameters.gaussians.means());
        assert_eq!(before[120..], after[120..]);
        assert_ne!(before[..120], after[..120]);
    }
}

#[test]
fn harmonics_of_every_degree() {
    let Some(gpu) = gpu() else { return };
    let mut config = config();
    config.rates.harmonic = 5e-3;
    for (degree, channels) in [(1, 3), (2, 5), (3, 3)] {
        let targets = [target([40, 30], channels, 4), target([33, 20], channels, 5)];
        let start = with_harmonics(state(150, 2, |i| i % 2 == 0), degree);
        let name = format!("degree {degree}");
        compare(&name, &gpu, &start, &targets, &[1, 0, 1], &config, Phase::First);
        compare(&format!("{name}, later"), &gpu, &with_past(start.clone()), &targets, &[1, 0], &config, Phase::Rest);
        let start = quantized(start, true);
        compare(&format!("{name}, quantised"), &gpu, &start, &targets, &[1], &config, Phase::First);

        let (mut engine, bands) =
            (GpuEngine::new(&gpu, start.clone()), start.parameters.gaussians.layout().harmonics());
        run(&mut engine, &targets, &[0, 1], &config, Phase::First).unwrap();
        for band in bands {
            let [before, after] = [&start, engine.state().unwrap()].map(|s| s.parameters.gaussians.values(band));
            assert!(
                before.iter().zip(after).filter(|(a, b)| a != b).count() > before.len() / 2,
                "degree {degree} rests"
            );
        }
        // Pictures have the colours that their camera sees.
        let mut cpu = CpuEngine::new(engine.state().unwrap().clone());
        for target in &targets {
            let [expected, found] = [&mut cpu as &mut dyn Engine, &mut engine]
                .map(|engine| engine.draw(&config.mask, &target.camera).unwrap().data);
            assert!(relative_l2(&found, &expected) < 1e-4, "degree {degree}");
        }
    }
}

#[test]
fn as_many_gaussians_in_another_order_are_others() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let targets = [target([40, 30], 5, 4)];
    let start = state(60, 1, |i| i < 30);
    let reversed: Vec<Row> = (0..60).rev().map(Row::Kept).collect();
    let mut engine = GpuEngine::new(&gpu, start.clone());
    let before = run(&mut engine, &targets, &[0], &config, Phase::First).unwrap();
    assert!(before[0].segmentation > 0.0);
    *engine.state_mut().unwrap() = start.clone();
    engine.state_mut().unwrap().gather(&reversed);
    let found = run(&mut engine, &targets, &[0], &config, Phase::First).unwrap();
    assert!((found[0].segmentation - before[0].segmentation).abs() < 1e-5, "{found:?} against {before:?}");
}

#[test]
fn a_lost_gpu_is_an_error() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let targets = [target([40, 30], 5, 4)];
    for when in ["before", "between", "in flight"] {
        let gpu = Gpu::open(tcgs_render::gpu::GpuChoice::Named(&gpu.info().name)).unwrap();
        let mut engine = GpuEngine::new(&gpu, state(60, 1, |i| i < 30));
        if when == "before" {
            gpu.device().destroy();
        } else {
            run(&mut engine, &targets, &[0; 3], &config, Phase::First).unwrap();
        }
        if when == "between" {
            gpu.device().destroy();
        }
        let schedule = Schedule::new(&config, 2.0);
        let mut steps = || {
            engine.begin(targets.to_vec().into(), None)?;
            for i in 0..200 {
                if i == 70 && when == "in flight" {
                    gpu.device().destroy();
                }
                let rates = schedule.rates(Phase::First, i);
                engine.step(&step(0, rates, &config))?;
            }
            engine.wait()
        };
        let error = steps().unwrap_err();
        eprintln!("{when}: {error}");
        assert!(matches!(error, TrainError::Gpu(GpuError::Lost(_))), "{error:?}");
        // Every later call fails as well.
        for error in [engine.wait().err(), engine.state().err(), engine.begin(targets.to_vec().into(), None).err()]
            .into_iter()
            .flatten()
        {
            assert!(matches!(error, TrainError::Gpu(GpuError::Lost(_))), "{error:?}");
        }
    }
}

/// A camera that sees the splats of [`state`] the larger the nearer it is.
fn target_at(distance: f64) -> Target {
    let mut target = target([64, 48], 5, 7);
    target.camera = Camera::look_at([0.0, 0.2, -distance], [0.0; 3], [0.0, -1.0, 0.0], 70.0, 64, 48);
    target
}

#[test]
fn iterations_beyond_the_room_are_repeated_bit_for_bit() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let targets = [100.0, 8.5, 5.0, 2.2].map(target_at);
    // The first one halts, then one in the middle of a report, and the last one.
    let mut cameras = vec![0; 140];
    for (from, camera) in [(70, 1), (127, 2), (139, 3)] {
        cameras[from] = camera;
    }
    let mut start = state(60, 4, |i| i % 2 == 0);
    start.parameters.gaussians.log_scales_mut().as_flattened_mut().iter_mut().for_each(|s| *s += 0.7);
    let start = quantized(with_past(start), true);
    let mut runs = [100_000, 1].map(|room| {
        let mut engine = GpuEngine::new(&gpu, start.clone()).with_room_for(room);
        let submissions = gpu.num_submissions();
        let losses = run(&mut engine, &targets, &cameras, &config, Phase::Rest).unwrap();
        assert!(engine.losses().unwrap().is_empty());
        (losses, bits(engine.state().unwrap()), gpu.num_submissions() - submissions)
    });
    let [(ample, ample_state, few), (tight, tight_state, many)] = runs.each_mut();
    eprintln!("{few} submissions with ample room, {many} without");
    assert!(*many > *few + 64 + 58 + 1, "nothing was repeated");
    assert_eq!((ample.len(), &*ample), (140, &*tight));
    assert!(ample_state == tight_state, "states differ");
}

#[test]
fn the_steady_loop_submits_once_an_iteration_and_reads_hardly_ever() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let targets = [target_at(4.0), target_at(5.0)];
    let mut engine = GpuEngine::new(&gpu, state(50, 2, |i| i < 30)).with_room_for(10_000);
    run(&mut engine, &targets, &[0], &config, Phase::First).unwrap();
    let compiled = gpu.num_compiled();
    let before = [gpu.num_submissions(), gpu.num_reads()];
    let rates = Schedule::new(&config, 2.0).rates(Phase::First, 0);
    for i in 0..100 {
        engine.step(&step(i % 2, rates, &config)).unwrap();
    }
    assert_eq!(gpu.num_submissions() - before[0], 100);
    assert!(gpu.num_reads() - before[1] <= 2, "{} reads", gpu.num_reads() - before[1]);
    engine.wait().unwrap();
    assert_eq!(engine.losses().unwrap().len(), 100);
    assert_eq!(gpu.num_compiled(), compiled);
}

#[test]
fn without_rates_nothing_moves_and_the_statistic_is_that_of_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let mut config = config();
    let r = &mut config.rates;
    for rate in [&mut r.mean, &mut r.quat, &mut r.log_scale, &mut r.logit_opacity, &mut r.color, &mut r.mask] {
        *rate = 0.0;
    }
    (r.camera, r.step) = (0.0, 0.0);
    let targets = [3.0, 4.0, 5.0].map(target_at);
    let start = quantized(state(400, 3, |i| i % 2 == 0), true);
    let cameras: Vec<usize> = (0..30).map(|i| i % 3).collect();
    let (mut cpu, mut on_gpu) = (CpuEngine::new(start.clone()), GpuEngine::new(&gpu, start.clone()));
    run(&mut cpu, &targets, &cameras, &config, Phase::First).unwrap();
    run(&mut on_gpu, &targets, &cameras, &config, Phase::First).unwrap();
    let [expected, found] = [cpu.state().unwrap(), on_gpu.state().unwrap()];
    let counts = [expected, found].map(|s| &s.statistic.count);
    let differing = counts[0].iter().zip(counts[1]).filter(|(a, b)| a != b).count();
    let means = [expected, found].map(|s| -> Vec<f32> {
        s.statistic.sum.iter().zip(&s.statistic.count).map(|(sum, &n)| sum / n.max(1) as f32).collect()
    });
    let error = relative_l2(&means[1], &means[0]);
    eprintln!("statistic: relative error {error:.1e}, {differing} counts differ");
    assert!(error < 1e-4 && differing <= 4, "{error}, {differing} counts");
    let steps = |s: &State| {
        let o = &s.optimizer;
        let others = [&o.mask, &o.gains, &o.offsets, &o.quantizer_steps, &o.quantizer_offsets];
        o.steps.iter().copied().chain(others.map(|m| m.step)).collect::<Vec<_>>()
    };
    assert_eq!(steps(found), steps(expected));
    for attribute in Attribute::BASE {
        let (f, s) = (found.parameters.gaussians.values(attribute), start.parameters.gaussians.values(attribute));
        assert!(relative_l2(f, s) < 1e-6, "{} moved", attribute.name());
    }
    assert_eq!(found.parameters.mask_logits, start.parameters.mask_logits);
    assert_eq!(found.quantizers, start.quantizers);
}

#[test]
fn what_does_not_fit_is_named() {
    let Some(gpu) = gpu() else { return };
    let mut engine = GpuEngine::new(&gpu, state(50, 1, |i| i < 30)).with_room_for(3_000_000_000);
    let error = run(&mut engine, &[target_at(4.0)], &[0], &config(), Phase::First).unwrap_err();
    eprintln!("{error}");
    assert!(matches!(error, TrainError::Gpu(GpuError::Memory { .. })), "{error:?}");
    // The GPU can still be used.
    let mut engine = GpuEngine::new(&gpu, state(50, 1, |i| i < 30));
    run(&mut engine, &[target_at(4.0)], &[0], &config(), Phase::First).unwrap();
}

#[test]
fn timesteps_of_other_sizes_and_channels_follow_each_other() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let start = with_past(state(80, 2, |i| i % 2 == 0));
    let (mut cpu, mut on_gpu) = (CpuEngine::new(start.clone()), GpuEngine::new(&gpu, start));
    for (timestep, (size, channels)) in
        [([40, 30], 5), ([40, 30], 3), ([23, 50], 5), ([90, 20], 5)].into_iter().enumerate()
    {
        let targets = [0, 1].map(|i| target([size[0] + 3 * i, size[1]], channels, (10 * timestep + i) as u64));
        let mut losses = Vec::new();
        for engine in [&mut cpu as &mut dyn Engine, &mut on_gpu] {
            let now = engine.state_mut().unwrap();
            // Resets the learned values, so that both engines start from the same.
            now.parameters = with_past(state(80, 2, |i| i % 2 == 0)).parameters;
            now.parameters.mask_logits[timestep] = -6.0;
            let past = now.past.as_mut().unwrap();
            past.previous.colors_mut().iter_mut().for_each(|color| color[timestep % 3] += 0.1);
            losses.push(run(engine, &targets, &[0, 1, 0], &config, Phase::Rest).unwrap());
        }
        for (f, e) in losses[1].iter().zip(&losses[0]) {
            for ((term, f, _), (_, e, _)) in f.terms(&config.weights).into_iter().zip(e.terms(&config.weights)) {
                assert!((f - e).abs() <= 2e-3 * e.abs() + 1e-5, "timestep {timestep}: {term}: {f} against {e}");
            }
        }
    }
}

/// `state` with the columns of [`further_layout`]. Their moments are not zero: Adam moves values without gradients.
fn with_further_columns(mut state: State) -> State {
    let mut random = Random::new(41);
    let (layout, n) = (further_layout(), state.parameters.num_gaussians());
    let mut gaussians = Gaussians::zeros_of(&layout, n);
    for column in layout.columns() {
        let values = gaussians.values_mut(column.attribute);
        match column.attribute {
            Attribute::Extra { .. } => values.fill_with(|| random.within(2.0)),
            known => values.copy_from_slice(state.parameters.gaussians.values(known)),
        }
    }
    state.parameters.gaussians = gaussians;
    State::new(state.parameters)
}

fn give_moments(state: &mut State) {
    let mut random = Random::new(43);
    let layout = further_layout();
    for attribute in layout.attributes().filter(|a| matches!(a, Attribute::Extra { .. })) {
        state.optimizer.first.values_mut(attribute).fill_with(|| random.within(1e-3));
        state.optimizer.second.values_mut(attribute).fill_with(|| 1e-6 + random.within(1e-7));
        state.optimizer.steps[attribute.index()] = 7;
    }
}

#[test]
fn columns_that_nothing_draws_are_carried() {
    let Some(gpu) = gpu() else { return };
    let config = config();
    let layout = further_layout();
    let targets = [target([40, 30], 5, 4), target([33, 20], 5, 5)];
    for is_quantized in [false, true] {
        let mut start = with_further_columns(state(150, 2, |i| i % 2 == 0));
        if is_quantized {
            start = quantized(start, true);
        }
        give_moments(&mut start);
        let cameras: &[usize] = if is_quantized { &[1] } else { &[1, 0, 1] };
        let name = format!("further columns, quantised: {is_quantized}");
        compare(&name, &gpu, &start, &targets, cameras, &config, Phase::First);
        compare(&format!("{name}, later"), &gpu, &with_past(start.clone()), &targets, cameras, &config, Phase::Rest);

        // If the further columns have no effect, the others are bit for bit the same as without them.
        let mut engine = GpuEngine::new(&gpu, start.clone());
        run(&mut engine, &targets, cameras, &config, Phase::First).unwrap();
        let found = engine.state().unwrap();
        for column in layout.columns() {
            let [before, after] = [&start, found].map(|s| s.parameters.gaussians.values(column.attribute));
            assert_ne!(before, after, "{} did not move", column.name);
        }
        if !is_quantized {
            let mut plain = GpuEngine::new(&gpu, state(150, 2, |i| i % 2 == 0));
            run(&mut plain, &targets, cameras, &config, Phase::First).unwrap();
            let plain = plain.state().unwrap();
            for attribute in Attribute::BASE {
                let [a, b] = [plain, found].map(|s| s.parameters.gaussians.values(attribute));
                assert_eq!(a, b, "{}", attribute.name());
            }
        }
    }
}

#[test]
fn refinement_on_the_gpu_follows_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let n = 300;
    let mut gaussians = state(n, 1, |_| true).parameters.gaussians;
    let mut floats = DynamicGaussians::default();
    for _ in 0..5 {
        gaussians.means_mut().iter_mut().step_by(3).for_each(|mean| mean[0] += 0.05);
        floats.push(gaussians.clone());
    }
    let (bits, info) = (BitMap::uniform(n, 12, 7), SceneInfo::of(&floats));
    let compact = compress(&floats, &bits, None, info, &CompressSettings::default()).unwrap();
    let views: Vec<View> = (0..2)
        .map(|seed| target([60, 45], 3, seed))
        .map(|t| View { camera: t.camera, image: t.image, segmentation: None, frame: 0, camera_id: 0 })
        .collect();
    fn refined<R: Rasterizer>(rasterizer: &R, mut refiner: Refiner, views: &[View]) -> (Vec<f64>, Vec<Vec<f32>>) {
        let step = |i: usize| refiner.step(rasterizer, i % 5, i % 2, &views[i % 2], i as f32 / 20.0);
        let losses = (0..20).map(step).collect::<Result<_, _>>().unwrap();
        let last = refiner.into_scene().at(2);
        (losses, Attribute::BASE.iter().map(|&attribute| last.values(attribute).to_vec()).collect())
    }
    let refiner = Refiner::new(compact, &[[[0.1; 3], [0.0; 3]]; 2], 1.0, RefineConfig::default());
    let (expected_losses, expected) = refined(&CpuRasterizer, refiner.clone(), &views);
    let (losses, found) = refined(&GpuRasterizer::new(&gpu), refiner, &views);
    for (found, expected) in losses.iter().zip(&expected_losses) {
        assert!((found - expected).abs() < 1e-3 * expected, "{losses:?} against {expected_losses:?}");
    }
    for ((found, expected), attribute) in found.iter().zip(&expected).zip(Attribute::BASE) {
        // A code between two may be rounded either way.
        assert!(relative_l2(found, expected) < 0.02, "{attribute:?}: {}", relative_l2(found, expected));
    }
}
