//! The value of deaths in a scene where objects come and go: a room with still walls, and balls that cross it one after
//! another, each on its own path. Trains it with births, with and without deaths. Prints the number of Gaussians, the
//! time, and the PSNR on a held-out camera, as means over fifteen timesteps.
//!
//! `cargo run --release -p tcgs-train --example coming_and_going [T=90] [PATIENCE=20] [OUT]`
//!
//! The runs are left in `OUT` if it is given.

use std::ops::ControlFlow;
use std::path::Path;
use std::time::Instant;

use tcgs_core::{BaseColumns, Camera, Gaussians, View, activate};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};
use tcgs_train::engine::cpu::CpuEngine;
use tcgs_train::{Parameters, Preset, Run, TrainConfig, Trainer};

/// Timesteps between two balls, and a ball's displacement per timestep.
const INTERVAL: usize = 12;
const STEP: f32 = 0.3;
const TRAINING: usize = 8;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let number = |index: usize, usual: usize| words.get(index).map_or(Ok(usual), |word| word.parse::<usize>());
    let (num_timesteps, patience) = (number(0, 90)?, number(1, 20)?);
    println!("patience  timestep  Gaussians  held out, dB  seconds");
    for patience in [0, patience] {
        let mut config = TrainConfig::preset(Preset::Fast);
        (config.schedule.first_iterations, config.schedule.rest_iterations) = (200, 80);
        config.data.end_frame = num_timesteps;
        config.deaths.patience = patience;
        // The room is known, so nothing is cloned, split or pruned. Equal Gaussians give quantizers too narrow a range
        // for others.
        config.quantize.enabled = false;
        (config.densify.start, config.mask.prune_end) = (10_000, 0);
        let run = match words.get(2) {
            Some(out) => Some(Run::create(&Path::new(out).join(format!("patience{patience}")), &config)?),
            None => None,
        };
        let room = scene(0);
        let n = room.num_gaussians();
        let parameters = Parameters {
            gaussians: room,
            mask_logits: vec![1.0; n],
            foreground: vec![true; n],
            camera_gains: vec![[0.0; 3]; TRAINING],
            camera_offsets: vec![[0.0; 3]; TRAINING],
        };
        let make = |state| Box::new(CpuEngine::new(state)) as _;
        let mut trainer = Trainer::from_parameters(&config, parameters, &cameras()[..TRAINING], make)?;
        let (begin, mut sum, mut count) = (Instant::now(), 0.0, 0);
        for timestep in 0..num_timesteps {
            let views = views(timestep);
            trainer.fit(&views[..TRAINING], &mut |_| ControlFlow::Continue(()))?;
            (sum, count) = (sum + trainer.mean_psnr(&views[TRAINING..])?, count + 1);
            if let Some(run) = &run {
                run.save(timestep, &trainer.checkpoint()?)?;
            }
            if (timestep + 1) % 15 == 0 {
                let (num_gaussians, seconds) = (trainer.num_gaussians(), begin.elapsed().as_secs_f64());
                let mean = sum / f64::from(count);
                println!("{patience:8}  {timestep:8}  {num_gaussians:9}  {mean:12.2}  {seconds:7.1}");
                (sum, count) = (0.0, 0);
            }
        }
    }
    Ok(())
}

/// The last one is held out.
fn cameras() -> Vec<Camera> {
    [[-1.2, -0.6], [1.2, -0.5], [1.0, 0.5], [-1.0, 0.4], [0.0, -0.9], [0.1, 0.8], [-0.5, 0.0], [0.6, 0.1], [0.3, -0.3]]
        .map(|[x, y]| Camera::look_at([x, y, -4.0], [0.0, 0.0, 0.0], [0.0, -1.0, 0.0], 150.0, 160, 96))
        .to_vec()
}

/// A wall and a floor with patterns, and the balls that cross the room at a timestep.
fn scene(timestep: usize) -> Gaussians {
    let mut columns = BaseColumns::default();
    let mut add = |mean: [f32; 3], scale: f32, color: [f32; 3]| {
        columns.means.push(mean);
        columns.quats.push([1.0, 0.0, 0.0, 0.0]);
        columns.log_scales.push([scale.ln(); 3]);
        columns.logit_opacities.push(4.0);
        columns.colors.push(color);
    };
    for (i, j) in (-24..=24).flat_map(|i| (-12..=12).map(move |j| (i, j))) {
        let shade = 0.25 + 0.1 * (i * 7_i32 + j * 5).rem_euclid(4) as f32;
        add([0.14 * i as f32, 0.14 * j as f32, 1.0], 0.09, [shade, 0.9 * shade, 0.5]);
        add([0.14 * i as f32, 1.4, 0.14 * j as f32 - 1.0], 0.09, [0.4, shade, shade]);
    }
    for ball in 0..timestep / INTERVAL {
        let time = (timestep - (ball + 1) * INTERVAL) as f32;
        let side = if ball % 2 == 0 { 1.0 } else { -1.0 };
        let [height, depth] = [0.45 * (ball % 3) as f32 - 0.6, 0.2 * (ball % 4) as f32 - 0.5];
        let center = [side * (STEP * time - 2.6), height, depth];
        if center[0] * side > 3.0 {
            continue;
        }
        for i in 0..216_i32 {
            let at = [i % 6, i / 6 % 6, i / 36].map(|k| 0.07 * (k as f32 - 2.5));
            if at.iter().map(|x| x * x).sum::<f32>() < 0.05 {
                let stripe = 0.2 + 0.6 * f32::from(u8::from(i / 6 % 2 == 0));
                add([0, 1, 2].map(|d| center[d] + at[d]), 0.045, [0.9, stripe, 0.15 * (ball % 5) as f32]);
            }
        }
    }
    Gaussians::from(columns)
}

/// Images of all cameras, rounded to 8 bits.
fn views(timestep: usize) -> Vec<View> {
    let drawn = activate(&scene(timestep));
    let shoot = |(camera_id, camera): (usize, Camera)| {
        let Ok((output, _)) = CpuRasterizer.forward(&drawn, &camera, &RenderSettings::default());
        let mut image = output.image;
        image.data.iter_mut().for_each(|value| *value = (value.clamp(0.0, 1.0) * 255.0).round() / 255.0);
        View { camera, image, segmentation: None, frame: timestep, camera_id }
    };
    cameras().into_iter().enumerate().map(shoot).collect()
}
