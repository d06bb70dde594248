//! A run folder: `config.toml`, `checkpoints/` with one npz archive per timestep, and `metrics.jsonl` with one JSON
//! object per timestep. What does not live here: the content of a checkpoint (`checkpoint`).

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde_json::Value;
use tcgs_codec::{BitMap, Quantizers};
use tcgs_core::DynamicGaussians;
use tcgs_interchange::{Existing, write_whole};

use crate::TrainError;
use crate::checkpoint::Checkpoint;
use crate::config::TrainConfig;
use crate::engine::Engine;
use crate::engine::cpu::CpuEngine;
use crate::gate::GateConfig;
use crate::state::State;
use crate::trainer::Trainer;

const CONFIG: &str = "config.toml";
const METRICS: &str = "metrics.jsonl";

/// A run folder on disk, and the settings in its `config.toml`.
#[derive(Clone, Debug)]
pub struct Run {
    folder: PathBuf,
    config: TrainConfig,
}

/// The result of a run: the finished timesteps of all checkpoints together.
#[derive(Clone, Debug)]
pub struct TrainedScene {
    /// `[T, N]`, the Gaussians of every finished timestep in stored form, neither quantised nor pruned.
    pub scene: DynamicGaussians,
    /// `[T][N]`, mask logits `m_{n,t}`; without meaning if the run did not learn masks.
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

    /// Creates a run folder and writes its `config.toml`.
    ///
    /// # Errors
    /// [`TrainError::Write`] if the folder or the file cannot be written.
    pub fn create(folder: &Path, config: &TrainConfig) -> Result<Self, TrainError> {
        fs::create_dir_all(folder.join("checkpoints")).map_err(write(folder))?;
        let run = Self { folder: folder.into(), config: config.clone() };
        run.write_whole(CONFIG, config.to_toml().as_bytes())?;
        Ok(run)
    }

