//! Deaths on a synthetic capture whose Gaussians are known: a wall, a ball at rest behind it, and a ball that leaves
//! all views.

use std::ops::{ControlFlow, Range};
use std::path::Path;

use tcgs_core::{Camera, Gaussians, Life, View, activate};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};
use tcgs_train::engine::Engine;
use tcgs_train::engine::cpu::CpuEngine;
use tcgs_train::{Parameters, Preset, Run, State, TrainConfig, Trainer};

use crate::support::copy_folder;
use crate::wall::{add_ball, wall};

const WALL: [usize; 2] = [16, 14];
/// Rows of the first timestep, in this order. Gaussians at rest behind the wall may be uncovered.
const AT_REST: Range<usize> = 225..252;
const LEAVES: Range<usize> = 252..279;
const PATIENCE: usize = 4;
const NUM_TIMESTEPS: usize = 13;
/// Timestep at which another ball enters, if requested; others die at that timestep.
const ENTERS: usize = 8;

fn cameras() -> Vec<Camera> {
    [[-0.9, -0.5], [0.9, -0.4], [0.8, 0.5], [-0.8, 0.4], [0.0, -0.8], [0.1, 0.8]]
        .map(|[x, y]| Camera::look_at([x, y, -4.0], [0.0, 0.0, 0.0], [0.0, -1.0, 0.0], 110.0, 96, 64))
        .to_vec()
}

/// The scene at a timestep, with a ball that enters if requested.
fn scene(timestep: usize, enters: bool) -> Gaussians {
    let time = timestep as f32;
    let mut columns = wall(WALL);
    // The board at its back hides what is behind it.
    columns.means.push([0.0, 0.0, 0.25]);
    columns.quats.push([1.0, 0.0, 0.0, 0.0]);
    columns.log_scales.push([1.0, 1.0, -5.0]);
    columns.logit_opacities.push(12.0);
    columns.colors.push([0.3, 0.3, 0.3]);
    add_ball(&mut columns, [0.6, -0.7, 0.6], 3);
    add_ball(&mut columns, [-0.5, 0.3 + 0.2 * time, -1.0], 3);
    if enters && timestep >= ENTERS {
        add_ball(&mut columns, [-0.3, -0.3, -1.0], 3);
    }
    Gaussians::from(columns)
}

fn views(timestep: usize, enters: bool) -> Vec<View> {
    let drawn = activate(&scene(timestep, enters));
    let shoot = |(camera_id, camera): (usize, Camera)| {
        let Ok((output, _)) = CpuRasterizer.forward(&drawn, &camera, &RenderSettings::default());
        let mut image = output.image;
        image.data.iter_mut().for_each(|value| *value = (value.clamp(0.0, 1.0) * 255.0).round() / 255.0);
        View { camera, image, segmentation: None, frame: timestep, camera_id }
    };
    cameras().into_iter().enumerate().map(shoot).collect()
}

fn settings() -> TrainConfig {
    let mut config = TrainConfig::preset(Preset::Fast);
    // All cameras have the same exposure.
    config.rates.camera_centered = false;
    config.schedule.first_iterations = 60;
    config.schedule.rest_iterations = 120;
    (config.densify.prune_error, config.densify.dropout) = (0.0, 0.0);
    config.quantize.enabled = false;
    config.densify.start = 10_000;
    config.births.enabled = false;
    config.gate.matches = false;
    config.births.share = 0.1;
    config.deaths.patience = PATIENCE;
    // About one pixel of the six small images: a Gaussian just outside of one still reaches in.
    config.deaths.share = 3e-5;
    config
}

fn trainer(config: &TrainConfig, make: impl FnOnce(State) -> Box<dyn Engine>) -> Trainer {
    let gaussians = scene(0, false);
    let n = gaussians.num_gaussians();
    assert_eq!(n, LEAVES.end);
    let parameters = Parameters {
        gaussians,
        mask_logits: vec![1.0; n],
        foreground: vec![true; n],
        camera_gains: vec![[0.0; 3]; 6],
        camera_offsets: vec![[0.0; 3]; 6],
    };
    Trainer::from_parameters(config, parameters, &cameras(), make).unwrap()
}

fn on_cpu(config: &TrainConfig) -> Trainer {
    trainer(config, |state| Box::new(CpuEngine::new(state)))
}

fn fit(trainer: &mut Trainer, timesteps: Range<usize>, enters: bool, run: Option<&Run>) {
    for timestep in timesteps {
        trainer.fit(&views(timestep, enters), &mut |_| ControlFlow::Continue(())).unwrap();
        if let Some(run) = run {
            run.save(timestep, &trainer.checkpoint().unwrap()).unwrap();
        }
    }
}

/// Number of living Gaussians among some identities.
fn alive(trainer: &mut Trainer, ids: Range<usize>) -> usize {
    let ids_left = &trainer.state().unwrap().lifetimes.ids;
    ids_left.iter().filter(|&&id| ids.contains(&(id as usize))).count()
}

