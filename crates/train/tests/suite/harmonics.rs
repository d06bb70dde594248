//! Colours that depend on the direction of view: a wall with a sheen and an object before it, synthesised from known
//! harmonics.

use std::ops::{ControlFlow, Range};
use std::sync::Arc;

use tcgs_core::{Camera, Drawable, Gaussians, Layout, View};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};
use tcgs_train::engine::Engine;
use tcgs_train::engine::cpu::CpuEngine;
use tcgs_train::{Parameters, Preset, Run, State, TrainConfig, Trainer};

use crate::wall::{CENTER, add_ball, wall};

const WALL: [usize; 2] = [24, 16];
/// The object's Gaussians come after the wall's.
const OBJECT: Range<usize> = WALL[0] * WALL[1]..WALL[0] * WALL[1] + 27;

/// The last one is held out.
fn cameras() -> Vec<Camera> {
    [[-2.0, -0.8], [2.0, -0.7], [1.6, 0.9], [-1.7, 0.8], [0.0, -0.9], [0.1, 0.9], [-0.9, 0.1]]
        .map(|[x, y]| Camera::look_at([x, y, -3.5], [0.0, 0.0, 0.0], [0.0, -1.0, 0.0], 130.0, 128, 80))
        .to_vec()
}

/// A wall with a pattern and a sheen at depth 0, and a ball of Gaussians before it.
fn scene(center: [f32; 3], degree: usize) -> Gaussians {
    let mut columns = wall(WALL);
    add_ball(&mut columns, center, 3);
    let mut gaussians = Gaussians::from(columns).extended(&Layout::with_harmonics(degree));
    // One coefficient per band, for all Gaussians: the one along x, and the one of x² - y².
    for (band, coefficient) in gaussians.layout().harmonics().into_iter().zip([2, 4]) {
        let components = band.components();
        for row in gaussians.values_mut(band).chunks_exact_mut(components) {
            row[3 * coefficient..][..3].copy_from_slice(&[0.6, 0.3, -0.5]);
        }
    }
    gaussians
}

fn views(truth: &Gaussians) -> Vec<View> {
    let drawable = Drawable::new(truth);
    let shoot = |(camera_id, camera): (usize, Camera)| {
        let Ok((output, _)) = CpuRasterizer.forward(&drawable.seen_by(&camera), &camera, &RenderSettings::default());
        View { camera, image: output.image, segmentation: None, frame: 0, camera_id }
    };
    cameras().into_iter().enumerate().map(shoot).collect()
}

fn settings(degree: usize) -> TrainConfig {
    let mut config = TrainConfig::preset(Preset::Fast);
    config.schedule.first_iterations = 300;
    config.schedule.rest_iterations = 120;
    config.rates.harmonic = 5e-3;
    config.color.degree = degree;
    config.densify.prune_error = 0.0;
    config.densify.start = 10_000;
    config
}

/// A trainer that starts from a scene whose colours are the same from everywhere.
fn trainer(config: &TrainConfig, make: Make<'_>) -> Trainer {
    let gaussians = scene(CENTER, 0).extended(&Layout::with_harmonics(config.color.degree));
    let cameras = &cameras()[..6];
    let parameters = Parameters {
        mask_logits: vec![1.0; gaussians.num_gaussians()],
        foreground: (0..gaussians.num_gaussians()).map(|i| OBJECT.contains(&i)).collect(),
        camera_gains: vec![[0.0; 3]; cameras.len()],
        camera_offsets: vec![[0.0; 3]; cameras.len()],
        gaussians,
    };
    Trainer::from_parameters(config, parameters, cameras, make).unwrap()
}

type Make<'a> = &'a dyn Fn(State) -> Box<dyn Engine>;

fn on_cpu(state: State) -> Box<dyn Engine> {
    Box::new(CpuEngine::new(state))
}

