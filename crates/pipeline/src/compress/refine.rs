//! Refinement: the codes of a compressed scene, and the light on it, are trained on the images of its capture before
//! the file is written.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use tcgs_capture::{Capture, Split};
use tcgs_codec::{CompactFile, CompactScene, CompressSettings, Light};
use tcgs_core::View;
use tcgs_render::device::GpuError;
use tcgs_render::{CpuRasterizer, Rasterizer};
use tcgs_train::{DeathConfig, Parameters, Preset, RefineConfig, Refiner, TrainConfig, refine_order, view_sparsity};

use super::parts::are_followed;
use super::rate::{Allowance, NUM_MEASURED, Visit, choose_quality, without_costly};
use super::{Errors, Judge, Pruned, PrunedScene, SearchResult, Target, search};
use crate::observe::tell;
use crate::{Backend, Event, Observer, OpenScene, PipelineError, Work};

/// How long a scene is refined.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum RefineBudget {
    /// So many images.
    Iterations(usize),
    /// About so long: a few iterations are timed first, and as many are done as then fit. The same number of iterations
    /// gives the same file.
    Time(Duration),
}

/// Iterations that later timesteps add to [`RefineBudget::of`], as a share of those that trained them.
const LATER_SHARE: f64 = 2.0 / 15.0;

impl RefineBudget {
    /// By the scene's training: as many iterations as its first timestep had, and 2/15 of those of every timestep. A
    /// scene whose training is not known is refined as one of preset `fast`.
    pub fn of(scene: &OpenScene) -> Self {
        let schedule =
            scene.run().map_or(TrainConfig::preset(Preset::Fast).schedule, |run| run.config().schedule.clone());
        let later = LATER_SHARE * (schedule.rest_iterations * scene.num_timesteps()) as f64;
        Self::Iterations(schedule.first_iterations + later.ceil() as usize)
    }
}

/// How a scene is refined.
#[derive(Clone, Debug)]
pub struct RefineOptions {
    /// Whose training images.
    pub capture: PathBuf,
    /// How long.
    pub budget: RefineBudget,
    /// Of the training.
    pub config: RefineConfig,
    /// Error that it is left to take back.
    pub allowance: Allowance,
}

impl RefineOptions {
    /// The [`min_share`](super::CompressOptions::min_share) of a refined scene: refinement makes up for Gaussians that
    /// are left out. Training, too, takes a Gaussian below this share for unseen.
    pub const MIN_SHARE: f32 = DeathConfig::ON.share;

    /// How a scene is refined where it can be and nothing else is asked for: on its capture, by [`RefineBudget::of`].
    ///
    /// - `capture`: none for the run's
    ///
    /// # Errors
    /// [`PipelineError`] that says why it cannot be refined: it has no capture, the capture is not there or lacks a
    /// frame, or the Gaussians of the scene change in number or order.
    pub fn usual(scene: &OpenScene, capture: Option<&Path>, allowance: Allowance) -> Result<Self, PipelineError> {
        let capture = capture.or(scene.capture()).map(Path::to_path_buf).ok_or_else(|| {
            PipelineError::input(scene.path.display(), "no capture of its own", "one with the images to refine on")
        })?;
        if !are_followed(scene)? {
            return Err(not_followed(scene));
        }
        let options = Self { capture, budget: RefineBudget::of(scene), config: RefineConfig::default(), allowance };
        Images::open(scene, &options)?;
        Ok(options)
    }
}

fn not_followed(scene: &OpenScene) -> PipelineError {
    let found = "Gaussians that change in number or order from timestep to timestep";
    PipelineError::input(scene.path.display(), found, "those of a run or of a params.npz to refine")
}

/// A refined scene.
#[derive(Clone, Debug)]
pub struct Refined {
    /// Bytes of the `.tcgs` file.
    pub file: Vec<u8>,
    /// The same as symbols.
    pub compact: CompactFile,
    /// Iterations that were done: fewer than were asked for if the observer broke off.
    pub iterations: usize,
    /// Quality that [`Allowance::rounding`] chose, if it did.
    pub quality: Option<f32>,
    /// Mean loss of the images over the first and over the last pass through the timesteps, or as much as there was of
    /// it.
    pub losses: [f64; 2],
}

