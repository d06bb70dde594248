//! A run while it is trained, for people who look: how far it is, the scene as it is now, and what is finished.
//!
//! What lives here: the curves ([`LiveRun::state`]), small `.tcgs` files of the scene, and how often one is made. What does
//! not: how somebody asks, such as HTTP.
//!
//! Nothing is made unless it is asked for. What is made is paid from a [`Budget`], so that the training hardly notices.

mod budget;
mod curve;
mod picture;
mod told;

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde_json::Value;
use tcgs_capture::{Capture, Split};
use tcgs_train::{Glimpse, Parameters, Run, Trainer};

use self::budget::Budget;
use self::picture::Picture;
use self::told::{Running, Told};
use crate::compress::{CompressOptions, CompressPreset, capture_kind_of, compress_scene, settings_of};
use crate::{Event, OpenScene, OpenSettings, PipelineError};

/// How long the next iteration is waited for; between two timesteps there is none.
const PATIENCE: Duration = Duration::from_secs(3);
/// Numbers that the finished timesteps of a file have at most together: 40 MB of them.
const MAX_VALUES: usize = 10_000_000;
/// Finished timesteps of a file at most.
const MAX_TIMESTEPS: usize = 30;

/// A run while it is trained. Threads share it: one tells it what happens, others ask.
///
/// ```
/// use std::ops::ControlFlow;
/// use tcgs_capture::{Capture, SyntheticSettings, write_synthetic};
/// use tcgs_pipeline::{Backend, Event, LiveRun, fit, new_trainer, settings_for};
/// use tcgs_train::{Preset, Run};
///
/// let folder = tempfile::tempdir()?;
/// let small = SyntheticSettings { width: 48, height: 36, num_timesteps: 2, num_points: 300, ..Default::default() };
/// write_synthetic(&folder.path().join("capture"), &small)?;
/// let capture = Capture::open(&folder.path().join("capture"))?;
/// let mut config = settings_for(Preset::Fast, &capture);
/// (config.schedule.first_iterations, config.schedule.rest_iterations) = (20, 5);
/// let run = Run::create(&folder.path().join("run"), &config)?;
/// let mut trainer = new_trainer(&config, &capture, &Backend::Cpu)?;
///
/// let live = LiveRun::new(&run, &capture, &mut trainer)?;
/// fit(&capture, &run, trainer, &mut |event: &Event| {
///     live.hear(event);
///     ControlFlow::Continue(())
/// })?;
/// live.end();
/// assert_eq!(live.state()["timesteps"]["psnr"].as_array().map(Vec::len), Some(2));
/// let whole = live.finished(None)?.expect("two timesteps are finished");
/// assert!(whole.bytes.starts_with(b"TCGS"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct LiveRun {
    folder: PathBuf,
    picture: Picture,
    glimpse: Arc<Glimpse>,
    told: Mutex<Told>,
    /// Locked while a file is made.
    maker: Mutex<Maker>,
}

/// A `.tcgs` file of a run that is trained.
#[derive(Clone, Debug)]
pub struct LiveFile {
    /// Another one for other content.
    pub tag: String,
    /// The file.
    pub bytes: Arc<[u8]>,
}

/// What is made of the run.
#[derive(Debug)]
struct Maker {
    budget: Budget,
    running: Option<LiveFile>,
    finished: Option<LiveFile>,
}

impl LiveRun {
    /// A run before [`fit`](crate::fit), whose observer is to call [`Self::hear`].
    ///
    /// - `trainer`: of the run; it will show its scene
    ///
    /// # Errors
    /// [`PipelineError`] if the capture lacks the run's first frame, or the run's metrics cannot be read.
    pub fn new(run: &Run, capture: &Capture, trainer: &mut Trainer) -> Result<Arc<Self>, PipelineError> {
        let config = run.config();
        let cameras = capture.cameras(Split::Train, config.data.first_frame, config.data.downscale)?;
        let glimpse = Arc::new(Glimpse::default());
        trainer.show_to(Arc::clone(&glimpse));
        let expected = "a system with a thread to spare";
        let budget = Budget::new().map_err(|error| PipelineError::input("threads", error.to_string(), expected))?;
        let mut told = Told::new(config.data.end_frame - config.data.first_frame, trainer.num_gaussians());
        for metrics in run.metrics()? {
            told.recall(&metrics?);
        }
        Ok(Arc::new(Self {
            folder: run.folder().into(),
            picture: Picture::new(config, capture, &cameras),
            glimpse,
            told: Mutex::new(told),
            maker: Mutex::new(Maker { budget, running: None, finished: None }),
        }))
    }

    /// Takes note of an event of the training.
    pub fn hear(&self, event: &Event) {
        self.told().hear(event);
    }

    /// The training has ended: [`Self::finished`] is the whole run from now on.
    pub fn end(&self) {
        self.told().end();
    }

