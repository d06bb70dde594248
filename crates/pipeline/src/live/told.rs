//! Reports of a training: its progress, and its curves.

use std::sync::Arc;
use std::time::Instant;

use serde_json::{Value, json};
use tcgs_core::View;
use tcgs_train::Trained;

use super::curve::Curve;
use crate::{Event, TimestepSummary};

/// The reports so far.
#[derive(Debug)]
pub(super) struct Told {
    pub has_ended: bool,
    begun: Instant,
    /// Timesteps that the run will have.
    num_timesteps: usize,
    num_gaussians: usize,
    /// The running timestep; none between two.
    pub running: Option<Running>,
    pub finished: Vec<Finished>,
    held_out: bool,
}

/// A timestep in training.
#[derive(Debug)]
pub(super) struct Running {
    pub timestep: usize,
    frame: usize,
    /// Computed iterations, and all iterations of the timestep if its losses go on falling.
    iterations: [usize; 2],
    trained: Option<Trained>,
    loss: Curve,
    /// Iteration and PSNR of the files made.
    pub psnr: Vec<(usize, f64)>,
    pub judged: Arc<[View]>,
}

/// A finished timestep.
#[derive(Clone, Copy, Debug)]
pub(super) struct Finished {
    psnr: f64,
    loss: f64,
    gaussians: f64,
    tiles: f64,
}

impl Told {
    /// The state before the training begins.
    ///
    /// - `num_timesteps`: number that the run will have
    pub fn new(num_timesteps: usize, num_gaussians: usize) -> Self {
        let begun = Instant::now();
        let (running, finished) = (None, Vec::new());
        Self { has_ended: false, begun, num_timesteps, num_gaussians, running, finished, held_out: false }
    }

    /// Records an already finished timestep, from a line of the run's `metrics.jsonl`.
    pub fn recall(&mut self, metrics: &Value) {
        self.finished.extend(Finished::of_metrics(metrics));
    }

    pub fn hear(&mut self, event: &Event) {
        match event {
            Event::TimestepBegun { timestep, frame, judged, held_out } => {
                self.held_out = *held_out;
                self.running = Some(Running {
                    timestep: *timestep,
                    frame: *frame,
                    iterations: [0; 2],
                    trained: None,
                    loss: Curve::default(),
                    psnr: Vec::new(),
                    judged: Arc::clone(judged),
                });
            }
            Event::Iteration { progress, .. } => {
                self.num_gaussians = progress.num_gaussians;
                if let Some(running) = &mut self.running {
                    running.iterations = [progress.iteration + 1, progress.iterations];
                    running.trained = Some(progress.trained);
                    running.loss.push(progress.loss);
                }
            }
            Event::Timestep { summary, .. } => {
                self.num_gaussians = summary.num_gaussians;
                self.running = None;
                self.finished.push(Finished::of(summary));
            }
            _ => {}
        }
    }

    pub fn end(&mut self) {
        (self.has_ended, self.running) = (true, None);
    }

    pub fn json(&self) -> Value {
        let running = self.running.as_ref().map(|running| {
            json!({
                "timestep": running.timestep,
                "frame": running.frame,
                "iterations": running.iterations[0],
                "of_iterations": running.iterations[1],
                "active_gaussians": running.trained.map(|trained| trained.gaussians),
                "active_tiles": running.trained.map(|trained| trained.tiles),
                "loss": running.loss.points(),
                "psnr": running.psnr,
                "psnr_camera": running.judged.first().map(|view| view.camera_id),
            })
        });
        let of_all = |value: fn(&Finished) -> f64| self.finished.iter().map(value).collect::<Vec<f64>>();
        json!({
            "has_ended": self.has_ended,
            "seconds": self.begun.elapsed().as_secs_f64(),
            "num_timesteps": self.num_timesteps,
            "num_gaussians": self.num_gaussians,
            "held_out": self.held_out,
            "running": running,
            "timesteps": {
                "psnr": of_all(|timestep| timestep.psnr),
                "loss": of_all(|timestep| timestep.loss),
                "active_gaussians": of_all(|timestep| timestep.gaussians),
                "active_tiles": of_all(|timestep| timestep.tiles),
            },
        })
    }
}

impl Finished {
    fn of(summary: &TimestepSummary) -> Self {
        let trained = summary.trained;
        Self { psnr: summary.psnr, loss: summary.loss, gaussians: trained.gaussians, tiles: trained.tiles }
    }

    /// - `metrics`: a line of the run's `metrics.jsonl`
    fn of_metrics(metrics: &Value) -> Option<Self> {
        let number = |key: &str| metrics[key].as_f64();
        // Without these keys the run trained everything.
        let share = |key: &str| number(key).unwrap_or(1.0);
        let (gaussians, tiles) = (share("active_gaussians"), share("active_tiles"));
        Some(Self { psnr: number("psnr")?, loss: number("loss")?, gaussians, tiles })
    }
}