/// Share of a budget of time in which iterations are timed.
const TIMED_SHARE: f64 = 0.05;

/// Compresses a scene as [`PrunedScene::compress`] does, with codes that were trained on the images of its capture. If
/// the observer breaks off after the first iteration, the file has what was trained by then.
///
/// - `scene`: of which `pruned` is
///
/// # Errors
/// [`PipelineError::Input`] if the Gaussians of the scene change in number or order; [`PipelineError`] if the capture
/// lacks a frame of the scene, an image cannot be read or the GPU fails.
pub fn refine(
    scene: &OpenScene,
    pruned: &PrunedScene<'_>,
    settings: &CompressSettings,
    options: &RefineOptions,
    backend: &Backend,
    observer: &mut dyn Observer,
) -> Result<Refined, PipelineError> {
    if matches!(pruned.content, Pruned::Parts(_)) {
        return Err(not_followed(scene));
    }
    let images = Images::open(scene, options)?;
    let num_iterations = images.num_iterations(pruned, settings, options, backend)?;
    let allowance = options.allowance.within(num_iterations);
    let Chosen { quality, pruned, settings } = images.choose(pruned, settings, allowance, observer)?;
    let (mut iterations, mut losses) = (0, [0.0; 2]);
    let mut change = |compact: CompactScene| {
        let refiner = images.refiner(compact, options.config)?;
        let refined = match backend {
            Backend::Cpu => images.refine(&CpuRasterizer, refiner, num_iterations, observer),
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => {
                images.refine(&tcgs_render::gpu::GpuRasterizer::new(gpu), refiner, num_iterations, observer)
            }
        };
        let (compact, light, done) = refined?;
        iterations = done.len();
        let count = images.of_a_pass().min(done.len());
        losses = [mean(&done[..count]), mean(&done[done.len() - count..])];
        Ok((compact, light))
    };
    let (compact, file) = pruned.compress_with(&settings, Errors::Measured, &mut change)?;
    Ok(Refined { file, compact, iterations, losses, quality })
}

/// Expected bytes of a file before refining, as a share of the bytes allowed afterwards: trained codes are a little
/// harder to predict.
const EXPECTED_SHARE: f64 = 0.92;
/// PSNR in dB that refining is expected to gain.
const EXPECTED_GAIN: f64 = 0.5;
/// Further tries come so close to what the last one says: below it as a share of the bytes, above it in dB.
const MARGIN_SHARE: f64 = 0.99;
const MARGIN_DB: f64 = 0.02;
/// A refined PSNR so close above a target is close enough: every try takes as long as a refinement.
const CLOSE_DB: f64 = 0.1;
/// Tries of [`refine_within`] at most.
const MAX_TRIES: usize = 4;

/// A scene that was refined to meet a target.
#[derive(Clone, Debug)]
pub struct RefinedWithin {
    /// Quality, size and PSNR before refining.
    pub before: SearchResult,
    /// Its result.
    pub refined: Refined,
    /// Mean PSNR in dB of the refined scene on the judge's images.
    pub psnr: f64,
}

