//! The timesteps of a run, one after another, each with its metrics and its checkpoint.

use std::collections::VecDeque;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Instant;

use serde_json::{Value, json};
use tcgs_capture::{Capture, CaptureError, Split};
use tcgs_core::View;
use tcgs_train::{Phase, Run, Schedule, Trainer};

use crate::observe::{TimestepSummary, tell};
use crate::{Event, Observer, PipelineError, Work};

/// Most points of a timestep's loss curve.
const MAX_CURVE_POINTS: usize = 100;
/// Iterations over which the losses of a timestep are averaged: single ones depend on their camera.
const AVERAGED_ITERATIONS: usize = 50;
/// A start from fewer points than this earns a warning. Density control splits existing Gaussians and does not reach
/// places far from every point. On the capture of `tcgs demo`, two timesteps trained from 8000 of its points reach 32.9
/// dB, from 1000 points 28.3 dB, and from 400 points 18.6 dB. From 200 or 66 points they reach less than 5.5 dB with
/// hardly a Gaussian left.
pub(super) const FEW_POINTS: usize = 1000;

/// Trains the timesteps that a run still lacks, and writes metrics and checkpoint of each. A separate thread prefetches
/// the images of the next timestep.
///
/// Metrics are written before the checkpoint, so that a timestep with a checkpoint has its metrics.
///
/// A stopped call leaves a whole run of the timesteps finished before. The unfinished timestep has no checkpoint, and
/// its iterations are lost. [`Run::resume_with`] goes on with the same bytes as an uninterrupted run.
///
/// - `trainer`: after the timesteps that the run has
///
/// # Errors
/// [`PipelineError::Stopped`] if the observer broke off; [`PipelineError`] if a frame cannot be read, the training
/// fails or the disk is full.
pub fn fit(
    capture: &Capture,
    run: &Run,
    mut trainer: Trainer,
    observer: &mut dyn Observer,
) -> Result<Trainer, PipelineError> {
    let config = run.config();
    let frames = config.data.first_frame + trainer.timesteps()..config.data.end_frame;
    if frames.is_empty() {
        return Ok(trainer);
    }
    if trainer.phase() == Phase::First && trainer.num_gaussians() < FEW_POINTS {
        tell(observer, Event::FewPoints { found: trainer.num_gaussians(), expected: FEW_POINTS })?;
    }
    let schedule = Schedule::new(config, 1.0);
    let iterations_of = |phase| schedule.iterations(phase);
    let num_steps = iterations_of(trainer.phase()) + (frames.len() - 1) * iterations_of(Phase::Rest);
    tell(observer, Event::Begun { work: Work::Training, num_steps })?;
    let mut num_done = 0;
    std::thread::scope(|scope| {
        // The channel has no buffer: the loader is one frame ahead, waiting to hand it over.
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
        for frame in frames {
            let loaded = receive.recv().map_err(|_| loader_ended(capture, frame))??;
            let timestep = trainer.timesteps();
            let steps = iterations_of(trainer.phase());
            let held_out = !loaded.test.is_empty();
            let judged = if held_out { &loaded.test } else { &loaded.train };
            tell(observer, Event::TimestepBegun { timestep, frame, judged, held_out })?;
            if trainer.needs_recall() {
                trainer.recall(&capture.views(Split::Train, frame - 1, downscale)?)?;
            }
            let begin = Instant::now();
            let mut record = Record::default();
            trainer.fit(&loaded.train, &mut |p| -> ControlFlow<()> {
                record.add(p.iterations, p.iteration, p.loss, &p.terms.terms(&config.weights));
                // The gate may give a timestep fewer iterations than `steps`; each then counts for more than one step.
                let num_done = num_done + steps * (p.iteration + 1) / p.iterations;
                observer.hear(&Event::Iteration { progress: p, num_done })
            })?;
            num_done += steps;
            let seconds = begin.elapsed().as_secs_f64();
            let psnr = trainer.mean_psnr(judged)?;
            let (num_gaussians, trained, loss) = (trainer.num_gaussians(), trainer.trained(), record.loss());
            let summary = TimestepSummary { timestep, frame, num_gaussians, trained, loss, psnr, held_out, seconds };
            run.append_metrics(&record.metrics(&summary))?;
            run.save(timestep, &trainer.checkpoint()?)?;
            tell(observer, Event::Timestep { summary: &summary, num_done })?;
        }
        Ok(trainer)
    })
}

/// The loader hands over every frame or an error, so this reports a panic there.
fn loader_ended(capture: &Capture, frame: usize) -> PipelineError {
    PipelineError::input(capture.name(), format!("no images of frame {frame}"), "a frame that can be decoded")
}

/// Views of one timestep, for training and for judging.
struct LoadedFrame {
    train: Arc<[View]>,
    test: Arc<[View]>,
}

impl LoadedFrame {
    fn load(capture: &Capture, frame: usize, downscale: usize) -> Result<Self, CaptureError> {
        let views = |split| capture.views(split, frame, downscale).map(Arc::from);
        Ok(Self { train: views(Split::Train)?, test: views(Split::Test)? })
    }
}

/// Losses of an iteration: their sum, and each alone.
type Losses = (f64, Vec<f64>);

/// Losses of one timestep as they come.
#[derive(Default)]
struct Record {
    iterations: usize,
    /// Number of iterations per point of the curve.
    stretch: usize,
    /// Last iteration and mean loss of each stretch.
    curve: Vec<(usize, f64)>,
    /// The current stretch: iterations, sum of losses.
    open: (usize, f64),
    /// Losses of the last iterations, the newest last.
    last: VecDeque<Losses>,
    names: Vec<&'static str>,
}

impl Record {
    /// - `most`: iterations of the timestep if it does not end early
    fn add(&mut self, most: usize, iteration: usize, loss: f64, terms: &[(&'static str, f64, f32)]) {
        self.iterations = iteration + 1;
        self.stretch = most.div_ceil(MAX_CURVE_POINTS);
        self.open = (self.open.0 + 1, self.open.1 + loss);
        if self.open.0 == self.stretch {
            self.close();
        }
        self.names = terms.iter().map(|&(name, _, _)| name).collect();
        self.last.push_back((loss, terms.iter().map(|&(_, value, _)| value).collect()));
        if self.last.len() > AVERAGED_ITERATIONS {
            self.last.pop_front();
        }
    }

    fn close(&mut self) {
        if self.open.0 > 0 {
            self.curve.push((self.iterations - 1, self.open.1 / self.open.0 as f64));
            self.open = (0, 0.0);
        }
    }

    /// Mean of a loss over the last iterations.
    fn mean(&self, loss: impl Fn(&Losses) -> f64) -> f64 {
        // A timestep without changes has no iterations and no losses.
        self.last.iter().map(loss).sum::<f64>() / self.last.len().max(1) as f64
    }

    fn loss(&self) -> f64 {
        self.mean(|last| last.0)
    }

    fn metrics(mut self, summary: &TimestepSummary) -> Value {
        self.close();
        let losses: serde_json::Map<String, Value> =
            self.names.iter().enumerate().map(|(i, &name)| (name.into(), json!(self.mean(|last| last.1[i])))).collect();
        json!({
            "timestep": summary.timestep,
            "frame": summary.frame,
            "psnr": summary.psnr,
            "seconds": summary.seconds,
            "iterations": self.iterations,
            "active_gaussians": summary.trained.gaussians,
            "active_tiles": summary.trained.tiles,
            "num_gaussians": summary.num_gaussians,
            "loss": summary.loss,
            "losses": losses,
            "loss_curve": self.curve,
        })
    }
}
