//! A run folder:
//!
//! | file | content |
//! |---|---|
//! | `config.toml` | the settings |
//! | `checkpoints/000041.npz` | the changes of each timestep from the timestep before |
//! | `resume0.npz`, `resume1.npz` | the optimizer's state after the last even and the last odd timestep, for resuming |
//! | `start.npz` | a complete checkpoint: the initial state of a run that continues another one |
//! | `metrics.jsonl` | a JSON object for each timestep |
//!
//! What does not live here: the content of a checkpoint (`checkpoint`).

use std::fs;
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde_json::Value;
use tcgs_codec::{BitMap, Quantizers};
use tcgs_core::{DynamicGaussians, Lives, read_text};
use tcgs_interchange::{Existing, create_folders, write_whole};

use crate::TrainError;
use crate::checkpoint::{Arrays, Chain, Checkpoint, For, LIVES, MASK_LOGITS, read_single, write_single};
use crate::config::{BirthConfig, DeathConfig, GateConfig, RenderConfig, TrainConfig};
use crate::engine::Engine;
use crate::engine::cpu::CpuEngine;
use crate::fake_quant::FakeQuantizers;
use crate::parameters::Parameters;
use crate::stand_ins::StandIns;
use crate::state::State;
use crate::trainer::Trainer;

const CONFIG: &str = "config.toml";
const METRICS: &str = "metrics.jsonl";
const START: &str = "start.npz";
const CHECKPOINTS: &str = "checkpoints";

/// A run folder on disk, and the settings in its `config.toml`.
#[derive(Clone, Debug)]
pub struct Run {
    folder: PathBuf,
    config: TrainConfig,
    /// The state of reading and writing checkpoints.
    chain: Arc<Mutex<Chain>>,
}

/// The result of a run: the finished timesteps of all checkpoints together.
#[derive(Clone, Debug)]
pub struct TrainedScene {
    /// `[T, N]`, the Gaussians of every finished timestep in stored form, neither quantised nor pruned. A Gaussian that
    /// does not live at a timestep stands there as it was born or died ([`StandIns`]).
    pub scene: DynamicGaussians,
    /// Lifetimes; none if all Gaussians live at all timesteps.
    pub lives: Option<Lives>,
    /// `[T][N]`, mask logits `m_{n,t}` of the Gaussians that live; meaningless if the run did not learn masks.
    pub mask_logits: Vec<Vec<f32>>,
    /// `[N]`, whether each Gaussian belongs to the foreground.
    pub foreground: Vec<bool>,
    /// Bit widths and learned quantizers; `None` if the run did not quantise.
    pub quantization: Option<(BitMap, Quantizers)>,
    /// `[cameras, 3]`, logarithm of each training camera's colour gain.
    pub camera_gains: Vec<[f32; 3]>,
    /// `[cameras, 3]`, colour offset of each training camera.
    pub camera_offsets: Vec<[f32; 3]>,
}

impl Run {
    /// Whether a folder is a run folder: whether it has a `config.toml`.
    pub fn is_run(folder: &Path) -> bool {
        folder.join(CONFIG).is_file()
    }

    /// Whether a file of a run folder is a part of the run.
    ///
    /// - `name`: relative to the run folder
    pub fn has_file(name: &Path) -> bool {
        let resume = [0, 1].map(resume_name);
        name.starts_with(CHECKPOINTS)
            || [CONFIG, METRICS, START]
                .into_iter()
                .chain(resume.iter().map(String::as_str))
                .any(|ours| name == Path::new(ours))
    }

    /// Creates a run folder and writes its `config.toml`.
    ///
    /// # Errors
    /// [`TrainError::Write`] if the folder or the file cannot be written.
    pub fn create(folder: &Path, config: &TrainConfig) -> Result<Self, TrainError> {
        create_folders(&folder.join(CHECKPOINTS)).map_err(write(folder))?;
        let run = Self::new(folder, config.clone());
        run.write_whole(CONFIG, config.to_toml().as_bytes())?;
        Ok(run)
    }