/// The ball that leaves dies, after a delay; visible Gaussians and those hidden from the start live on.
fn dies_as_expected(trainer: &mut Trainer) {
    fit(trainer, 0..PATIENCE + 1, false, None);
    assert_eq!(trainer.num_gaussians(), LEAVES.end, "nothing is unseen for long yet");
    fit(trainer, PATIENCE + 1..NUM_TIMESTEPS, false, None);
    assert_eq!(alive(trainer, 0..AT_REST.end), AT_REST.end);
    let left = alive(trainer, LEAVES);
    assert!(left <= 2, "{left} that left live on");
    assert_eq!(trainer.num_gaussians(), AT_REST.end + left);
    let left = &trainer.state().unwrap().lifetimes.lives[LEAVES];
    assert!(left.iter().all(|life| life.death == Life::NEVER || (life.death as usize).is_multiple_of(PATIENCE)));
}

#[test]
fn what_no_camera_sees_for_long_dies_and_what_may_be_uncovered_does_not() {
    dies_as_expected(&mut on_cpu(&settings()));
    let mut config = settings();
    config.deaths.patience = 0;
    let mut without = on_cpu(&config);
    fit(&mut without, 0..NUM_TIMESTEPS, false, None);
    assert_eq!(without.num_gaussians(), LEAVES.end);
}

#[test]
#[cfg(feature = "gpu")]
fn the_same_die_on_the_gpu() {
    use tcgs_train::engine::gpu::GpuEngine;
    let Some(gpu) = crate::support::gpu() else { return };
    dies_as_expected(&mut trainer(&settings(), |state| Box::new(GpuEngine::new(&gpu, state))));
}

/// Bytes of all checkpoints and of the state to resume from.
fn bytes(folder: &Path) -> Vec<Vec<u8>> {
    let run = Run::open(folder).unwrap();
    let paths = (0..NUM_TIMESTEPS).map(|t| run.checkpoint_path(t)).chain((0..2).map(|t| run.resume_path(t)));
    paths.map(|path| std::fs::read(path).unwrap()).collect()
}

#[test]
fn a_run_with_births_and_deaths_resumes_with_the_same_bytes_and_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = settings();
    config.births.enabled = true;
    config.mask.enabled = true;
    config.quantize.enabled = true;
    config.quantize.start = 0;
    let run = Run::create(&folder.path().join("whole"), &config).unwrap();
    let mut trainer = on_cpu(&config);
    // Before births and deaths, right after them, and later.
    let stops = [ENTERS, ENTERS + 1, NUM_TIMESTEPS - 1];
    let cut = |stopped: usize| folder.path().join(format!("cut{stopped}"));
    for timestep in 0..NUM_TIMESTEPS {
        if stops.contains(&timestep) {
            copy_folder(run.folder(), &cut(timestep));
        }
        fit(&mut trainer, timestep..timestep + 1, true, Some(&run));
    }
    let lives = run.lives(NUM_TIMESTEPS).unwrap().unwrap();
    assert_eq!(lives, trainer.state().unwrap().lifetimes.lives);
    let burials: Vec<usize> =
        (0..NUM_TIMESTEPS).filter(|&t| lives.iter().any(|life| life.death as usize == t)).collect();
    assert!(burials.contains(&ENTERS) && lives.iter().any(|life| life.birth as usize == ENTERS), "{lives:?}");

    for stopped in stops {
        let again = Run::open(&cut(stopped)).unwrap();
        let mut resumed = again.resume().unwrap().unwrap();
        resumed.recall(&views(stopped - 1, true)).unwrap();
        fit(&mut resumed, stopped..NUM_TIMESTEPS, true, Some(&again));
        assert!(bytes(again.folder()) == bytes(run.folder()), "stopped after {stopped}");
    }

    // A scene has all of them at every timestep, and the living ones as in its checkpoint.
    let trained = Run::open(run.folder()).unwrap().trained().unwrap();
    let first = run.checkpoint(0, None).unwrap();
    assert_eq!((trained.scene.num_gaussians(), &trained.lives), (lives.len(), &Some(lives.clone())));
    for timestep in 0..NUM_TIMESTEPS {
        let now = run.parameters(timestep, Some(&first).filter(|_| timestep > 0)).unwrap();
        let living = lives.living(timestep);
        assert!(trained.scene.at(timestep).select(&living).means() == now.gaussians.means(), "timestep {timestep}");
        assert_eq!(trained.mask_logits[timestep], now.mask_logits);
    }
    let (bit_map, _) = trained.quantization.unwrap();
    assert_eq!(bit_map.num_gaussians(), lives.len());
    let last = run.checkpoint(NUM_TIMESTEPS - 1, Some(&first)).unwrap();
    assert!(bit_map.select(&lives.living(NUM_TIMESTEPS - 1)) == last.quantizers.unwrap().bit_map);
}
