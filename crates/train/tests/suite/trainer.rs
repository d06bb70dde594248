//! Whole trainings of a tiny synthetic capture.

use std::ops::ControlFlow;
use std::sync::{Arc, OnceLock};

use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};
use tcgs_core::{Camera, Image, Sensitivity, View};
use tcgs_render::StageTimes;
use tcgs_train::engine::cpu::CpuEngine;
use tcgs_train::engine::{Engine, LookRenderer, Scenery, Step, Target};
use tcgs_train::{
    DensifyStep, GateRecord, GradientStatistic, LossTerms, MaskConfig, Parameters, Run, State, TrainConfig, TrainError,
    Trained, Trainer, densify, reset_opacities,
};
use tempfile::TempDir;

fn capture() -> &'static Capture {
    static CAPTURE: OnceLock<(TempDir, Capture)> = OnceLock::new();
    &CAPTURE.get_or_init(|| synthetic(4, 3000)).1
}

/// A tiny synthetic capture, and the folder that holds it.
pub fn synthetic(num_timesteps: usize, num_points: usize) -> (TempDir, Capture) {
    let folder = tempfile::tempdir().unwrap();
    let settings = SyntheticSettings {
        width: 64,
        height: 48,
        num_train_cameras: 5,
        num_test_cameras: 1,
        num_timesteps,
        num_points,
        ..SyntheticSettings::default()
    };
    write_synthetic(folder.path(), &settings).unwrap();
    let capture = Capture::open(folder.path()).unwrap();
    (folder, capture)
}

fn config() -> TrainConfig {
    let mut config = TrainConfig::default();
    config.schedule.first_iterations = 600;
    config.schedule.rest_iterations = 80;
    config
}

fn views(frame: usize) -> Vec<View> {
    capture().views(Split::Train, frame, 1).unwrap()
}

fn trainer(config: &TrainConfig) -> Trainer {
    let cameras: Vec<Camera> = views(0).into_iter().map(|v| v.camera).collect();
    Trainer::new(config, &capture().point_cloud().unwrap(), &cameras).unwrap()
}

#[test]
fn training_learns_the_scene_and_follows_it() {
    let mut config = config();
    // The losses are those of whole pictures.
    config.densify.dropout = 0.0;
    let mut trainer = trainer(&config);
    let before = trainer.mean_psnr(&views(0)).unwrap();
    let mut losses = Vec::new();
    trainer
        .fit(&views(0), &mut |p| {
            losses.push(p.terms.image);
            ControlFlow::Continue(())
        })
        .unwrap();
    let after = trainer.mean_psnr(&views(0)).unwrap();
    assert!(after > before + 8.0 && after > 25.0, "{before:.2} dB became {after:.2}");
    assert!(losses[losses.len() - 1] < 0.3 * losses[0]);
    let state = trainer.state().unwrap();
    let first = state.parameters.clone();
    assert!(state.quantizers.is_some(), "quantisation has not started");
    assert_ne!(first.num_gaussians(), 3000, "density did not adapt");
    assert_eq!(trainer.num_gaussians(), first.num_gaussians());

    for frame in 1..4 {
        trainer.fit(&views(frame), &mut |_| ControlFlow::Continue(())).unwrap();
    }
    let follows = trainer.mean_psnr(&views(3)).unwrap();
    let frozen = {
        let mut still = self::trainer(&config);
        still.fit(&views(0), &mut |_| ControlFlow::Continue(())).unwrap();
        still.mean_psnr(&views(3)).unwrap()
    };
    assert!(follows > frozen + 3.0, "{follows:.2} dB while following, {frozen:.2} standing still");
    // Columns frozen after the first timestep have not moved; varying ones have. The born are the last rows.
    let kept: Vec<usize> = (0..first.num_gaussians()).collect();
    let last = trainer.state().unwrap().parameters.select(&kept);
    assert_eq!(last.gaussians.log_scales(), first.gaussians.log_scales());
    assert_eq!(last.gaussians.logit_opacities(), first.gaussians.logit_opacities());
    assert_eq!(last.camera_gains, first.camera_gains);
    assert_ne!(last.gaussians.means(), first.gaussians.means());
    assert_ne!(last.gaussians.colors(), first.gaussians.colors());
}