    /// Opens an existing run folder and reads its `config.toml`.
    ///
    /// # Errors
    /// [`TrainError`] if `config.toml` cannot be read or holds invalid settings.
    pub fn open(folder: &Path) -> Result<Self, TrainError> {
        let path = folder.join(CONFIG);
        let text = read_text(&path, TrainConfig::MAX_BYTES).map_err(read(&path))?;
        // Settings that a `config.toml` lacks are off, so that such a run goes on as it began.
        let (gate, births, deaths) = (GateConfig::OFF, BirthConfig::OFF, DeathConfig::OFF);
        let render = RenderConfig::OFF;
        let mut base = TrainConfig { gate, births, deaths, render, ..TrainConfig::default() };
        (base.densify.prune_error, base.densify.dropout) = (0.0, 0.0);
        (base.rates.color_damping, base.rates.camera_centered) = (0.0, false);
        let merged = |base: &TrainConfig| {
            base.merge(&text).map_err(|e| TrainError::File { path: path.clone(), problem: e.to_string() })
        };
        // Before `densify.prune_large` existed, large Gaussians were removed from the reset on.
        base.densify.prune_large = merged(&base)?.densify.reset;
        Ok(Self::new(folder, merged(&base)?))
    }

    fn new(folder: &Path, config: TrainConfig) -> Self {
        let chain = Arc::new(Mutex::new(Chain::new(&folder.join(CHECKPOINTS))));
        Self { folder: folder.into(), config, chain }
    }

    /// The settings in `config.toml`.
    pub fn config(&self) -> &TrainConfig {
        &self.config
    }

    /// Replaces the settings and rewrites `config.toml`, as to resume the run with more frames.
    ///
    /// # Errors
    /// [`TrainError::Write`] if `config.toml` cannot be written.
    pub fn set_config(&mut self, config: &TrainConfig) -> Result<(), TrainError> {
        self.config = config.clone();
        self.write_whole(CONFIG, config.to_toml().as_bytes())
    }

    /// Path of the run folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    fn chain(&self) -> MutexGuard<'_, Chain> {
        // A panic elsewhere leaves the last timestep read, or nothing.
        self.chain.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Path of a timestep's checkpoint, whether it is there or not.
    pub fn checkpoint_path(&self, timestep: usize) -> PathBuf {
        self.chain().path(timestep)
    }

    /// Path of the state that resuming after a timestep needs besides its checkpoint. Each timestep overwrites the file
    /// of the last but one.
    pub fn resume_path(&self, timestep: usize) -> PathBuf {
        self.folder.join(resume_name(timestep))
    }

    /// Number of finished timesteps: of checkpoints from timestep 0 on without a gap.
    pub fn timesteps(&self) -> usize {
        let chain = self.chain();
        (0..).take_while(|&t| chain.path(t).is_file()).count()
    }

    /// Writes the checkpoint of a timestep: the rows that differ in a bit from the timestep before, and everything at
    /// every 40th timestep. Before it, writes the state from which the next timestep starts, so that the run can be
    /// resumed after the last checkpoint at any moment. Each file is written atomically.
    ///
    /// # Errors
    /// [`TrainError::Write`] if a file cannot be written; no partial file remains. [`TrainError::File`] if the
    /// checkpoint of the timestep before is damaged.
    pub fn save(&self, timestep: usize, checkpoint: &Checkpoint) -> Result<(), TrainError> {
        let (mut scene, mut resuming) = ((Vec::new(), Arrays::new()), (Vec::new(), Arrays::new()));
        for (name, used_for, array) in checkpoint.arrays(timestep == 0) {
            let (order, arrays) = if used_for == For::Scene { &mut scene } else { &mut resuming };
            order.push(name.clone());
            arrays.insert(name, Arc::new(array));
        }
        write_single(&self.resume_path(timestep), timestep, &resuming.0, &resuming.1)?;
        self.chain().write(timestep, &scene.0, scene.1)
    }

    /// Writes the initial state of a run that continues another one. Call it before [`Self::create`], so that every
    /// folder with a `config.toml` has its start.
    ///
    /// - `folder`: of the run, made if it is not there
    ///
    /// # Errors
    /// [`TrainError::Write`] if the folder or the file cannot be written.
    pub fn save_start(folder: &Path, start: &Checkpoint) -> Result<(), TrainError> {
        create_folders(folder).map_err(write(folder))?;
        start.save(&folder.join(START), true)
    }

