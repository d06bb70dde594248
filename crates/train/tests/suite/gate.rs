//! The Gaussians that the gate trains, on synthetic captures whose Gaussians are known: a wall and an object before it,
//! on each engine.

use std::ops::{ControlFlow, Range};
use std::sync::Arc;
use std::thread;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tcgs_core::{Camera, Gaussians, View, activate};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};
use tcgs_train::engine::cpu::CpuEngine;
use tcgs_train::engine::{Engine, Target};
use tcgs_train::{Glimpse, Glimpsed, Parameters, Preset, State, TrainConfig, Trained, Trainer};

use crate::wall::{CENTER, add_ball, wall};

const WALL: [usize; 2] = [24, 16];
/// The object's Gaussians come after the wall's.
const OBJECT: Range<usize> = WALL[0] * WALL[1]..WALL[0] * WALL[1] + 27;

fn cameras() -> Vec<Camera> {
    [[-0.5, -0.3], [0.5, -0.2], [0.4, 0.3], [-0.4, 0.2]]
        .map(|[x, y]| Camera::look_at([x, y, -4.0], [0.0, 0.0, 0.0], [0.0, -1.0, 0.0], 150.0, 128, 80))
        .to_vec()
}

/// A wall at depth 0 with a pattern, and a ball of Gaussians before it.
fn scene(center: [f32; 3]) -> Gaussians {
    let mut columns = wall(WALL);
    add_ball(&mut columns, center, 3);
    Gaussians::from(columns)
}

/// Images of a scene, with noise of standard deviation `sigma` and rounded to 8 bits.
fn views(truth: &Gaussians, seed: u64, sigma: f32) -> Vec<View> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let drawn = activate(truth);
    let shoot = |(camera_id, camera): (usize, Camera)| {
        let Ok((output, _)) = CpuRasterizer.forward(&drawn, &camera, &RenderSettings::default());
        let mut image = output.image;
        for value in &mut image.data {
            let normal = (0..12).map(|_| random.random_range(0.0..1.0_f32)).sum::<f32>() - 6.0;
            *value = ((*value + sigma * normal).clamp(0.0, 1.0) * 255.0).round() / 255.0;
        }
        View { camera, image, segmentation: None, frame: 0, camera_id }
    };
    cameras().into_iter().enumerate().map(shoot).collect()
}

fn settings() -> TrainConfig {
    let mut config = TrainConfig::preset(Preset::Fast);
    config.schedule.first_iterations = 40;
    config.schedule.rest_iterations = 120;
    // The first timestep leaves the scene as it was given.
    config.densify.prune_error = 0.0;
    config.densify.dropout = 0.0;
    config.rates.color_damping = 0.0;
    config.quantize.enabled = false;
    config.densify.start = 10_000;
    config
}

/// Makes an engine.
type Make<'a> = &'a dyn Fn(State) -> Box<dyn Engine>;

/// The scenarios as tests on one engine.
macro_rules! tests_on {
    ($engine:ident, $($scenario:ident),+ $(,)?) => {
        mod $engine {
            $(#[test]
            fn $scenario() {
                super::$engine(&super::$scenario);
            })+
        }
    };
}

tests_on!(
    on_cpu,
    noise_wakes_nothing,
    images_of_another_size_wake_everything_once,
    a_still_object_wakes_when_it_starts_to_move_and_the_wall_sleeps_on,
    what_leaps_is_found_by_matches_and_not_by_gradients,
    a_lamp_wakes_all_that_it_lights,
    what_an_occluder_uncovers_wakes_though_nothing_moves_there_any_more,
    a_resumed_gate_goes_on_as_if_it_had_never_stopped,
    a_glimpse_shows_the_whole_scene_and_changes_nothing,
);
// The occluder and the lamp take minutes on a software GPU, and the choice of what wakes does not depend on the engine.
#[cfg(feature = "gpu")]
tests_on!(
    on_gpu,
    noise_wakes_nothing,
    a_still_object_wakes_when_it_starts_to_move_and_the_wall_sleeps_on,
    what_leaps_is_found_by_matches_and_not_by_gradients,
    a_resumed_gate_goes_on_as_if_it_had_never_stopped,
    a_glimpse_shows_the_whole_scene_and_changes_nothing,
);