#[test]
fn exposures_are_learned_fast_if_they_differ() {
    let mut views = views(0);
    for channel in 0..3 {
        views[0].image.plane_mut(channel).iter_mut().for_each(|value| *value *= 1.25);
    }
    // Brightness of a grey of 0.5 in the first camera, over that in the others.
    let learned = |is_fast: bool| {
        let mut config = config();
        config.schedule.first_iterations = 400;
        config.rates.camera_centered = is_fast;
        // Few iterations on small images: what few cameras change would leave more to learn.
        config.densify.prune_error /= 3.0;
        config.densify.dropout = 0.2;
        config.rates.color_damping = 0.0;
        let mut trainer = trainer(&config);
        trainer.fit(&views, &mut |_| ControlFlow::Continue(())).unwrap();
        let p = &trainer.state().unwrap().parameters;
        let grey = |camera: usize| 0.5 * p.camera_gains[camera][1].exp() + p.camera_offsets[camera][1];
        let others = (1..5).map(grey).sum::<f32>() / 4.0;
        grey(0) / others
    };
    let (fast, reference) = (learned(true), learned(false));
    assert!((fast - 1.25).abs() < 0.02 && reference < 1.22, "{fast}, {reference}");
}

#[test]
fn a_capture_without_masks_trains_and_stays_finite() {
    let mut cloud = capture().point_cloud().unwrap();
    cloud.foreground.fill(true);
    let without =
        |frame| -> Vec<View> { views(frame).into_iter().map(|view| View { segmentation: None, ..view }).collect() };
    let cameras: Vec<Camera> = views(0).into_iter().map(|v| v.camera).collect();
    let mut config = config();
    config.schedule.rest_iterations = 20;
    let mut trainer = Trainer::new(&config, &cloud, &cameras).unwrap();
    for frame in 0..2 {
        trainer
            .fit(&without(frame), &mut |p| {
                assert!(p.loss.is_finite());
                assert_eq!((p.terms.segmentation, p.terms.background), (0.0, 0.0));
                ControlFlow::Continue(())
            })
            .unwrap();
    }
    assert!(trainer.mean_psnr(&without(1)).unwrap() > 18.0);
    assert!(trainer.state().unwrap().parameters.gaussians.means().as_flattened().iter().all(|x| x.is_finite()));
}

#[test]
fn threads_and_resuming_do_not_change_a_bit() {
    let mut config = config();
    (config.schedule.first_iterations, config.schedule.rest_iterations) = (120, 15);
    // The interval is short enough for several densifications.
    config.densify.interval = 20;
    let on = |threads: usize| {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| {
            let mut trainer = trainer(&config);
            (0..4)
                .map(|frame| {
                    trainer.fit(&views(frame), &mut |_| ControlFlow::Continue(())).unwrap();
                    trainer.checkpoint().unwrap()
                })
                .collect::<Vec<_>>()
        })
    };
    let whole = on(1);
    assert!(on(3) == whole, "three threads differ from one");

    let folder = tempfile::tempdir().unwrap();
    let run = Run::create(folder.path(), &config).unwrap();
    for finished in 1..4 {
        run.save(finished - 1, &whole[finished - 1]).unwrap();
        let mut resumed = run.resume().unwrap().expect("a timestep is finished");
        assert_eq!(resumed.timesteps(), finished);
        resumed.recall(&views(finished - 1)).unwrap();
        resumed.fit(&views(finished), &mut |_| ControlFlow::Continue(())).unwrap();
        assert!(resumed.checkpoint().unwrap() == whole[finished], "resuming after {finished} timesteps differs");
    }
    run.save(3, &whole[3]).unwrap();
    assert_eq!(run.trained().unwrap().scene.num_timesteps(), 4);
}

/// The CPU engine with late losses, like those of a GPU.
#[derive(Debug)]
struct Late {
    cpu: CpuEngine,
    known: Vec<LossTerms>,
}

impl Late {
    fn boxed(state: State) -> Box<dyn Engine> {
        Box::new(Self { cpu: CpuEngine::new(state), known: Vec::new() })
    }
}

impl Engine for Late {
    fn name(&self) -> String {
        "late".into()
    }

    fn begin(&mut self, targets: Arc<[Target]>, scenery: Option<Scenery>) -> Result<(), TrainError> {
        self.cpu.begin(targets, scenery)
    }

    fn end(&mut self) {
        self.cpu.end();
    }

    fn step(&mut self, step: &Step<'_>) -> Result<(), TrainError> {
        self.cpu.step(step)
    }

    fn profile(&mut self, step: &Step<'_>) -> Result<StageTimes, TrainError> {
        self.cpu.profile(step)
    }