    /// The state that the run began from; `None` if it began from points.
    ///
    /// # Errors
    /// [`TrainError::File`] if the state is missing or damaged.
    pub fn start(&self) -> Result<Option<Checkpoint>, TrainError> {
        if self.config.data.start_from.is_empty() {
            return Ok(None);
        }
        Checkpoint::load(&self.folder.join(START), None, self.config.quantize.learned_offset).map(Some)
    }

    /// Resumes the run on the CPU after its last finished timestep; `None` if no timestep is finished.
    ///
    /// # Errors
    /// [`TrainError::File`] if a checkpoint is damaged.
    pub fn resume(&self) -> Result<Option<Trainer>, TrainError> {
        self.resume_with(|state| Box::new(CpuEngine::new(state)))
    }

    /// Resumes the run on an engine of the caller's choice; `None` if no timestep is finished.
    ///
    /// - `make`: makes the engine from the resumed state
    ///
    /// # Errors
    /// As [`Self::resume`].
    pub fn resume_with(&self, make: impl FnOnce(State) -> Box<dyn Engine>) -> Result<Option<Trainer>, TrainError> {
        let finished = self.timesteps();
        if finished == 0 {
            return Ok(None);
        }
        let first = self.checkpoint(0, None)?;
        let before_last = match finished {
            1 => first.clone(),
            _ => self.checkpoint(finished - 2, Some(&first).filter(|_| finished > 2))?,
        };
        let last = self.resumable(finished - 1, Some(&first).filter(|_| finished > 1))?;
        let start = self.start()?;
        self.check_one_run(start.as_ref(), &first, &before_last, &last, finished)?;
        Ok(Some(match start {
            None => Trainer::resume(&self.config, &first, &before_last, &last, finished, make),
            Some(start) => {
                let before_last = if finished == 1 { &start } else { &before_last };
                Trainer::resume_continued(&self.config, &start, before_last, &last, finished, make)
            }
        }))
    }

    /// Whether the checkpoints that resuming needs are of one run. No Gaussian of the first one has died. Every
    /// Gaussian of the last one that was born before the last timestep is in the one before.
    fn check_one_run(
        &self,
        start: Option<&Checkpoint>,
        first: &Checkpoint,
        before_last: &Checkpoint,
        last: &Checkpoint,
        finished: usize,
    ) -> Result<(), TrainError> {
        let refuse = |path: PathBuf, problem: String| Err(TrainError::File { path, problem });
        if !first.lifetimes.are_whole() {
            return refuse(self.checkpoint_path(0), "has births or deaths, expected none at the first timestep".into());
        }
        let number = first.parameters.num_gaussians();
        if let Some(start) = start.filter(|start| start.lifetimes != first.lifetimes) {
            let found = start.parameters.num_gaussians();
            return refuse(
                self.folder.join(START),
                format!("holds {found} Gaussians, expected {number} that all live"),
            );
        }
        let before = last.lifetimes.lives.partition_point(|life| (life.birth as usize) < finished - 1);
        let mut known = last.lifetimes.ids.iter().take_while(|id| (**id as usize) < before);
        if !known.all(|id| before_last.lifetimes.ids.binary_search(id).is_ok()) {
            let problem = format!("lacks Gaussians that live at timestep {}, and before it", finished - 1);
            return refuse(self.checkpoint_path(finished - 2), problem);
        }
        Ok(())
    }

    /// Reads the checkpoint of one finished timestep. Reading timesteps in order reads each file once; reading any one
    /// reads at most the 40 files before it.
    ///
    /// - `first`: the checkpoint of timestep 0, with the columns that do not vary; none to read that one itself
    /// - returns: the checkpoint, with an all-zero optimizer's state; see [`Self::resumable`]
    ///
    /// # Errors
    /// [`TrainError::File`] if there is no such checkpoint, or it or one that it continues is damaged.
    pub fn checkpoint(&self, timestep: usize, first: Option<&Checkpoint>) -> Result<Checkpoint, TrainError> {
        let arrays = self.chain().read(timestep)?;
        self.decode(timestep, &arrays, first)
    }

