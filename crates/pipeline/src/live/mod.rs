//! A run during its training, for viewers: its progress, the current scene, and the finished timesteps.
//!
//! What lives here: the curves ([`LiveRun::state`]), small `.tcgs` files of the scene, and the frequency at which they
//! are made. What does not: the transport of requests, such as HTTP.
//!
//! Files are made on request only. A [`Budget`] pays for them, so that the training hardly notices.

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

/// Longest wait for the next iteration; between two timesteps there is none.
const PATIENCE: Duration = Duration::from_secs(3);
/// Most numbers in all finished timesteps of a file together: 40 MB.
const MAX_VALUES: usize = 10_000_000;
/// Most finished timesteps of a file.
const MAX_TIMESTEPS: usize = 30;

/// A run during its training. Threads share it: one reports events, others ask.
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

/// A `.tcgs` file of a run in training.
#[derive(Clone, Debug)]
pub struct LiveFile {
    /// Differs for other content.
    pub tag: String,
    /// The file.
    pub bytes: Arc<[u8]>,
}

/// The files made of the run.
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

    /// Records an event of the training.
    pub fn hear(&self, event: &Event) {
        self.told().hear(event);
    }

    /// Records the end of the training; [`Self::finished`] then returns the whole run.
    pub fn end(&self) {
        self.told().end();
    }

    /// Progress of the training, with its curves (`docs/PLAYER.md`, "A training").
    pub fn state(&self) -> Value {
        self.told().json()
    }

    /// The scene between two iterations as a file of one timestep. If none can be made at this time, returns an older
    /// one. Its PSNR, in the first of the judged views, joins the curve.
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

    /// The last finished timesteps as a file. After the end of the training it is the whole run, as made by
    /// `tcgs compress`.
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
        // Starts at the last death, since earlier timesteps have other Gaussians.
        let lives = run.lives(end)?.unwrap_or_default();
        let deaths = lives.iter().map(|life| life.death as usize).filter(|&death| death < end);
        let begin = deaths.fold(begin, usize::max);
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