/// [`refine`] so that the refined file meets a target: a quality is searched for what refining is expected to make of
/// it, and searched again for more or less if it makes something else.
///
/// - `settings`: those of quality 0
/// - `judge`: whose images the PSNR is of
///
/// # Errors
/// As [`search`] and [`refine`]; [`PipelineError::TargetBytes`] or [`PipelineError::TargetPsnr`] if none of four
/// refined files met the target.
#[allow(clippy::too_many_arguments, reason = "the arguments of search and of refine")]
pub fn refine_within(
    scene: &OpenScene,
    pruned: &PrunedScene<'_>,
    settings: &CompressSettings,
    target: Target,
    judge: &Judge,
    options: &RefineOptions,
    backend: &Backend,
    observer: &mut dyn Observer,
) -> Result<RefinedWithin, PipelineError> {
    let mut aim = match target {
        Target::Bytes(bytes) => Target::Bytes((EXPECTED_SHARE * bytes as f64) as u64),
        Target::Psnr(psnr) => Target::Psnr(psnr - EXPECTED_GAIN),
    };
    let images = Images::open(scene, options)?;
    let num_iterations = images.num_iterations(pruned, settings, options, backend)?;
    let allowance = Allowance { rounding: None, ..options.allowance.within(num_iterations) };
    let Chosen { pruned, .. } = &images.choose(pruned, settings, allowance, observer)?;
    let options = &RefineOptions { allowance: Allowance::NONE, ..options.clone() };
    let mut best: Option<RefinedWithin> = None;
    // The best of the tries: the fewest bytes, the highest PSNR.
    let (mut smallest, mut highest) = (u64::MAX, f64::MIN);
    let mut is_at_the_end = false;
    for _ in 0..MAX_TRIES {
        let before = match search(pruned, settings, aim, judge, observer) {
            // The coarsest or the finest codes there are may still do.
            Err(PipelineError::TargetBytes { smallest: coarsest, .. }) if !is_at_the_end => {
                (is_at_the_end, aim) = (true, Target::Bytes(coarsest));
                continue;
            }
            Err(PipelineError::TargetPsnr { best: finest, .. }) if !is_at_the_end => {
                (is_at_the_end, aim) = (true, Target::Psnr(finest));
                continue;
            }
            Err(PipelineError::TargetBytes { .. } | PipelineError::TargetPsnr { .. }) => break,
            found => found?,
        };
        let refined = refine(scene, pruned, &before.settings, options, backend, observer)?;
        let size = refined.file.len() as u64;
        let psnr = judge.psnr(&refined.compact)?;
        (smallest, highest) = (smallest.min(size), highest.max(psnr));
        let (is_met, is_close) = match target {
            // The first that fits has the expected size, within some percent.
            Target::Bytes(bytes) => (size <= bytes, true),
            Target::Psnr(wanted) => (psnr >= wanted, psnr <= wanted + CLOSE_DB),
        };
        let before_refining = (before.file.len() as f64, before.trial.psnr.unwrap_or(psnr));
        if is_met && best.as_ref().is_none_or(|best| size < best.refined.file.len() as u64) {
            best = Some(RefinedWithin { before, refined, psnr });
        }
        if (is_met && is_close) || is_at_the_end {
            break;
        }
        aim = match target {
            Target::Bytes(bytes) => {
                Target::Bytes((MARGIN_SHARE * before_refining.0 * bytes as f64 / size as f64) as u64)
            }
            Target::Psnr(wanted) => Target::Psnr(before_refining.1 + wanted - psnr + MARGIN_DB),
        };
    }
    best.ok_or_else(|| match target {
        Target::Bytes(target) => PipelineError::TargetBytes { target, smallest },
        Target::Psnr(target) => {
            // Rounded down, so that what is named can be reached.
            PipelineError::TargetPsnr { target, best: (100.0 * highest).floor() / 100.0, of: judge.of.clone() }
        }
    })
}

/// Visits of timesteps whose images choose quality and Gaussians.
const NUM_VISITS: usize = 12;
/// Pixels of these images together, about: 1.6 GB.
const MOST_PIXELS: usize = 1 << 27;

/// What is refined.
struct Chosen<'r, 'a> {
    /// If it was chosen.
    quality: Option<f32>,
    pruned: Cow<'r, PrunedScene<'a>>,
    settings: CompressSettings,
}

/// The images that a scene is refined on.
struct Images<'a> {
    capture: Capture,
    scene: &'a OpenScene,
    num_views: usize,
    /// `[cameras]` gain and offset of each.
    corrections: Vec<[[f32; 3]; 2]>,
}

fn mean(losses: &[f64]) -> f64 {
    losses.iter().sum::<f64>() / losses.len().max(1) as f64
}