    /// The learned parameters in the checkpoint of one finished timestep, and nothing else of it.
    ///
    /// - `first`: see [`Self::checkpoint`]
    ///
    /// # Errors
    /// As [`Self::checkpoint`].
    pub fn parameters(&self, timestep: usize, first: Option<&Checkpoint>) -> Result<Parameters, TrainError> {
        let arrays = self.chain().read(timestep)?;
        let parameters = Checkpoint::parameters_of(&arrays, first);
        parameters.map_err(|problem| TrainError::File { path: self.checkpoint_path(timestep), problem })
    }

    /// Reads the checkpoint of one of the last two finished timesteps, with the optimizer's state.
    ///
    /// - `first`: see [`Self::checkpoint`]
    ///
    /// # Errors
    /// As [`Self::checkpoint`]; [`TrainError::File`] if the run no longer has the optimizer's state after that
    /// timestep.
    pub fn resumable(&self, timestep: usize, first: Option<&Checkpoint>) -> Result<Checkpoint, TrainError> {
        let mut arrays = self.chain().read(timestep)?;
        // A checkpoint without a separate resume file holds the optimizer's state itself.
        if !Checkpoint::can_resume_from(&arrays) {
            arrays.extend(read_single(&self.resume_path(timestep), timestep)?);
        }
        let found = Checkpoint::can_resume_from(&arrays);
        if !found {
            let problem = "holds no state of an optimizer".into();
            return Err(TrainError::File { path: self.resume_path(timestep), problem });
        }
        self.decode(timestep, &arrays, first)
    }

    /// The lives of all Gaussians up to the last readable one of some timesteps. None if all Gaussians were there at
    /// first and have not died. Reads nothing else of the checkpoints.
    ///
    /// - `num_timesteps`: number of timesteps, from the first on; a run under way may finish more while it is read
    ///
    /// # Errors
    /// As [`Self::checkpoint`].
    pub fn lives(&self, num_timesteps: usize) -> Result<Option<Lives>, TrainError> {
        Ok(self.last_lives(num_timesteps)?.1)
    }

    /// The last readable one of some timesteps, with the result of [`Self::lives`].
    fn last_lives(&self, num_timesteps: usize) -> Result<(usize, Option<Lives>), TrainError> {
        let mut chain = Chain::of(&self.folder.join(CHECKPOINTS), &LIVES);
        let mut lives_at = |timestep: usize| {
            let lives = Checkpoint::lives_of(&chain.read(timestep)?);
            lives.map_err(|problem| TrainError::File { path: chain.path(timestep), problem })
        };
        // A damaged checkpoint must not prevent reading those before it.
        let mut found = Ok((0, None));
        for timestep in (0..num_timesteps).rev() {
            found = lives_at(timestep).map(|lives| (timestep, lives));
            if found.is_ok() {
                break;
            }
        }
        found
    }

    /// As [`Self::parameters`], checked against the number of Gaussians that live.
    ///
    /// - `first`: the checkpoint of timestep 0
    /// - `lives`: as returned by [`Self::lives`]
    ///
    /// # Errors
    /// As there; [`TrainError::File`] if the checkpoint has another number of Gaussians.
    pub fn living(&self, timestep: usize, first: &Checkpoint, lives: Option<&Lives>) -> Result<Parameters, TrainError> {
        let parameters = match timestep {
            0 => first.parameters.clone(),
            _ => self.parameters(timestep, Some(first))?,
        };
        let (found, expected) = (parameters.num_gaussians(), num_living(timestep, first, lives));
        if found == expected {
            return Ok(parameters);
        }
        let problem = format!("holds {found} Gaussians, expected {expected}");
        Err(TrainError::File { path: self.checkpoint_path(timestep), problem })
    }

    /// The stand-ins for the Gaussians of the run at timesteps at which they do not live.
    ///
    /// - `first`: see [`Self::checkpoint`]
    /// - `num_timesteps`: see [`Self::lives`]
    ///
    /// # Errors
    /// As [`Self::checkpoint`].
    pub fn stand_ins(&self, first: &Checkpoint, num_timesteps: usize) -> Result<StandIns, TrainError> {
        let layout = first.parameters.gaussians.layout();
        let (last, Some(lives)) = self.last_lives(num_timesteps)? else { return Ok(StandIns::none(layout)) };
        let at = |timestep, lives: &Lives| Ok(self.living(timestep, first, Some(lives))?.gaussians);
        StandIns::gather(lives, layout, last, at)
    }