    /// Opens an existing run folder and reads its `config.toml`.
    ///
    /// # Errors
    /// [`TrainError`] if `config.toml` cannot be read or holds invalid settings.
    pub fn open(folder: &Path) -> Result<Self, TrainError> {
        let path = folder.join(CONFIG);
        let text = fs::read_to_string(&path).map_err(read(&path))?;
        // A run of before the gate goes on without it.
        let base = TrainConfig { gate: GateConfig::OFF, ..TrainConfig::default() };
        let config = base.merge(&text).map_err(|e| TrainError::File { path, problem: e.to_string() })?;
        Ok(Self { folder: folder.into(), config })
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

    fn checkpoint_path(&self, timestep: usize) -> PathBuf {
        self.folder.join("checkpoints").join(format!("{timestep:06}.npz"))
    }

    /// Number of finished timesteps: of checkpoints from timestep 0 on without a gap.
    pub fn timesteps(&self) -> usize {
        (0..).take_while(|&t| self.checkpoint_path(t).is_file()).count()
    }

    /// Writes the checkpoint of a timestep atomically.
    ///
    /// # Errors
    /// [`TrainError::Write`] if the file cannot be written; no partial file remains.
    pub fn save(&self, timestep: usize, checkpoint: &Checkpoint) -> Result<(), TrainError> {
        checkpoint.save(&self.checkpoint_path(timestep), timestep == 0)
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
        let later = |t: usize| if t == 0 { Ok(first.clone()) } else { self.checkpoint(t, Some(&first)) };
        let (before_last, last) = (later(finished.saturating_sub(2))?, later(finished - 1)?);
        Ok(Some(Trainer::resume(&self.config, &first, &before_last, &last, finished, make)))
    }

    /// Reads the checkpoint of one finished timestep.
    ///
    /// - `first`: the checkpoint of timestep 0, which holds what does not vary; none to read that one itself
    ///
    /// # Errors
    /// [`TrainError::File`] if there is no such checkpoint, or it is damaged.
    pub fn checkpoint(&self, timestep: usize, first: Option<&Checkpoint>) -> Result<Checkpoint, TrainError> {
        Checkpoint::load(&self.checkpoint_path(timestep), first, self.config.quantize.learned_offset)
    }

    /// Reads the checkpoints of all finished timesteps into one scene.
    ///
    /// # Errors
    /// [`TrainError::File`] if no timestep is finished, or a checkpoint is damaged.
    pub fn trained(&self) -> Result<TrainedScene, TrainError> {
        let finished = self.timesteps();
        if finished == 0 {
            let problem = "no checkpoint, expected a run with at least one finished timestep".into();
            return Err(TrainError::File { path: self.folder.join("checkpoints"), problem });
        }
        let first = self.checkpoint(0, None)?;
        let mut scene = DynamicGaussians::new(Arc::clone(first.parameters.gaussians.layout()));
        let mut mask_logits = Vec::with_capacity(finished);
        let mut quantizers = first.quantizers.clone();
        scene.push(first.parameters.gaussians.clone());
        mask_logits.push(first.parameters.mask_logits.clone());
        for timestep in 1..finished {
            let later = self.checkpoint(timestep, Some(&first))?;
            scene.push(later.parameters.gaussians);
            mask_logits.push(later.parameters.mask_logits);
            quantizers = later.quantizers;
        }
        Ok(TrainedScene {
            scene,
            mask_logits,
            foreground: first.parameters.foreground,
            quantization: quantizers.map(|q| (q.bit_map.clone(), q.table())),
            camera_gains: first.parameters.camera_gains,
            camera_offsets: first.parameters.camera_offsets,
        })
    }

    /// The JSON objects in `metrics.jsonl`, one per timestep.
    ///
    /// # Errors
    /// [`TrainError::Read`] if `metrics.jsonl` cannot be read.
    pub fn metrics(&self) -> Result<Vec<Value>, TrainError> {
        // A line cut short by a crash is one of a timestep that has no checkpoint yet.
        Ok(self.metrics_text()?.lines().filter_map(|line| serde_json::from_str(line).ok()).collect())
    }

    fn metrics_text(&self) -> Result<String, TrainError> {
        let path = self.folder.join(METRICS);
        if !path.exists() {
            return Ok(String::new());
        }
        fs::read_to_string(&path).map_err(read(&path))
    }

    /// Keeps the metrics of the first `timesteps` timesteps and removes the metrics that an interrupted run wrote after
    /// them.
    ///
    /// # Errors
    /// [`TrainError::Read`] or [`TrainError::Write`] if `metrics.jsonl` cannot be read or written.
    pub fn truncate_metrics(&self, timesteps: usize) -> Result<(), TrainError> {
        let kept = |line: &&str| {
            let metrics: Option<Value> = serde_json::from_str(line).ok();
            metrics.is_some_and(|m| m["timestep"].as_u64().is_some_and(|t| t < timesteps as u64))
        };
        // The lines as they are: printing what was parsed could change the last digit of a number.
        let text: String = self.metrics_text()?.lines().filter(kept).map(|line| format!("{line}\n")).collect();
        self.write_whole(METRICS, text.as_bytes())
    }

    /// Appends the metrics of one timestep to `metrics.jsonl`.
    ///
    /// - `metrics`: a JSON object, written as one line
    ///
    /// # Errors
    /// [`TrainError::Write`] if `metrics.jsonl` cannot be written.
    pub fn append_metrics(&self, metrics: &Value) -> Result<(), TrainError> {
        let path = self.folder.join(METRICS);
        let mut file = fs::OpenOptions::new().create(true).append(true).open(&path).map_err(write(&path))?;
        file.write_all(format!("{metrics}\n").as_bytes()).map_err(write(&path))
    }

    fn write_whole(&self, name: &str, bytes: &[u8]) -> Result<(), TrainError> {
        let path = self.folder.join(name);
        write_whole(&path, Existing::Replace, |file| file.write_all(bytes)).map_err(write(&path))
    }
}

fn read(path: &Path) -> impl Fn(std::io::Error) -> TrainError + use<> {
    let path = path.to_path_buf();
    move |error| TrainError::Read { path: path.clone(), error }
}

fn write(path: &Path) -> impl Fn(std::io::Error) -> TrainError + use<> {
    let path = path.to_path_buf();
    move |error| TrainError::Write { path: path.clone(), error }
}
