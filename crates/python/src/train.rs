//! `tcgs.train`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use pyo3::exceptions::{PyFileExistsError, PyValueError};
use pyo3::prelude::*;
use tcgs_capture::Capture;
use tcgs_interchange::Existing;
use tcgs_pipeline::{OpenScene, OpenSettings, PipelineError, ReadyRun, RunFolder, fit, settings_for, start_state};
use tcgs_train::{Preset, TrainConfig};

use crate::capture::{CaptureLike, check_downscale};
use crate::errors::{exception, of_system};
use crate::numbers::{Whole, check_pair};
use crate::scene::{PyScene, SceneLike};
use crate::watch::Watch;

/// The state that a run continues: a scene and a timestep of it, or a scene, whose last timestep counts.
#[derive(FromPyObject)]
pub enum StartFrom<'py> {
    /// Negative timesteps count from the end.
    At(SceneLike<'py>, Whole),
    Last(SceneLike<'py>),
}

/// Trains a dynamic scene on a capture, one timestep after another, into a run folder.
///
/// - capture: a Capture or the name of its folder
/// - out: folder of the run
/// - preset: "default", "fast", "paper" or "d3dgs"
/// - frames: first frame and the one after the last, such as (0, 20); default: the frames that publications use, else
///   all
/// - downscale: average images over n x n pixels
/// - iterations: of the first and of every later timestep
/// - settings: by their names in the run's config.toml, such as {"weights.rigid": 2, "gate.enabled": False}
/// - config: file of settings, such as another run's config.toml
/// - points: file of initial points instead of the capture's own
/// - start_from: continue the state of a Scene, or of its file or folder, at its last timestep; or of a pair of scene
///   and timestep, such as ("base", 0). The first timestep is trained as a later one, and no Gaussian is added. So runs
///   that start from the same state are chapters of one scene: `tcgs.open(["chapter0", "chapter1"])` joins them
/// - seed: of random choices
/// - resume: continue the run in `out` after its last whole checkpoint, or begin it if there is none; omitted arguments
///   keep the run's settings
/// - overwrite: replace the run in `out`
/// - backend: "auto" (the GPU if there is one), "gpu" or "cpu"
/// - device: a part of the name of the GPU to compute on
/// - progress: show a line in a terminal or notebook
/// - callback: called with a Progress instead of the line; an exception in it ends the training
///
/// Returns the Scene of the run. After Ctrl-C or an exception in the callback, the run has the timesteps finished so
/// far. `resume=True` continues after them, with the same result as without interruption.
///
/// Raises ValueError or OSError if an input is wrong, FileExistsError if `out` holds a run.
#[pyfunction]
#[pyo3(signature = (capture, out, *, preset = None, frames = None, downscale = None, iterations = None, settings = None,
    config = None, points = None, start_from = None, seed = None, resume = false, overwrite = false, backend = "auto", device = None,
    progress = true, callback = None))]
#[allow(clippy::too_many_arguments, reason = "keywords of Python")]
pub fn train(
    py: Python<'_>,
    capture: CaptureLike,
    out: PathBuf,
    preset: Option<&str>,
    frames: Option<(Whole, Whole)>,
    downscale: Option<Whole>,
    iterations: Option<(Whole, Whole)>,
    settings: Option<BTreeMap<String, Bound<'_, PyAny>>>,
    config: Option<PathBuf>,
    points: Option<PathBuf>,
    start_from: Option<StartFrom<'_>>,
    seed: Option<Whole>,
    resume: bool,
    overwrite: bool,
    backend: &str,
    device: Option<&str>,
    progress: bool,
    callback: Option<Py<PyAny>>,
) -> PyResult<PyScene> {
    let frames = frames.map(|frames| check_pair("frames", frames)).transpose()?;
    let downscale = downscale.map(check_downscale).transpose()?;
    let iterations = iterations.map(|iterations| check_pair("iterations", iterations)).transpose()?;
    let seed = seed.map(|seed| seed.within("seed", 0..=u64::MAX)).transpose()?;
    let backend = crate::backend::backend(py, backend, device)?;
    let preset = preset.map(preset_named).transpose()?;
    let mut settings: Vec<(String, String)> =
        settings.iter().flatten().map(|(key, value)| toml(key, value)).collect::<PyResult<_>>()?;
    // Set by name, so that their ranges are checked.
    let mut set = |key: &str, value: Option<usize>| settings.extend(value.map(|value| (key.into(), value.to_string())));
    set("data.first_frame", frames.map(|frames| frames.0));
    set("data.end_frame", frames.map(|frames| frames.1));
    set("data.downscale", downscale);
    set("schedule.first_iterations", iterations.map(|iterations| iterations.0));
    set("schedule.rest_iterations", iterations.map(|iterations| iterations.1));
    if points.is_some() && start_from.is_some() {
        return Err(PyValueError::new_err("points: given with start_from, expected one of them"));
    }
    let start = start_from.map(|start_from| Start::open(py, start_from)).transpose()?;
    let folder = capture.path().to_path_buf();
    let capture = capture.open(py)?;
    let start_from = start.as_ref().map(Start::name).transpose()?;
    let wanted = Wanted { folder, preset, config, points, start_from, seed, settings };
    let holds_run = RunFolder::holds_run(&out).map_err(exception)?;
    if holds_run && !resume && !overwrite {
        let expected = "expected resume=True to go on with it or overwrite=True to replace it";
        return Err(PyFileExistsError::new_err(format!("{}: holds a run, {expected}", out.display())));
    }
    let fresh = if holds_run && resume {
        None
    } else {
        let mut wanted = wanted.clone();
        // The file of settings may be from a run that continues another one.
        wanted.start_from.get_or_insert_default();
        Some(wanted.over(settings_for(preset.unwrap_or(Preset::Default), &capture), &capture)?)
    };
    let mut refused = None;
    let trained = Watch::call(py, callback, progress, |watch| {
        let ready = match fresh {
            Some(config) => {
                let state =
                    start.map(|start| start_state(&start.scene, start.timestep, &config, &capture)).transpose()?;
                let existing = if overwrite { Existing::Replace } else { Existing::Keep };
                ReadyRun::begin(&out, existing, &config, &capture, state.as_ref(), &backend)?
            }
            None => {
                let change = |stored: &TrainConfig| {
                    wanted.over(stored.clone(), &capture).map_err(|error| {
                        refused = Some(error);
                        PipelineError::Stopped
                    })
                };
                ReadyRun::resume(&out, change, &capture, &backend, watch)?
            }
        };
        fit(&ready.capture, &ready.run, ready.trainer, watch)?;
        OpenScene::open(&out, OpenSettings::default())
    });
    match refused {
        Some(refused) => Err(refused),
        None => trained.map(|scene| PyScene(scene.into())),
    }
}