fn on_cpu(scenario: &dyn Fn(Make<'_>)) {
    scenario(&|state| Box::new(CpuEngine::new(state)));
}

#[cfg(feature = "gpu")]
fn on_gpu(scenario: &dyn Fn(Make<'_>)) {
    use tcgs_train::engine::gpu::GpuEngine;
    let Some(gpu) = crate::support::gpu() else { return };
    scenario(&|state| Box::new(GpuEngine::new(&gpu, state)));
}

/// A run whose first timestep was trained on `truth`, starting from `start`.
fn trainer(make: Make<'_>, start: &Gaussians, truth: &Gaussians, sigma: f32) -> Trainer {
    trainer_with(&settings(), make, start, truth, sigma)
}

fn trainer_with(config: &TrainConfig, make: Make<'_>, start: &Gaussians, truth: &Gaussians, sigma: f32) -> Trainer {
    let n = start.num_gaussians();
    let parameters = Parameters {
        gaussians: start.clone(),
        mask_logits: vec![1.0; n],
        foreground: vec![true; n],
        camera_gains: vec![[0.0; 3]; 4],
        camera_offsets: vec![[0.0; 3]; 4],
    };
    let mut trainer = Trainer::from_parameters(config, parameters, &cameras(), make).unwrap();
    fit(&mut trainer, &views(truth, 1, sigma));
    trainer
}

/// Trains a timestep; returns its number of iterations.
fn fit(trainer: &mut Trainer, views: &[View]) -> usize {
    let mut iterations = 0;
    trainer
        .fit(views, &mut |_| {
            iterations += 1;
            ControlFlow::Continue(())
        })
        .unwrap();
    iterations
}

#[test]
fn an_engine_lets_go_of_the_images_at_the_end() {
    let targets: Arc<[Target]> = views(&scene(CENTER), 1, 0.0).iter().map(|view| Target::new(view, false)).collect();
    let mut trainer = trainer(&|state| Box::new(CpuEngine::new(state)), &scene(CENTER), &scene(CENTER), 0.0);
    let mut engine = CpuEngine::new(trainer.state().unwrap().clone());
    engine.begin(Arc::clone(&targets), None).unwrap();
    assert_eq!(Arc::strong_count(&targets), 2);
    engine.end();
    assert_eq!(Arc::strong_count(&targets), 1);
}

fn now(trainer: &mut Trainer) -> Gaussians {
    trainer.state().unwrap().parameters.gaussians.clone()
}

/// Indices of the Gaussians that differ in a bit.
fn changed(before: &Gaussians, after: &Gaussians) -> Vec<usize> {
    let differs = |i: &usize| {
        before.layout().columns().iter().any(|column| {
            let (a, k) = (column.attribute, column.components());
            before.values(a)[i * k..][..k] != after.values(a)[i * k..][..k]
        })
    };
    (0..before.num_gaussians()).filter(differs).collect()
}

fn images_of_another_size_wake_everything_once(make: Make<'_>) {
    let sigma = 2.0 / 255.0;
    let truth = scene(CENTER);
    let mut trainer = trainer(make, &truth, &truth, sigma);
    let halves = |seed| -> Vec<View> {
        let halved = |view: View| View { camera: view.camera.downscaled(2), image: view.image.downscaled(2), ..view };
        views(&truth, seed, sigma).into_iter().map(halved).collect()
    };
    fit(&mut trainer, &halves(2));
    assert_eq!(trainer.trained(), Trained::ALL);
    fit(&mut trainer, &halves(3));
    assert!(trainer.trained().gaussians < 0.5, "{:?}", trainer.trained());
}

fn noise_wakes_nothing(make: Make<'_>) {
    let sigma = 2.0 / 255.0;
    let truth = scene(CENTER);
    let mut trainer = trainer(make, &truth, &truth, sigma);
    let first = now(&mut trainer);
    for t in 1..8 {
        assert_eq!(fit(&mut trainer, &views(&truth, 10 + t, sigma)), 0, "iterations of timestep {t}");
    }
    assert_eq!(changed(&first, &now(&mut trainer)), [0_usize; 0]);
}

fn a_still_object_wakes_when_it_starts_to_move_and_the_wall_sleeps_on(make: Make<'_>) {
    let sigma = 1.0 / 255.0;
    let truth = scene(CENTER);
    let mut trainer = trainer(make, &truth, &truth, sigma);
    let first = now(&mut trainer);
    for t in 1..9_u8 {
        let by = f32::from(t.saturating_sub(4)) * 0.05;
        let truth = scene([CENTER[0] + by, CENTER[1], CENTER[2]]);
        let before = now(&mut trainer);
        let iterations = fit(&mut trainer, &views(&truth, u64::from(t) + 10, sigma));
        let moved = changed(&before, &now(&mut trainer));
        if t < 5 {
            assert_eq!((iterations, moved.len()), (0, 0), "timestep {t}");
        } else {
            let of_object = moved.iter().filter(|i| OBJECT.contains(*i)).count();
            assert!(of_object >= 25, "timestep {t}: {of_object} of the object move");
            assert!(moved.len() - of_object < OBJECT.start / 3, "timestep {t}: {} move", moved.len());
        }
    }
    let last = now(&mut trainer);
    let way = OBJECT.map(|i| last.means()[i][0] - first.means()[i][0]).sum::<f32>() / OBJECT.len() as f32;
    assert!((way - 0.2).abs() < 0.05, "the object moved by {way} of 0.2");
}

/// The object moves by twice its width between two frames, out of rest.
fn what_leaps_is_found_by_matches_and_not_by_gradients(make: Make<'_>) {
    let sigma = 1.0 / 255.0;
    let truth = scene(CENTER);
    let there = scene([CENTER[0] + 0.6, CENTER[1] + 0.1, CENTER[2] - 0.1]);
    let distance = |matches: bool| {
        let mut config = settings();
        config.births.enabled = false;
        config.gate.matches = matches;
        let mut trainer = trainer_with(&config, make, &truth, &truth, sigma);
        fit(&mut trainer, &views(&there, 11, sigma));
        let found = now(&mut trainer);
        let off = |i: usize| (0..3).map(|a| (found.means()[i][a] - there.means()[i][a]).powi(2)).sum::<f32>().sqrt();
        OBJECT.map(off).sum::<f32>() / OBJECT.len() as f32
    };
    let (with, without) = (distance(true), distance(false));
    assert!(with < 0.06 && without > 0.3, "{with} from where it is, and {without} without matches");
}

fn a_lamp_wakes_all_that_it_lights(make: Make<'_>) {
    let sigma = 1.0 / 255.0;
    let truth = scene(CENTER);
    let mut trainer = trainer(make, &truth, &truth, sigma);
    let mut lit = truth.clone();
    lit.colors_mut().iter_mut().for_each(|color| *color = color.map(|c| 1.2 * c));
    for t in 1..5 {
        assert_eq!(fit(&mut trainer, &views(&truth, 10 + t, sigma)), 0, "timestep {t}");
    }
    let before = now(&mut trainer);
    for t in 5..9 {
        let iterations = fit(&mut trainer, &views(&lit, 10 + t, sigma));
        assert!(t > 5 || iterations > 0);
    }
    let after = now(&mut trainer);
    let woken = changed(&before, &after).len();
    assert!(woken * 10 > 9 * before.num_gaussians(), "{woken} of {}", before.num_gaussians());
    let light = |gaussians: &Gaussians| gaussians.colors().as_flattened().iter().sum::<f32>();
    let gain = light(&after) / light(&before);
    assert!(gain > 1.05, "colours are {gain} times as bright");
}

fn what_an_occluder_uncovers_wakes_though_nothing_moves_there_any_more(make: Make<'_>) {
    let truth = scene(CENTER);
    // The object hides a part of the wall from all cameras; that part starts in a wrong colour.
    let hidden = |mean: &[f32; 3]| (mean[0] + 0.39).abs() < 0.16 && mean[1].abs() < 0.16;
    let mut start = truth.clone();
    let indices: Vec<usize> = (0..OBJECT.start).filter(|&i| hidden(&truth.means()[i])).collect();
    indices.iter().for_each(|&i| start.colors_mut()[i] = [0.0, 0.0, 1.0]);
    // No matches: constant velocity alone leaves an error when the object stops.
    let mut config = settings();
    config.gate.matches = false;
    // Too few to learn the colours while the object is on its way.
    config.schedule.rest_iterations = 60;
    let mut trainer = trainer_with(&config, make, &start, &truth, 0.0);
    let error = |gaussians: &Gaussians| {
        let of = |&i: &usize| (gaussians.colors()[i][2] - truth.colors()[i][2]).abs();
        indices.iter().map(of).sum::<f32>() / indices.len() as f32
    };
    let uncovered = now(&mut trainer);
    let before = error(&uncovered);
    let mut iterations = Vec::new();
    for t in 1..14_u8 {
        let by = 0.05 * f32::from(t.min(10));
        let truth = scene([CENTER[0] + by, CENTER[1], CENTER[2]]);
        iterations.push(fit(&mut trainer, &views(&truth, u64::from(t) + 10, 0.0)));
    }
    let after = error(&now(&mut trainer));
    assert!(iterations[10] > 0, "iterations {iterations:?}: work goes on where the error stayed");
    let woken = changed(&uncovered, &now(&mut trainer));
    let found = indices.iter().filter(|i| woken.contains(i)).count();
    assert!(indices.len() >= 4 && 10 * found >= 8 * indices.len(), "{found} of {} woke", indices.len());
    assert!(before > 0.3 && after < 0.9 * before, "{before} to {after} in {iterations:?}");
}

fn a_resumed_gate_goes_on_as_if_it_had_never_stopped(make: Make<'_>) {
    let (sigma, folder) = (1.0 / 255.0, tempfile::tempdir().unwrap());
    let shots: Vec<Vec<View>> = (0..4_u8)
        .map(|t| views(&scene([CENTER[0] + 0.04 * f32::from(t), CENTER[1], CENTER[2]]), u64::from(t), sigma))
        .collect();
    let whole = {
        let mut trainer = trainer(make, &scene(CENTER), &scene(CENTER), sigma);
        let run = tcgs_train::Run::create(&folder.path().join("run"), &settings()).unwrap();
        run.save(0, &trainer.checkpoint().unwrap()).unwrap();
        for (t, shot) in shots.iter().enumerate().skip(1) {
            fit(&mut trainer, shot);
            if t < 3 {
                run.save(t, &trainer.checkpoint().unwrap()).unwrap();
            }
        }
        trainer.checkpoint().unwrap()
    };
    let run = tcgs_train::Run::open(&folder.path().join("run")).unwrap();
    let mut resumed = run.resume_with(make).unwrap().unwrap();
    assert!(resumed.needs_recall());
    resumed.recall(&shots[2]).unwrap();
    assert!(!resumed.needs_recall());
    fit(&mut resumed, &shots[3]);
    assert_eq!(resumed.checkpoint().unwrap(), whole);
}

fn a_glimpse_shows_the_whole_scene_and_changes_nothing(make: Make<'_>) {
    let sigma = 1.0 / 255.0;
    let shots = [views(&scene([CENTER[0] + 0.05, CENTER[1], CENTER[2]]), 1, sigma)];
    let alone = {
        let mut trainer = trainer(make, &scene(CENTER), &scene(CENTER), sigma);
        for shot in &shots {
            fit(&mut trainer, shot);
        }
        trainer.checkpoint().unwrap()
    };
    let mut trainer = trainer(make, &scene(CENTER), &scene(CENTER), sigma);
    let glimpse = Arc::new(Glimpse::default());
    trainer.show_to(Arc::clone(&glimpse));
    assert!(glimpse.ask(Duration::from_millis(1)).is_none(), "between two timesteps");
    for (t, shot) in shots.iter().enumerate() {
        let before = now(&mut trainer);
        let (mut iterations, mut asking) = (0, Vec::<thread::JoinHandle<Option<Glimpsed>>>::new());
        let mut observe = |_: &tcgs_train::Progress| {
            iterations += 1;
            if iterations % 20 == 5 && asking.last().is_none_or(thread::JoinHandle::is_finished) {
                let glimpse = Arc::clone(&glimpse);
                asking.push(thread::spawn(move || glimpse.ask(Duration::from_secs(10))));
                // Until it has asked, most likely.
                thread::sleep(Duration::from_millis(50));
            }
            ControlFlow::Continue(())
        };
        trainer.fit(shot, &mut observe).unwrap();
        let seen: Vec<Glimpsed> = asking.into_iter().filter_map(|asking| asking.join().unwrap()).collect();
        let after = now(&mut trainer);
        let moved = changed(&before, &after);
        assert!(!moved.is_empty() && !seen.is_empty(), "timestep {t}: {iterations} iterations");
        for glimpsed in seen {
            assert_eq!(glimpsed.timestep, t + 1);
            assert!((1..=iterations).contains(&glimpsed.iterations), "{} of {iterations}", glimpsed.iterations);
            let gaussians = &glimpsed.parameters.gaussians;
            assert_eq!(gaussians.num_gaussians(), before.num_gaussians());
            // Locked Gaussians are unchanged, and moving ones are on their way.
            let on_their_way = changed(&before, gaussians);
            assert!(!on_their_way.is_empty() && on_their_way.iter().all(|i| moved.contains(i)), "timestep {t}");
        }
    }
    assert!(trainer.checkpoint().unwrap() == alone, "asking changed what is trained");
}
