//! Measures the times of the bench.

use std::time::Instant;

use anyhow::bail;
use tcgs_core::{Activated, Camera, Image, activate};
use tcgs_pipeline::Backend;
use tcgs_render::{CpuRasterizer, Laps, PairCounts, RenderSettings, StageTimes};
use tcgs_train::engine::{Scenery, Step};
use tcgs_train::{Dropout, Phase, Rates, Schedule, State, TrainConfig};

use super::part::Part;
use super::scene::BenchScene;

/// Numbers of repetitions.
#[derive(Clone, Copy)]
pub struct Counts {
    /// Samples before the first that counts.
    pub warm_up: usize,
    /// Samples of stages.
    pub samples: usize,
    /// Consecutive iterations without a timer between them.
    pub in_a_row: usize,
}

/// Factor on the learning rates of a training. Gaussians hardly move, so the work is the same at every sample.
const RATE_SHARE: f32 = 1e-4;

/// Results of one scene.
pub struct Measured {
    /// Drawing three channels; nothing is kept for a gradient.
    pub forward: Samples,
    /// Drawing three channels and computing the gradient.
    pub forward_backward: Samples,
    /// One iteration of training.
    pub iteration: Samples,
    /// One iteration of the first timestep, before quantisation starts.
    pub first_iteration: Samples,
    /// One iteration that trains a part of the scene.
    pub part_iteration: Samples,
    /// Gaussians of this part.
    pub part_gaussians: usize,
    /// Share of the tiles of all views that this part draws.
    pub part_tiles: f64,
    /// Mean wall-clock time of an iteration among many, milliseconds.
    pub wall_ms: f64,
    /// Mean number of splat-tile pairs over the samples of `forward`.
    pub pairs: f64,
    /// Mean number of splats that reach a tile, over the same samples.
    pub splats: f64,
}

/// Times of repetitions of the same work; at least one.
pub struct Samples(Vec<StageTimes>);

/// Median and percentiles of a few times, milliseconds.
#[derive(Clone, Copy)]
pub struct Spread {
    pub median: f64,
    pub p10: f64,
    pub p90: f64,
}

impl Spread {
    fn of(times: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = times.collect();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let place = share * (sorted.len() - 1) as f64;
            let (low, high) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
            low + (high - low) * place.fract()
        };
        Self { median: at(0.5), p10: at(0.1), p90: at(0.9) }
    }
}

impl Samples {
    /// Times from the start of the first stage to the end of the last one.
    pub fn total(&self) -> Spread {
        Spread::of(self.0.iter().map(|times| times.total))
    }

    /// Times of every stage, in the order in which the stages run.
    pub fn stages(&self) -> Vec<(&'static str, Spread)> {
        let of_stage = |i: usize| Spread::of(self.0.iter().map(move |times| times.stages[i].1));
        self.0[0].stages.iter().enumerate().map(|(i, &(name, _))| (name, of_stage(i))).collect()
    }
}

/// Measures everything about one scene.
///
/// - `step`: called after each of the [`STEPS`] parts
pub fn measure(
    backend: &Backend,
    scene: &BenchScene,
    counts: Counts,
    step: &mut dyn FnMut(&'static str),
) -> anyhow::Result<Measured> {
    let drawn = activate(&scene.state.parameters.gaussians);
    let cameras = scene.cameras();
    let (forward, found) = render(backend, &drawn, &cameras, false, counts)?;
    step("forward");
    let (forward_backward, _) = render(backend, &drawn, &cameras, true, counts)?;
    step("forward and backward");
    let (iteration, wall_ms) = iterate(backend, Case::later(scene), counts)?;
    step("iterations");
    let (first_iteration, _) = iterate(backend, Case::first(scene), counts)?;
    step("first timestep");
    let part = Part::new(backend, scene)?;
    let (part_gaussians, part_tiles) = (part.scenery.num_active, part.tiles);
    let (part_iteration, _) = iterate(backend, Case::part(scene, part), counts)?;
    step("a part");
    let mean = |of: fn(&PairCounts) -> usize| found.iter().map(|c| of(c) as f64).sum::<f64>() / found.len() as f64;
    Ok(Measured {
        forward: Samples(forward),
        forward_backward: Samples(forward_backward),
        iteration: Samples(iteration),
        first_iteration: Samples(first_iteration),
        part_iteration: Samples(part_iteration),
        part_gaussians,
        part_tiles,
        wall_ms,
        pairs: mean(|c| c.pairs),
        splats: mean(|c| c.splats),
    })
}

/// Number of parts of [`measure`].
pub const STEPS: usize = 5;

/// Draws with one camera after another.
fn render(
    backend: &Backend,
    drawn: &Activated,
    cameras: &[Camera],
    backward: bool,
    counts: Counts,
) -> anyhow::Result<(Vec<StageTimes>, Vec<PairCounts>)> {
    let mut draw = drawing(backend, drawn, cameras, backward)?;
    let mut sample = |i: usize| draw(&cameras[i % cameras.len()]);
    for i in 0..counts.warm_up {
        sample(i)?;
    }
    let samples: Vec<_> = (0..counts.samples).map(sample).collect::<anyhow::Result<_>>()?;
    Ok(samples.into_iter().unzip())
}

/// Draws with one camera and measures the time.
type Drawing<'a> = Box<dyn FnMut(&Camera) -> anyhow::Result<(StageTimes, PairCounts)> + 'a>;

fn drawing<'a>(
    backend: &Backend,
    drawn: &'a Activated,
    cameras: &[Camera],
    backward: bool,
) -> anyhow::Result<Drawing<'a>> {
    match backend {
        #[cfg(feature = "gpu")]
        Backend::Gpu(gpu) => {
            let mut profiler = tcgs_render::gpu::RenderProfiler::new(gpu, drawn, cameras, backward)?;
            Ok(Box::new(move |camera| Ok((profiler.sample(camera)?, profiler.counts()?))))
        }
        Backend::Cpu => {
            let _ = cameras;
            Ok(Box::new(move |camera| Ok(render_on_cpu(drawn, camera, backward))))
        }
        _ => anyhow::bail!("the stages of drawing on this device cannot be timed"),
    }
}

