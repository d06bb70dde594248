//! Writes a long run as training leaves it: `T` timesteps of `N` Gaussians. A share of these moves while the rest
//! stands still to the bit. Measures the disk space of long runs, and the programs that read them.
//!
//! `cargo run --release -p tcgs-train --example long_run OUT [T=3000] [N=50000] [PERCENT=10] [whole]`
//!
//! With `whole` every checkpoint holds everything.

use std::path::Path;
use std::time::Instant;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tcgs_codec::{BitMap, CompressError};
use tcgs_core::PointCloud;
use tcgs_train::{Checkpoint, FakeQuantizers, Parameters, Run, TrainConfig};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let out = words.first().ok_or("expected the folder of the run to write")?;
    let number = |index: usize, usual: usize| words.get(index).map_or(Ok(usual), |word| word.parse::<usize>());
    let (num_timesteps, num_gaussians, percent) = (number(1, 3000)?, number(2, 50_000)?, number(3, 10)?);
    let whole = words.get(4).is_some_and(|word| word == "whole");

    let mut config = TrainConfig::default();
    config.data.end_frame = num_timesteps;
    let run = Run::create(Path::new(out), &config)?;
    let start = start(num_gaussians, percent)?;
    let num_moving = num_gaussians * percent / 100;
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let phases: Vec<f32> = (0..num_moving).map(|_| random.random_range(0.0..std::f32::consts::TAU)).collect();
    let (mut checkpoint, mut seconds) = (start.clone(), 0.0);
    for timestep in 0..num_timesteps {
        let parameters = &mut checkpoint.parameters;
        for (i, &phase) in phases.iter().enumerate() {
            let wave = (phase + 0.05 * timestep as f32).sin();
            let before = &start.parameters.gaussians;
            parameters.gaussians.means_mut()[i] = before.means()[i].map(|x| x + 0.3 * wave);
            parameters.gaussians.quats_mut()[i] = before.quats()[i].map(|x| x + 0.1 * wave);
            parameters.gaussians.colors_mut()[i] = before.colors()[i].map(|x| x + 0.05 * wave);
            parameters.mask_logits[i] = 2.0 + 0.5 * wave;
            checkpoint.optimizer.first.colors_mut()[i] = [wave; 3];
        }
        let begin = Instant::now();
        if whole {
            checkpoint.save(&run.checkpoint_path(timestep), timestep == 0)?;
        } else {
            run.save(timestep, &checkpoint)?;
        }
        seconds += begin.elapsed().as_secs_f64();
    }
    println!("{num_timesteps} timesteps written in {seconds:.1} s");
    Ok(())
}

/// A room of Gaussians quantised to eight bits; those in front of it are foreground.
fn start(num_gaussians: usize, percent: usize) -> Result<Checkpoint, CompressError> {
    let mut random = Pcg64Mcg::seed_from_u64(0);
    let mut point = |size: f32| [(); 3].map(|()| size * (2.0 * random.random::<f32>() - 1.0));
    let points = (0..num_gaussians).map(|_| point(2.0)).collect();
    let colors = (0..num_gaussians).map(|_| point(0.5).map(|x| x + 0.5)).collect();
    let foreground = (0..num_gaussians).map(|i| i < num_gaussians * percent / 100).collect();
    let mut parameters = Parameters::from_cloud(&PointCloud { points, colors, foreground }, 3, 2.0);
    for quat in parameters.gaussians.quats_mut() {
        let [x, y, z] = point(0.5);
        *quat = [(1.0 - x * x - y * y - z * z).sqrt(), x, y, z];
    }
    let quantizers = FakeQuantizers::new(BitMap::uniform(num_gaussians, 16, 8), &parameters.gaussians, true)?;
    let camera = tcgs_core::Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 500.0, 640, 480);
    let mut checkpoint = Checkpoint::of_parameters(parameters, &[camera]);
    checkpoint.optimizer = tcgs_train::Optimizer::new(&checkpoint.parameters, quantizers.quantizers.len());
    checkpoint.quantizers = Some(quantizers);
    Ok(checkpoint)
}
