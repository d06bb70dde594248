//! The training that fits into a time, by the speed of a short one.

use std::fs;
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use serde::{Deserialize, Serialize};
use tcgs_capture::{Capture, Split};
use tcgs_interchange::Existing;
use tcgs_pipeline::{Backend, Event, ReadyRun, fit, settings_for};
use tcgs_train::Preset;

use crate::interrupt;
use crate::output::show_time;

/// Share of the time that is left after preparing which training may take.
const SHARE_OF_TRAINING: f64 = 0.75;
/// Share of the whole time after which the refinement ends. The page takes the rest.
pub const END_OF_REFINEMENT: f64 = 0.95;
/// Shortest refinement, seconds.
pub const MIN_REFINEMENT_SECS: f64 = 20.0;
/// Widest training images, pixels: where the CPU computes, where a GPU does.
const MAX_WIDTH: [usize; 2] = [960, 1920];
/// Narrowest images to which a short time averages them down, pixels.
const MIN_WIDTH: usize = 200;
/// Iterations of the short training: of its first and of its second timestep.
const TRIAL: [usize; 2] = [40, 20];
/// Time of a training in proportion to that of the short one: Gaussians become more.
const GROWTH: f64 = 1.4;
/// Time of refinement and page in proportion to that of training: refinement alone 0.44 for 150 timesteps of 640x360,
/// 0.56 for 30; both 0.7 for the demo.
const AFTER_TRAINING: f64 = 0.55;
/// Fewest and most iterations, in proportion to those of preset fast.
const SHARES: [f64; 2] = [0.1, 2.5];
/// Share of the iterations of preset fast below which smaller images are better.
const FEW: f64 = 0.25;

/// A training that was chosen.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
pub struct Plan {
    /// Images are averaged over so many pixels in each direction.
    pub downscale: usize,
    /// Iterations of the first and of every later timestep.
    pub iterations: [usize; 2],
    /// Width and height of the training images, pixels.
    pub size: [usize; 2],
    pub num_timesteps: usize,
    /// Expected time of the training, seconds.
    pub seconds: f64,
    /// Time that training was to take, seconds; none without a limit.
    pub wanted_seconds: Option<f64>,
}

/// Speed of training on a machine.
#[derive(Clone, Copy, Debug)]
struct Speed {
    /// Seconds for an iteration of the first timestep.
    first: f64,
    /// Seconds for an iteration of a later timestep.
    rest: f64,
    /// Seconds for a later timestep, without its iterations.
    between: f64,
}

impl Plan {
    /// Chooses a training.
    ///
    /// - `scratch`: folder that is made and removed
    /// - `left`: time for training and refinement; none without a limit
    pub fn make(capture: &Capture, backend: &Backend, scratch: &Path, left: Option<Duration>) -> anyhow::Result<Self> {
        let usual = settings_for(Preset::Fast, capture);
        let (first_frame, num_timesteps) = (usual.data.first_frame, usual.data.end_frame - usual.data.first_frame);
        let cameras = capture.cameras(Split::Train, first_frame, 1)?;
        let [width, height] = cameras.first().map_or([1, 1], |(_, camera)| [camera.width, camera.height]);
        let max_width = MAX_WIDTH[usize::from(backend.gpu_info().is_some())];
        let usual = [usual.schedule.first_iterations, usual.schedule.rest_iterations];
        let wanted = left.map(|left| left.as_secs_f64() * SHARE_OF_TRAINING);
        let mut downscale = width.div_ceil(max_width).max(1);
        loop {
            let speed = Speed::measure(capture, backend, scratch, downscale)?;
            let share = wanted.map_or(1.0, |wanted| speed.share(usual, num_timesteps, wanted));
            if share < FEW && width / (2 * downscale) >= MIN_WIDTH {
                downscale *= 2;
                continue;
            }
            let share = share.clamp(SHARES[0], SHARES[1]);
            let iterations = usual.map(|count| ((count as f64 * share).round() as usize).max(1));
            let seconds = speed.seconds(iterations, num_timesteps);
            let size = [width / downscale, height / downscale];
            return Ok(Self { downscale, iterations, size, num_timesteps, seconds, wanted_seconds: wanted });
        }
    }