    /// The mask logits of the Gaussians that live, timestep by timestep, `[N]` each. Reads nothing else of the
    /// checkpoints.
    ///
    /// - `num_timesteps`: see [`Self::lives`]
    /// - `first`, `lives`: as returned by [`Self::checkpoint`] and [`Self::lives`]
    ///
    /// # Errors
    /// Each as [`Self::checkpoint`]; [`TrainError::File`] if there are not as many as live.
    pub fn mask_logits(
        &self,
        num_timesteps: usize,
        first: &Checkpoint,
        lives: Option<&Lives>,
    ) -> impl Iterator<Item = Result<Vec<f32>, TrainError>> {
        let mut chain = Chain::of(&self.folder.join(CHECKPOINTS), &[MASK_LOGITS]);
        (0..num_timesteps).map(move |timestep| {
            let arrays = chain.read(timestep)?;
            let failed = |problem| TrainError::File { path: chain.path(timestep), problem };
            let logits = Checkpoint::mask_logits_of(&arrays).map_err(failed)?.to_vec();
            let expected = num_living(timestep, first, lives);
            if logits.len() != expected {
                return Err(failed(format!("{MASK_LOGITS} holds {} values, expected {expected}", logits.len())));
            }
            Ok(logits)
        })
    }

    fn decode(&self, timestep: usize, arrays: &Arrays, first: Option<&Checkpoint>) -> Result<Checkpoint, TrainError> {
        let checkpoint = Checkpoint::from_arrays(arrays, first, self.config.quantize.learned_offset);
        checkpoint.map_err(|problem| TrainError::File { path: self.checkpoint_path(timestep), problem })
    }

    /// Reads the checkpoints of all finished timesteps into one scene.
    ///
    /// # Errors
    /// [`TrainError::File`] if no timestep is finished, or a checkpoint is damaged.
    pub fn trained(&self) -> Result<TrainedScene, TrainError> {
        self.trained_until(self.timesteps())
    }

    /// Reads the checkpoints of some finished timesteps into one scene.
    ///
    /// - `finished`: as `num_timesteps` of [`Self::lives`]
    ///
    /// # Errors
    /// [`TrainError::File`] if there are none, or a checkpoint is damaged.
    pub fn trained_until(&self, finished: usize) -> Result<TrainedScene, TrainError> {
        if finished == 0 {
            let problem = "no checkpoint, expected a run with at least one finished timestep".into();
            return Err(TrainError::File { path: self.folder.join(CHECKPOINTS), problem });
        }
        let first = self.checkpoint(0, None)?;
        let mut scene = DynamicGaussians::new(Arc::clone(first.parameters.gaussians.layout()));
        let mut mask_logits = Vec::with_capacity(finished);
        let stand_ins = self.stand_ins(&first, finished)?;
        let num_gaussians = stand_ins.lives().map_or(first.parameters.num_gaussians(), |lives| lives.len());
        let mut foreground = vec![false; num_gaussians];
        for timestep in 0..finished {
            let now = self.living(timestep, &first, stand_ins.lives())?;
            let ids = stand_ins.lives().map_or_else(|| (0..num_gaussians).collect(), |lives| lives.living(timestep));
            ids.iter().zip(&now.foreground).for_each(|(&id, &is_foreground)| foreground[id] = is_foreground);
            scene.push(stand_ins.complete(now.gaussians, timestep));
            mask_logits.push(now.mask_logits);
        }
        let quantizers = match finished {
            1 => first.quantizers.clone(),
            _ => self.checkpoint(finished - 1, Some(&first))?.quantizers,
        };
        let widths = |first: &FakeQuantizers| first.bit_map_of(num_gaussians);
        Ok(TrainedScene {
            scene,
            mask_logits,
            foreground,
            lives: stand_ins.lives().cloned(),
            quantization: first.quantizers.as_ref().map(widths).zip(quantizers.map(|q| q.table())),
            camera_gains: first.parameters.camera_gains,
            camera_offsets: first.parameters.camera_offsets,
        })
    }