fn render_on_cpu(drawn: &Activated, camera: &Camera, backward: bool) -> (StageTimes, PairCounts) {
    let ones = Image::filled(camera.width, camera.height, drawn.num_channels, 1.0);
    let settings = RenderSettings::default();
    let mut laps = Laps::begin();
    let (_, saved) = CpuRasterizer.timed_forward(drawn, camera, &settings, &mut laps);
    if backward {
        CpuRasterizer.timed_backward(drawn, camera, &settings, &saved, &ones, &mut laps);
    }
    (laps.finish(), saved.counts())
}

/// One kind of iteration.
struct Case<'a> {
    scene: &'a BenchScene,
    state: State,
    scenery: Option<Scenery>,
    /// Positions of the views to cycle through.
    cameras: Vec<usize>,
    phase: Phase,
}

impl<'a> Case<'a> {
    fn later(scene: &'a BenchScene) -> Self {
        let cameras = (0..scene.targets.len()).collect();
        Self { scene, state: scene.state.clone(), scenery: None, cameras, phase: Phase::Rest }
    }

    fn first(scene: &'a BenchScene) -> Self {
        Self { state: State::new(scene.state.parameters.clone()), phase: Phase::First, ..Self::later(scene) }
    }

    fn part(scene: &'a BenchScene, part: Part) -> Self {
        let Part { state, scenery, cameras, .. } = part;
        Self { scene, state, scenery: Some(scenery), cameras, phase: Phase::Rest }
    }
}

/// Trains with one camera after another; also returns the mean wall-clock time of many iterations, milliseconds.
fn iterate(backend: &Backend, case: Case<'_>, counts: Counts) -> anyhow::Result<(Vec<StageTimes>, f64)> {
    let Case { scene, state, scenery, cameras, phase } = case;
    if cameras.is_empty() {
        bail!("{}: no camera sees the Gaussians in the middle of the scene, expected at least one", scene.name);
    }
    let config = TrainConfig::default();
    let rates = Schedule::new(&config, 1.0).rates(phase, 0);
    let step = |i: usize| Step {
        camera: cameras[i % cameras.len()],
        rates: Rates {
            mean: rates.mean * RATE_SHARE,
            quat: rates.quat * RATE_SHARE,
            log_scale: rates.log_scale * RATE_SHARE,
            logit_opacity: rates.logit_opacity * RATE_SHARE,
            color: rates.color * RATE_SHARE,
            mask: rates.mask * RATE_SHARE,
            camera: rates.camera * RATE_SHARE,
            step: if scenery.is_some() { 0.0 } else { rates.step * RATE_SHARE },
            ..rates
        },
        weights: &config.weights,
        mask: &config.mask,
        counts_gradients: phase == Phase::First,
        dropout: Dropout::default(),
        moves_gaussians: true,
    };
    let mut engine = backend.engine(state);
    engine.begin(scene.targets.clone().into(), scenery.clone())?;
    for i in 0..counts.warm_up {
        engine.step(&step(i))?;
    }
    engine.wait()?;
    let begin = Instant::now();
    for i in 0..counts.in_a_row {
        engine.step(&step(i))?;
    }
    engine.wait()?;
    let wall_ms = begin.elapsed().as_secs_f64() * 1e3 / counts.in_a_row as f64;
    let times = (0..counts.samples).map(|i| engine.profile(&step(i))).collect::<Result<Vec<_>, _>>()?;
    // The time of a training that diverges is meaningless.
    for terms in engine.losses()? {
        if let Some((name, value, _)) = terms.terms(&config.weights).iter().find(|term| !term.1.is_finite()) {
            bail!("{}: the loss {name} became {value}, expected a number; its times mean nothing", scene.name);
        }
    }
    Ok((times, wall_ms))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_interpolated() {
        let spread = Spread::of((0..=10).rev().map(f64::from));
        assert_eq!((spread.median, spread.p10, spread.p90), (5.0, 1.0, 9.0));
        let spread = Spread::of([3.0, 1.0].into_iter());
        assert_eq!((spread.median, spread.p10), (2.0, 1.2));
        assert_eq!(Spread::of([7.0].into_iter()).p90, 7.0);
    }
}