    /// Expected time of the steps after training, without a limit.
    pub fn after_training(&self) -> Duration {
        Duration::from_secs_f64(self.seconds * AFTER_TRAINING)
    }

    /// Options of `tcgs train`.
    pub fn options(&self) -> Vec<String> {
        let [first, rest] = self.iterations;
        let options = ["--preset", "fast", "--downscale", &self.downscale.to_string(), "--iterations"];
        options.into_iter().map(Into::into).chain([format!("{first},{rest}")]).collect()
    }

    /// The choice in words.
    pub fn lines(&self) -> Vec<String> {
        let ([width, height], [first, rest]) = (self.size, self.iterations);
        let expected = show_time(Duration::from_secs_f64(self.seconds));
        let mut lines = vec![format!(
            "training: {} timesteps of {width}x{height} pixels, {first} iterations at first and {rest} for each later \
             timestep, about {expected}",
            self.num_timesteps
        )];
        if let Some(wanted) = self.wanted_seconds.filter(|wanted| self.seconds > 1.2 * wanted) {
            let wanted = show_time(Duration::from_secs_f64(wanted));
            lines.push(format!(
                "this is the shortest training, and --time leaves {wanted} for it; --from and --to take a part of the \
                 videos"
            ));
        }
        lines
    }
}

impl Speed {
    /// Trains for a moment.
    fn measure(capture: &Capture, backend: &Backend, scratch: &Path, downscale: usize) -> anyhow::Result<Self> {
        let mut config = settings_for(Preset::Fast, capture);
        [config.schedule.first_iterations, config.schedule.rest_iterations] = TRIAL;
        config.data.downscale = downscale;
        config.data.end_frame = (config.data.first_frame + 2).min(config.data.end_frame);
        let ReadyRun { capture, run, trainer, folder } =
            ReadyRun::begin(scratch, Existing::Replace, &config, capture, None, backend)?;
        fit(&capture, &run, trainer, &mut |_: &Event| interrupt::asked())?;
        let seconds = run.metrics()?.map(|line| Ok(line?["seconds"].as_f64().unwrap_or(0.0)));
        let seconds: Vec<f64> = seconds.collect::<anyhow::Result<_>>()?;
        drop(folder);
        fs::remove_dir_all(scratch).with_context(|| format!("removing {}", scratch.display()))?;
        Ok(Self::of(seconds.first().copied().unwrap_or(0.0), seconds.get(1).copied()))
    }

    /// - `first`, `second`: times of the timesteps of the short training, seconds
    fn of(first: f64, second: Option<f64>) -> Self {
        /// Time of a later iteration in proportion to one of the first timestep: most Gaussians rest.
        const PART: f64 = 0.4;
        let first = first / TRIAL[0] as f64;
        let rest = PART * first;
        let between = second.map_or(0.0, |second| (second - rest * TRIAL[1] as f64).max(0.0));
        Self { first, rest, between }
    }

    fn seconds(self, [first, rest]: [usize; 2], num_timesteps: usize) -> f64 {
        let later = num_timesteps.saturating_sub(1) as f64;
        GROWTH * (self.first * first as f64 + later * (self.rest * rest as f64 + self.between))
    }

    /// The share of some iterations that takes a time.
    fn share(self, usual: [usize; 2], num_timesteps: usize, seconds: f64) -> f64 {
        let fixed = self.seconds([0, 0], num_timesteps);
        (seconds - fixed) / (self.seconds(usual, num_timesteps) - fixed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_of_the_iterations_takes_the_time() {
        let speed = Speed::of(2.0, Some(1.5));
        let usual = [2500, 300];
        for seconds in [100.0, 700.0] {
            let share = speed.share(usual, 10, seconds);
            let iterations = usual.map(|count| (count as f64 * share).round() as usize);
            let error = speed.seconds(iterations, 10) - seconds;
            assert!(error.abs() < 0.02 * seconds, "{iterations:?}: {error}");
        }
        assert!(speed.share(usual, 10, 1.0) < 0.0, "less than what passes between the timesteps");
        let one = Speed::of(2.0, None);
        assert!((one.seconds([40, 20], 1) - GROWTH * 2.0).abs() < 1e-9);
    }
}