impl<'a> Images<'a> {
    fn open(scene: &'a OpenScene, options: &RefineOptions) -> Result<Self, PipelineError> {
        let capture = scene.open_capture(&options.capture)?;
        let num_timesteps = scene.num_timesteps();
        // The last frame is looked for before the first is decoded.
        capture.cameras(Split::Train, scene.first_frame + num_timesteps - 1, scene.downscale)?;
        let num_views = capture.cameras(Split::Train, scene.first_frame, scene.downscale)?.len();
        if num_views == 0 {
            return Err(PipelineError::NoCameras { path: options.capture.clone(), split: Split::Train });
        }
        let parameters = scene.first_checkpoint().map(|first| &first.parameters);
        let learned = parameters.filter(|p| p.camera_gains.len() == num_views);
        let corrections = learned.map_or_else(|| vec![[[0.0; 3]; 2]; num_views], Parameters::corrections);
        Ok(Self { capture, scene, num_views, corrections })
    }

    /// A refinement on these images.
    fn refiner(&self, compact: CompactScene, config: RefineConfig) -> Result<Refiner, PipelineError> {
        Ok(Refiner::new(compact, &self.corrections, self.sparsity()?, config))
    }

    /// Sparsity of the first timestep's views.
    fn sparsity(&self) -> Result<f32, PipelineError> {
        let cameras = self.capture.cameras(Split::Train, self.scene.first_frame, self.scene.downscale)?;
        let cameras: Vec<_> = cameras.into_iter().map(|(_, camera)| camera).collect();
        Ok(view_sparsity(self.scene.at(0)?.means(), &cameras))
    }

    /// Quality and Gaussians, as an allowance has it.
    fn choose<'r, 'b>(
        &self,
        pruned: &'r PrunedScene<'b>,
        settings: &CompressSettings,
        allowance: Allowance,
        observer: &mut dyn Observer,
    ) -> Result<Chosen<'r, 'b>, PipelineError> {
        let mut chosen = Chosen { quality: None, pruned: Cow::Borrowed(pruned), settings: settings.clone() };
        if allowance == Allowance::NONE {
            return Ok(chosen);
        }
        let visits = self.visits()?;
        if let Some(share) = allowance.rounding {
            tell(observer, Event::Begun { work: Work::Measuring, num_steps: NUM_MEASURED * visits.len() })?;
            let mut visited = |visit: &Visit| tell(observer, Event::Frame(self.scene.first_frame + visit.timestep));
            let quality = choose_quality(pruned, settings, &visits, share, self.sparsity()?, &mut visited)?;
            chosen.quality = Some(quality);
            chosen.settings = settings.clone().with_quality(quality);
        }
        if allowance.removal > 0.0 {
            let pruned = without_costly(pruned, &chosen.settings, &visits, allowance.removal)?;
            chosen.pruned = Cow::Owned(pruned);
        }
        Ok(chosen)
    }

    /// Views of timesteps of the whole scene, a third of the cameras at each, or as many as memory has room for.
    fn visits(&self) -> Result<Vec<Visit>, PipelineError> {
        let num_timesteps = self.scene.num_timesteps();
        // Three visits have as many views as a timestep.
        let num_visits = NUM_VISITS.min(3 * num_timesteps);
        let order = refine_order(1, num_timesteps, self.num_views, None).take(num_visits);
        let views = self.capture.cameras(Split::Train, self.scene.first_frame, self.scene.downscale)?;
        let pixels = views.iter().map(|(_, camera)| camera.width * camera.height).max().unwrap_or(1);
        let most_views = (MOST_PIXELS / (num_visits * pixels)).max(1);
        let visit = |(timestep, mut cameras): (usize, Vec<usize>)| {
            cameras.truncate(most_views);
            let (timestep, views) = self.load(timestep, &cameras)?;
            let corrections = cameras.iter().map(|&camera| self.corrections[camera]).collect();
            Ok(Visit { timestep, views: views.into_iter().map(|(_, view)| view).collect(), corrections })
        };
        order.map(visit).collect()
    }

    /// Iterations in which every timestep is visited once.
    fn of_a_pass(&self) -> usize {
        self.scene.num_timesteps() * refine_order(0, 1, self.num_views, None).next().map_or(1, |(_, views)| views.len())
    }