fn fit(trainer: &mut Trainer, views: &[View]) {
    trainer.fit(&views[..6], &mut |_| ControlFlow::Continue(())).unwrap();
}

#[test]
fn what_depends_on_the_direction_is_learned_and_seen_from_elsewhere() {
    let views = views(&scene(CENTER, 2));
    let held_out = |degree| {
        let mut trainer = trainer(&settings(degree), &on_cpu);
        fit(&mut trainer, &views);
        trainer.mean_psnr(&views[6..]).unwrap()
    };
    let [plain, first, second] = [0, 1, 2].map(held_out);
    eprintln!("held out: {plain:.2} dB without harmonics, {first:.2} dB of degree 1, {second:.2} dB of degree 2");
    assert!(first > plain + 2.0 && second > first + 0.5);
}

#[test]
fn a_part_is_trained_among_the_colours_that_each_camera_sees() {
    a_part_is_trained(&on_cpu);
}

#[cfg(feature = "gpu")]
#[test]
fn a_part_is_trained_on_a_gpu_too() {
    use tcgs_train::engine::gpu::GpuEngine;
    let Some(gpu) = crate::support::gpu() else { return };
    a_part_is_trained(&|state| Box::new(GpuEngine::new(&gpu, state)));
}

fn a_part_is_trained(make: Make<'_>) {
    let config = settings(2);
    let mut trainer = trainer(&config, make);
    fit(&mut trainer, &views(&scene(CENTER, 2)));
    let before = trainer.state().unwrap().parameters.gaussians.clone();
    let moved = views(&scene([CENTER[0] + 0.06, CENTER[1], CENTER[2]], 2));
    fit(&mut trainer, &moved);
    let trained = trainer.trained();
    assert!(trained.gaussians < 0.5 && trained.tiles < 0.9, "{trained:?}");
    let after = trainer.state().unwrap().parameters.gaussians.clone();
    let still = (0..OBJECT.start).filter(|&i| before.means()[i] == after.means()[i]).count();
    assert!(still > OBJECT.start / 2, "{still} of the wall's Gaussians kept every bit");
    assert!(OBJECT.clone().any(|i| before.means()[i] != after.means()[i]));
    for band in after.layout().harmonics() {
        assert_eq!(before.values(band), after.values(band), "constant after the first timestep");
    }
    let psnr = trainer.mean_psnr(&moved[6..]).unwrap();
    assert!(psnr > 25.0, "{psnr} dB");
}

#[test]
fn a_run_with_harmonics_resumes_with_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = settings(1);
    (config.schedule.first_iterations, config.schedule.rest_iterations) = (40, 20);
    let run = Run::create(&folder.path().join("run"), &config).unwrap();
    let frames = [0.0, 0.05, 0.1].map(|x| views(&scene([CENTER[0] + x, CENTER[1], CENTER[2]], 1)));
    let mut trainer = trainer(&config, &on_cpu);
    for (timestep, views) in frames[..2].iter().enumerate() {
        fit(&mut trainer, views);
        run.save(timestep, &trainer.checkpoint().unwrap()).unwrap();
    }
    fit(&mut trainer, &frames[2]);
    let mut resumed = run.resume().unwrap().unwrap();
    resumed.recall(&frames[1][..6]).unwrap();
    fit(&mut resumed, &frames[2]);
    let (last, found) = (trainer.checkpoint().unwrap(), resumed.checkpoint().unwrap());
    assert!(found == last, "resuming changed something");
    let (gaussians, bands) = (&last.parameters.gaussians, last.parameters.gaussians.layout().harmonics());
    assert_eq!(Arc::clone(gaussians.layout()), Layout::with_harmonics(1));
    assert!(gaussians.values(bands[0]).iter().any(|&x| x != 0.0));
    let groups = last.quantizers.as_ref().unwrap().groups.iter();
    assert!(groups.clone().count() > 0 && groups.clone().all(|&(attribute, _)| attribute != bands[0]));
}