fn preset_named(name: &str) -> PyResult<Preset> {
    match name {
        "default" => Ok(Preset::Default),
        "fast" => Ok(Preset::Fast),
        "paper" => Ok(Preset::Paper),
        "d3dgs" => Ok(Preset::D3dgs),
        other => Err(PyValueError::new_err(format!("preset: is {other}, expected default, fast, paper or d3dgs"))),
    }
}

/// A setting as TOML: `True` is `true` there; numbers have the same text as in Python.
fn toml(key: &str, value: &Bound<'_, PyAny>) -> PyResult<(String, String)> {
    let text = value.str()?.to_string();
    let is_bool = value.is_instance_of::<pyo3::types::PyBool>();
    Ok((key.into(), if is_bool { text.to_lowercase() } else { text }))
}

/// An opened scene, and the timestep that a run continues.
struct Start {
    scene: Arc<OpenScene>,
    timestep: usize,
    is_last: bool,
}

impl Start {
    fn open(py: Python<'_>, start_from: StartFrom) -> PyResult<Self> {
        let (scene, timestep) = match start_from {
            StartFrom::At(scene, timestep) => (scene, Some(timestep)),
            StartFrom::Last(scene) => (scene, None),
        };
        let scene = scene.open(py)?;
        let found = PyScene(Arc::clone(&scene)).timestep(timestep.map_or(-1, Whole::index))?;
        Ok(Self { scene, timestep: found, is_last: timestep.is_none() })
    }

    /// Its name in a run's `config.toml`.
    fn name(&self) -> PyResult<String> {
        let path = absolute(&self.scene.path)?;
        Ok(if self.is_last { path } else { format!("{path}@{}", self.timestep) })
    }
}

/// Changes to a preset's or a run's settings.
#[derive(Clone)]
struct Wanted {
    /// Folder of the capture.
    folder: PathBuf,
    preset: Option<Preset>,
    config: Option<PathBuf>,
    points: Option<PathBuf>,
    /// Its name in `config.toml`; empty for none; `None` keeps the run's.
    start_from: Option<String>,
    seed: Option<u64>,
    /// Names and values in TOML.
    settings: Vec<(String, String)>,
}

impl Wanted {
    fn over(&self, mut base: TrainConfig, capture: &Capture) -> PyResult<TrainConfig> {
        if let Some(preset) = self.preset {
            base.preset = preset;
        }
        // The file may be from a run that continues another one.
        let start_from = base.data.start_from.clone();
        if let Some(path) = &self.config {
            let text = tcgs_core::read_text(path, TrainConfig::MAX_BYTES)
                .map_err(|error| of_system(error.kind(), format!("{}: {error}", path.display())))?;
            let merged = base.merge(&text);
            base = merged.map_err(|error| PyValueError::new_err(format!("{}: {error}", path.display())))?;
        }
        // The file may be another run's, so the given capture replaces its capture.
        base.data.capture = absolute(&self.folder)?;
        base.data.layout = capture.kind().name.into();
        if let Some(points) = &self.points {
            base.data.points = absolute(points)?;
        }
        base.data.start_from = self.start_from.clone().unwrap_or(start_from);
        let named = base.data.clone();
        for (key, value) in &self.settings {
            base.set(key, value).map_err(|error| PyValueError::new_err(format!("settings: {error}")))?;
        }
        if (&base.data.capture, &base.data.layout, &base.data.start_from)
            != (&named.capture, &named.layout, &named.start_from)
        {
            let message = "settings: data.capture, data.layout or data.start_from: is what capture and start_from say, expected no other";
            return Err(PyValueError::new_err(message));
        }
        if let Some(seed) = self.seed {
            base.seed = seed;
        }
        Ok(base)
    }
}

/// An absolute path, so that a run finds its capture and points from any folder.
fn absolute(path: &Path) -> PyResult<String> {
    let found = path.canonicalize().map_err(|error| of_system(error.kind(), format!("{}: {error}", path.display())))?;
    found.into_os_string().into_string().map_err(|path| {
        let expected = "expected one that config.toml can hold";
        PyValueError::new_err(format!("{}: not a name in UTF-8, {expected}", path.display()))
    })
}