    fn losses(&mut self) -> Result<Vec<LossTerms>, TrainError> {
        Ok(std::mem::take(&mut self.known))
    }

    fn wait(&mut self) -> Result<(), TrainError> {
        self.known.extend(self.cpu.losses()?);
        Ok(())
    }

    fn state(&mut self) -> Result<&State, TrainError> {
        self.cpu.state()
    }

    fn state_mut(&mut self) -> Result<&mut State, TrainError> {
        self.cpu.state_mut()
    }

    fn look_renderer(&self) -> Arc<dyn LookRenderer> {
        self.cpu.look_renderer()
    }

    fn sensitivity(&mut self, cameras: &[Camera]) -> Result<Sensitivity, TrainError> {
        self.cpu.sensitivity(cameras)
    }

    fn draw(&mut self, mask: &MaskConfig, camera: &Camera) -> Result<Image, TrainError> {
        self.cpu.draw(mask, camera)
    }
}

#[test]
fn an_engine_may_run_behind() {
    let mut config = config();
    (config.schedule.first_iterations, config.schedule.rest_iterations) = (120, 15);
    config.densify.interval = 20;
    let cameras: Vec<Camera> = views(0).into_iter().map(|v| v.camera).collect();
    let cloud = capture().point_cloud().unwrap();
    let fit = |mut trainer: Trainer| {
        let mut told = Vec::new();
        for frame in 0..2 {
            let tell = &mut |p: &tcgs_train::Progress| {
                told.push((p.timestep, p.iteration, p.loss, p.num_gaussians));
                ControlFlow::Continue(())
            };
            trainer.fit(&views(frame), tell).unwrap();
        }
        (told, trainer.checkpoint().unwrap())
    };
    let (told, checkpoint) = fit(trainer(&config));
    assert_eq!(told.len(), 135);
    let behind = fit(Trainer::with_engine(&config, &cloud, &cameras, Late::boxed).unwrap());
    assert!(behind == (told, checkpoint));
}

#[test]
fn a_checkpoint_holds_a_record_of_the_gate_where_there_is_one() {
    let mut gated = config();
    (gated.schedule.first_iterations, gated.schedule.rest_iterations) = (60, 15);
    assert!(gated.gate.enabled);
    let mut ungated = gated.clone();
    ungated.gate.enabled = false;
    let cameras: Vec<Camera> = views(0).into_iter().map(|v| v.camera).collect();
    let cloud = capture().point_cloud().unwrap();
    let trained = |config: &TrainConfig| {
        let mut trainer = Trainer::with_engine(config, &cloud, &cameras, Late::boxed).unwrap();
        let checkpoints = [0, 1].map(|frame| {
            trainer.fit(&views(frame), &mut |_| ControlFlow::Continue(())).unwrap();
            trainer.checkpoint().unwrap()
        });
        let [first, last] = &checkpoints;
        let needs_recall = Trainer::resume(config, first, first, last, 2, Late::boxed).needs_recall();
        (trainer.trained(), needs_recall, checkpoints)
    };
    let (everything, needs_recall, checkpoints) = trained(&ungated);
    assert_eq!((everything, needs_recall), (Trained::ALL, false));
    assert!(checkpoints.iter().all(|checkpoint| checkpoint.gate == GateRecord::default()));
    let (_, needs_recall, checkpoints) = trained(&gated);
    assert!(needs_recall && checkpoints.iter().all(|checkpoint| checkpoint.gate != GateRecord::default()));
}

#[test]
fn a_trainer_that_is_stopped_gives_no_checkpoint_of_an_unfinished_timestep() {
    let mut config = config();
    (config.schedule.first_iterations, config.schedule.rest_iterations) = (20, 10);
    let mut trainer = trainer(&config);
    let mut told = 0;
    let error = trainer
        .fit(&views(0), &mut |_| {
            told += 1;
            if told == 7 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        })
        .unwrap_err();
    assert!(matches!(error, TrainError::Stopped { timestep: 0, iteration: 6 }), "{error}");
    assert_eq!(told, 7, "the observer is not asked again");
    assert_eq!(trainer.timesteps(), 0);
    assert!(matches!(trainer.checkpoint(), Err(TrainError::Input { .. })));
    let error = trainer.fit(&views(0), &mut |_| ControlFlow::Continue(())).unwrap_err().to_string();
    assert!(error.contains("ended half-way"), "{error}");
}