    /// How far the training is, with its curves (`docs/PLAYER.md`, "A training").
    pub fn state(&self) -> Value {
        self.told().json()
    }

    /// The scene between two iterations as a file of one timestep; an earlier one if none can be made now. Its PSNR, in the
    /// view that is judged first, joins the curve.
    ///
    /// - `known`: tag of the file that the caller has
    /// - returns: none if there is nothing newer
    ///
    /// # Errors
    /// [`PipelineError`] if the codec refuses the scene.
    pub fn running(&self, known: Option<&str>) -> Result<Option<LiveFile>, PipelineError> {
        let mut maker = self.maker();
        let is_running = self.told().running.is_some();
        if is_running
            && maker.budget.allows()
            && let Some(glimpsed) = self.glimpse.ask(PATIENCE)
        {
            let (timestep, iterations) = (glimpsed.timestep, glimpsed.iterations);
            let bytes = maker.budget.pay(glimpsed.seconds, || {
                self.measure(timestep, iterations, &glimpsed.parameters);
                self.picture.file(timestep, std::slice::from_ref(&glimpsed.parameters))
            })?;
            maker.running = Some(LiveFile { tag: format!("{timestep}-{iterations}"), bytes: bytes.into() });
        }
        Ok(maker.running.clone().filter(|file| known != Some(&file.tag)))
    }

    /// Adds a point to the curve of PSNR.
    fn measure(&self, timestep: usize, iterations: usize, parameters: &Parameters) {
        let of_timestep = |running: &&mut Running| running.timestep == timestep;
        let judged = self.told().running.as_mut().filter(of_timestep).map(|running| Arc::clone(&running.judged));
        let Some(psnr) = judged.as_ref().and_then(|views| views.first()).map(|v| self.picture.psnr(parameters, v))
        else {
            return;
        };
        if let Some(running) = self.told().running.as_mut().filter(of_timestep) {
            running.psnr.push((iterations, psnr));
        }
    }

    /// The last finished timesteps as a file; all of them once the training has ended, as `tcgs compress` makes it.
    ///
    /// - `known`: as for [`Self::running`]
    /// - returns: none if there is nothing newer
    ///
    /// # Errors
    /// [`PipelineError`] if a checkpoint cannot be read, or the codec refuses the scene.
    pub fn finished(&self, known: Option<&str>) -> Result<Option<LiveFile>, PipelineError> {
        let mut maker = self.maker();
        let (has_ended, end) = {
            let told = self.told();
            (told.has_ended, told.finished.len())
        };
        let tag = if has_ended { "whole".into() } else { format!("until-{end}") };
        let is_newest = maker.finished.as_ref().is_some_and(|file| file.tag == tag);
        if end > 0 && !is_newest && (has_ended || maker.budget.allows()) {
            // After the training all processors are free.
            let bytes = if has_ended { self.whole()? } else { maker.budget.pay(0.0, || self.last_timesteps(end))? };
            maker.finished = Some(LiveFile { tag, bytes: bytes.into() });
        }
        Ok(maker.finished.clone().filter(|file| known != Some(&file.tag)))
    }

    fn whole(&self) -> Result<Vec<u8>, PipelineError> {
        let scene = OpenScene::open(&self.folder, OpenSettings::default())?;
        let kind = capture_kind_of(&scene, None)?;
        let (keypoints, mapping) = settings_of(CompressPreset::Default, kind, &scene)?;
        let options = CompressOptions { keypoints, mapping, ..CompressOptions::default() };
        Ok(compress_scene(&scene, &options)?.file)
    }

    /// - `end`: number of finished timesteps, at least 1
    fn last_timesteps(&self, end: usize) -> Result<Vec<u8>, PipelineError> {
        let run = Run::open(&self.folder)?;
        let first = run.checkpoint(0, None)?;
        let gaussians = &first.parameters.gaussians;
        let values = gaussians.layout().raw_bytes(gaussians.num_gaussians().max(1), 1) as usize / size_of::<f32>();
        let begin = end - end.min(MAX_TIMESTEPS).min(MAX_VALUES / values).max(1);
        // From the last death on: before it there were others.
        let deaths = run.lives(end)?.map(|lives| lives.deaths).unwrap_or_default();
        let begin = deaths.into_iter().map(|death| death as usize).filter(|&death| death < end).fold(begin, usize::max);
        let at = |timestep| match timestep {
            0 => Ok(first.parameters.clone()),
            _ => run.parameters(timestep, Some(&first)),
        };
        self.picture.file(begin, &(begin..end).map(at).collect::<Result<Vec<_>, _>>()?)
    }

    fn told(&self) -> MutexGuard<'_, Told> {
        self.told.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn maker(&self) -> MutexGuard<'_, Maker> {
        self.maker.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