    /// How many iterations a refinement takes. A budget of time is turned into iterations by timing some.
    fn num_iterations(
        &self,
        pruned: &PrunedScene<'_>,
        settings: &CompressSettings,
        options: &RefineOptions,
        backend: &Backend,
    ) -> Result<usize, PipelineError> {
        let budget = match options.budget {
            RefineBudget::Iterations(count) => return Ok(count),
            RefineBudget::Time(budget) => budget,
        };
        let Some((compact, _)) = pruned.symbols(settings)? else { return Ok(1) };
        let begin = Instant::now();
        let enough = budget.mul_f64(TIMED_SHARE);
        let mut timed = self.refiner(compact, options.config)?;
        let mut go_on = |_| Ok(begin.elapsed() < enough);
        let done = match backend {
            Backend::Cpu => self.iterate(&CpuRasterizer, &mut timed, usize::MAX, &mut go_on),
            #[cfg(feature = "gpu")]
            Backend::Gpu(gpu) => {
                self.iterate(&tcgs_render::gpu::GpuRasterizer::new(gpu), &mut timed, usize::MAX, &mut go_on)
            }
        };
        let (done, taken) = (done?.len(), begin.elapsed());
        let left = budget.saturating_sub(taken).as_secs_f64();
        Ok(((left * done as f64 / taken.as_secs_f64()) as usize).max(1))
    }

    fn refine<R: Rasterizer>(
        &self,
        rasterizer: &R,
        mut refiner: Refiner,
        num_iterations: usize,
        observer: &mut dyn Observer,
    ) -> Result<(CompactScene, Light, Vec<f64>), PipelineError>
    where
        GpuError: From<R::Error>,
    {
        tell(observer, Event::Begun { work: Work::Refining, num_steps: num_iterations })?;
        let losses = self.iterate(rasterizer, &mut refiner, num_iterations, &mut |frame| match tell(
            observer,
            Event::Frame(frame),
        ) {
            Err(PipelineError::Stopped) => Ok(false),
            told => told.map(|()| true),
        })?;
        let light = refiner.light();
        Ok((refiner.into_scene(), light, losses))
    }

    /// - `go_on`: hears of the frame after every iteration, and says whether there is another
    /// - returns: the loss before each iteration
    fn iterate<R: Rasterizer>(
        &self,
        rasterizer: &R,
        refiner: &mut Refiner,
        num_iterations: usize,
        go_on: &mut dyn FnMut(usize) -> Result<bool, PipelineError>,
    ) -> Result<Vec<f64>, PipelineError>
    where
        GpuError: From<R::Error>,
    {
        let mut losses = Vec::new();
        std::thread::scope(|scope| {
            // Holds nothing: the loader is one visit ahead, waiting to hand it over.
            let (send, receive) = sync_channel(0);
            scope.spawn(move || {
                let in_order = self.capture.is_video().then_some(num_iterations);
                for (timestep, views) in refine_order(0, self.scene.num_timesteps(), self.num_views, in_order) {
                    let loaded = self.load(timestep, &views);
                    let failed = loaded.is_err();
                    if send.send(loaded).is_err() || failed {
                        break;
                    }
                }
            });
            while let Ok(visit) = receive.recv() {
                let (timestep, views) = visit?;
                for (camera, view) in views {
                    if losses.len() == num_iterations {
                        return Ok(losses);
                    }
                    let progress = losses.len() as f32 / num_iterations as f32;
                    let loss = refiner.step(rasterizer, timestep, camera, &view, progress);
                    let loss = loss.map_err(GpuError::from)?;
                    losses.push(loss);
                    if !go_on(view.frame)? {
                        return Ok(losses);
                    }
                }
            }
            Ok(losses)
        })
    }

    /// Some views of a timestep, each with its number.
    fn load(&self, timestep: usize, chosen: &[usize]) -> Result<(usize, Vec<(usize, View)>), PipelineError> {
        let frame = self.scene.first_frame + timestep;
        let views = self.capture.some_views(Split::Train, frame, self.scene.downscale, chosen)?;
        Ok((timestep, chosen.iter().copied().zip(views).collect()))
    }
}
