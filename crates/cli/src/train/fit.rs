//! The timesteps of a run, one after another, each with its metrics and its checkpoint.

use std::sync::mpsc::sync_channel;
use std::time::Instant;

use serde_json::{Value, json};
use tcgs_capture::{Capture, CaptureError, Split};
use tcgs_core::View;
use tcgs_train::{Run, Trainer};

use crate::progress::Progress;

/// Most points of a timestep's loss curve.
const MAX_CURVE_POINTS: usize = 100;
/// Iterations that the losses of a timestep are averaged over: single ones depend on their camera.
const AVERAGED_ITERATIONS: usize = 50;

/// Trains the timesteps that the run still lacks. Metrics are written before the checkpoint, so that
/// a timestep with a checkpoint has its metrics.
pub fn fit(capture: &Capture, run: &Run, mut trainer: Trainer) -> anyhow::Result<Trainer> {
    let config = run.config();
    let frames = config.data.first_frame + trainer.timesteps()..config.data.end_frame;
    if frames.is_empty() {
        return Ok(trainer);
    }
    let schedule = &config.schedule;
    let iterations_of = |t: usize| if t == 0 { schedule.first_iterations } else { schedule.rest_iterations };
    let first = trainer.timesteps();
    let total = (0..frames.len()).map(|i| iterations_of(first + i)).sum();
    let mut progress = Progress::new("training", total);
    std::thread::scope(|scope| {
        // Holds nothing: the loader is one frame ahead, waiting to hand it over.
        let (send, receive) = sync_channel(0);
        let downscale = config.data.downscale;
        let wanted = frames.clone();
        scope.spawn(move || {
            for frame in wanted {
                let loaded = LoadedFrame::load(capture, frame, downscale);
                let failed = loaded.is_err();
                if send.send(loaded).is_err() || failed {
                    break;
                }
            }
        });
        for (i, frame) in frames.clone().enumerate() {
            let loaded = receive.recv()??;
            let timestep = trainer.timesteps();
            let begin = Instant::now();
            let mut record = Record::new(iterations_of(timestep));
            trainer.fit(&loaded.train, &mut |p| {
                record.add(p.iteration, p.loss, &p.terms.terms(&config.weights));
                progress.step(|| format!("timestep {timestep}, {} Gaussians, loss {:.4}", p.num_gaussians, p.loss));
            })?;
            let seconds = begin.elapsed().as_secs_f64();
            let (views, name) =
                if loaded.test.is_empty() { (&loaded.train, "train PSNR") } else { (&loaded.test, "test PSNR") };
            let psnr = trainer.mean_psnr(views)?;
            let num_gaussians = trainer.num_gaussians();
            run.append_metrics(&record.metrics(timestep, frame, psnr, seconds, num_gaussians))?;
            run.save(timestep, &trainer.checkpoint()?)?;
            if i == 0 {
                progress.say(&format!("timestep   frame  Gaussians  {name}  seconds"))?;
            }
            let width = name.len();
            progress
                .say(&format!("{timestep:>8}  {frame:>6}  {num_gaussians:>9}  {psnr:>width$.2}  {seconds:>7.1}"))?;
        }
        anyhow::Ok(())
    })?;
    Ok(trainer)
}

/// What one timestep is trained on, and judged by.
struct LoadedFrame {
    train: Vec<View>,
    test: Vec<View>,
}

impl LoadedFrame {
    fn load(capture: &Capture, frame: usize, downscale: usize) -> Result<Self, CaptureError> {
        let views = |split| capture.views(split, frame, downscale);
        Ok(Self { train: views(Split::Train)?, test: views(Split::Test)? })
    }
}

/// Losses of one timestep as they come.
struct Record {
    iterations: usize,
    /// Last iteration and mean loss of each stretch.
    curve: Vec<(usize, f64)>,
    /// Of the stretch under way: iterations, sum of losses.
    stretch: (usize, f64),
    /// Sums over the last iterations.
    terms: Vec<(&'static str, f64)>,
    loss: f64,
}

impl Record {
    fn new(iterations: usize) -> Self {
        Self { iterations, curve: Vec::new(), stretch: (0, 0.0), terms: Vec::new(), loss: 0.0 }
    }

    fn add(&mut self, iteration: usize, loss: f64, terms: &[(&'static str, f64, f32)]) {
        self.stretch = (self.stretch.0 + 1, self.stretch.1 + loss);
        if self.stretch.0 == self.iterations.div_ceil(MAX_CURVE_POINTS) || iteration + 1 == self.iterations {
            self.curve.push((iteration, self.stretch.1 / self.stretch.0 as f64));
            self.stretch = (0, 0.0);
        }
        if iteration + AVERAGED_ITERATIONS >= self.iterations {
            self.loss += loss;
            if self.terms.is_empty() {
                self.terms = terms.iter().map(|&(name, _, _)| (name, 0.0)).collect();
            }
            for ((_, sum), (_, value, _)) in self.terms.iter_mut().zip(terms) {
                *sum += value;
            }
        }
    }

    fn metrics(&self, timestep: usize, frame: usize, psnr: f64, seconds: f64, num_gaussians: usize) -> Value {
        let averaged = self.iterations.min(AVERAGED_ITERATIONS) as f64;
        let losses: serde_json::Map<String, Value> =
            self.terms.iter().map(|&(name, sum)| (name.into(), json!(sum / averaged))).collect();
        json!({
            "timestep": timestep,
            "frame": frame,
            "psnr": psnr,
            "seconds": seconds,
            "num_gaussians": num_gaussians,
            "loss": self.loss / averaged,
            "losses": losses,
            "loss_curve": self.curve,
        })
    }
}