    /// The JSON objects in `metrics.jsonl`, one per timestep. Each is read on demand, because the loss curves of a long
    /// run take a lot of memory.
    ///
    /// # Errors
    /// [`TrainError::Read`] if `metrics.jsonl` cannot be read, of the call or of an item.
    pub fn metrics(&self) -> Result<impl Iterator<Item = Result<Value, TrainError>> + use<>, TrainError> {
        // A line cut short by a crash belongs to a timestep without a checkpoint.
        let parse = |line: Result<String, TrainError>| line.map(|line| serde_json::from_str(&line).ok()).transpose();
        Ok(self.metrics_lines()?.filter_map(parse))
    }

    /// Lines of `metrics.jsonl`; none if there is no such file.
    fn metrics_lines(&self) -> Result<impl Iterator<Item = Result<String, TrainError>> + use<>, TrainError> {
        let path = self.folder.join(METRICS);
        let file = match fs::File::open(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => None,
            file => Some(file.map_err(read(&path))?),
        };
        let lines = file.into_iter().flat_map(|file| BufReader::new(file).lines());
        Ok(lines.map(move |line| line.map_err(read(&path))))
    }

    /// Keeps the metrics of the first `timesteps` timesteps and removes the metrics that an interrupted run wrote after
    /// them.
    ///
    /// # Errors
    /// [`TrainError::Read`] or [`TrainError::Write`] if `metrics.jsonl` cannot be read or written.
    pub fn truncate_metrics(&self, timesteps: usize) -> Result<(), TrainError> {
        let kept = |line: &str| {
            let metrics: Option<Value> = serde_json::from_str(line).ok();
            metrics.is_some_and(|m| m["timestep"].as_u64().is_some_and(|t| t < timesteps as u64))
        };
        let path = self.folder.join(METRICS);
        let (lines, mut failed) = (self.metrics_lines()?, None);
        let written = write_whole(&path, Existing::Replace, |file| {
            let mut file = BufWriter::new(file);
            // The lines unchanged: printing parsed values could change the last digit of a number.
            for line in lines {
                match line {
                    Ok(line) if kept(&line) => writeln!(file, "{line}")?,
                    Ok(_) => {}
                    Err(error) => {
                        failed = Some(error);
                        break;
                    }
                }
            }
            if failed.is_some() { Err(io::ErrorKind::InvalidData.into()) } else { file.flush() }
        });
        written.map_err(|error| failed.unwrap_or_else(|| write(&path)(error)))
    }

    /// Appends the metrics of one timestep to `metrics.jsonl`.
    ///
    /// - `metrics`: a JSON object, written as one line
    ///
    /// # Errors
    /// [`TrainError::Write`] if `metrics.jsonl` cannot be written; it is then unchanged.
    pub fn append_metrics(&self, metrics: &Value) -> Result<(), TrainError> {
        let path = self.folder.join(METRICS);
        let mut file = fs::OpenOptions::new().create(true).append(true).open(&path).map_err(write(&path))?;
        let before = file.metadata().map_err(write(&path))?.len();
        file.write_all(format!("{metrics}\n").as_bytes()).map_err(|error| {
            // No half line remains.
            let _ = file.set_len(before);
            write(&path)(error)
        })
    }

    fn write_whole(&self, name: &str, bytes: &[u8]) -> Result<(), TrainError> {
        let path = self.folder.join(name);
        write_whole(&path, Existing::Replace, |file| file.write_all(bytes)).map_err(write(&path))
    }
}

fn resume_name(timestep: usize) -> String {
    format!("resume{}.npz", timestep % 2)
}

/// How many Gaussians a timestep is to have.
fn num_living(timestep: usize, first: &Checkpoint, lives: Option<&Lives>) -> usize {
    lives.map_or(first.parameters.num_gaussians(), |lives| lives.num_living(timestep))
}

fn read(path: &Path) -> impl Fn(io::Error) -> TrainError + use<> {
    let path = path.to_path_buf();
    move |error| TrainError::Read { path: path.clone(), error }
}

fn write(path: &Path) -> impl Fn(io::Error) -> TrainError + use<> {
    let path = path.to_path_buf();
    move |error| TrainError::Write { path: path.clone(), error }
}