#[test]
fn what_cannot_be_trained_on_is_refused() {
    let mut trainer = trainer(&config());
    let mut broken = views(0);
    for view in &mut broken {
        view.image.data[7] = f32::NAN;
    }
    let error = trainer.fit(&broken, &mut |_| ControlFlow::Continue(())).unwrap_err();
    assert!(
        matches!(&error, TrainError::NotFinite { term, timestep: 0, iteration: 0, .. } if term == "image"),
        "{error}"
    );
    let error = trainer.fit(&views(0)[..3], &mut |_| ControlFlow::Continue(())).unwrap_err().to_string();
    assert_eq!(error, "training views of timestep 0: found 3, expected 5, as at the first");
    let nothing = tcgs_core::PointCloud::default();
    assert!(Trainer::new(&config(), &nothing, &[views(0)[0].camera.clone()]).is_err());
}

#[test]
fn rotations_take_the_form_of_files_before_they_are_quantised() {
    let cloud =
        tcgs_core::PointCloud { points: vec![[0.0; 3]; 2], colors: vec![[0.5; 3]; 2], foreground: vec![true; 2] };
    let mut state = State::new(Parameters::from_cloud(&cloud, 1, 1.0));
    state.parameters.gaussians.quats_mut().copy_from_slice(&[[-3.0, 0.0, 4.0, 0.0], [0.0, 0.0, 0.0, 2.0]]);
    state.canonicalize_quats();
    assert_eq!(state.parameters.gaussians.quats(), [[0.6, 0.0, -0.8, 0.0], [0.0, 0.0, 0.0, 1.0]]);
}

#[test]
fn density_adapts_by_the_rules() {
    let config = TrainConfig::default().densify;
    let cloud = tcgs_core::PointCloud {
        points: vec![[0.0; 3], [1.0; 3], [2.0; 3], [3.0; 3], [4.0; 3], [5.0; 3]],
        colors: vec![[0.1; 3], [0.2; 3], [0.3; 3], [0.4; 3], [0.5; 3], [0.6; 3]],
        foreground: vec![true, false, true, false, true, false],
    };
    let mut state = State::new(Parameters::from_cloud(&cloud, 1, 1.0));
    let g = &mut state.parameters.gaussians;
    // With a radius of 10: cloned up to a scale of 0.1, split above, removed above 1.
    g.log_scales_mut().copy_from_slice(&[0.05_f32, 0.5, 0.05, 0.05, 2.0, 0.5].map(|s| [s.ln(); 3]));
    g.logit_opacities_mut().copy_from_slice(&[0.0, 0.0, 0.0, -9.0, 0.0, 0.0]);
    state.statistic =
        GradientStatistic { sum: vec![3e-3, 3e-3, 1e-4, 0.0, 0.0, 3e-3], count: vec![10, 10, 10, 0, 3, 10] };
    // It is not trained, and is neither cloned nor split.
    state.num_fixed = 1;
    let step = DensifyStep { config: &config, scene_radius: 10.0, last: false, removes_large: true, seed: 1 };
    let done = densify(&mut state, &step);
    assert_eq!((done.cloned, done.split, done.removed), (1, 1, 2));
    let p = &state.parameters;
    // Kept: 0 and 2, the clone of 0, two children of 1, and the last. The transparent and the large one are gone.
    let colors: Vec<f32> = p.gaussians.colors().iter().map(|c| c[0]).collect();
    assert_eq!(colors, [0.1, 0.3, 0.1, 0.2, 0.2, 0.6]);
    assert_eq!(p.foreground, [true, true, true, false, false, false]);
    assert_eq!((state.num_fixed, p.gaussians.means()[5]), (1, [5.0; 3]));
    assert_eq!(p.gaussians.means()[2], p.gaussians.means()[0]);
    for child in [3, 4] {
        assert!((p.gaussians.log_scales()[child][0].exp() - 0.5 / 1.6).abs() < 1e-6);
        let moved = p.gaussians.means()[child].map(|x| x - 1.0);
        assert!(moved != [0.0; 3] && moved.iter().all(|m| m.abs() < 2.5), "{moved:?}");
    }
    assert_eq!(state.statistic, GradientStatistic::new(6));
    assert_eq!(state.optimizer.mask.first.len(), 6);
    reset_opacities(&mut state);
    let opacity = tcgs_core::sigmoid(state.parameters.gaussians.logit_opacities()[0]);
    assert!((opacity - 0.01).abs() < 1e-6);
}
