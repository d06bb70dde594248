//! From settings to a run that can be trained: begun or resumed.

use std::path::Path;

use tcgs_capture::Capture;
use tcgs_interchange::Existing;
use tcgs_train::{Checkpoint, Run, TrainConfig, Trainer};

use super::{RunFolder, continued_trainer, new_trainer};
use crate::{Backend, Observer, PipelineError, capture_for};

/// A run that is ready for [`fit`](crate::fit). Its folder is locked while this lives.
#[derive(Debug)]
pub struct ReadyRun {
    /// The capture that [`fit`](crate::fit) trains it on: the cameras of `data.hold_out` are test cameras.
    pub capture: Capture,
    /// The run.
    pub run: Run,
    /// Ready for the timestep after those that the run has.
    pub trainer: Trainer,
    /// The run's folder, locked.
    pub folder: RunFolder,
}

impl ReadyRun {
    /// Begins a run. An existing run in the folder is removed after all checks of the input.
    ///
    /// - `existing`: whether there may be an earlier run
    /// - `start`: the state that the run continues ([`start_state`](crate::start_state)); none to start from points
    ///
    /// # Errors
    /// [`PipelineError::Input`] if the folder holds other things, or a run that is to be kept;
    /// [`PipelineError::Frames`] if the capture lacks a frame of the settings; as [`new_trainer`] and
    /// [`RunFolder::make`]; [`PipelineError::Train`] if a file cannot be written.
    pub fn begin(
        path: &Path,
        existing: Existing,
        config: &TrainConfig,
        capture: &Capture,
        start: Option<&Checkpoint>,
        backend: &Backend,
    ) -> Result<Self, PipelineError> {
        check_frames(config, capture)?;
        let trainer = match start {
            Some(start) => continued_trainer(config, start, backend),
            None => new_trainer(config, capture, backend)?,
        };
        let folder = RunFolder::make(path)?;
        // Another process may have begun and ended a run since the caller's check.
        if RunFolder::holds_run(path)? && existing == Existing::Keep {
            return Err(PipelineError::input(path.display(), "holds a run by now", "a new name"));
        }
        folder.clear()?;
        if let Some(start) = start {
            Run::save_start(path, start)?;
        }
        let capture = capture_for(config, capture)?.into_owned();
        Ok(Self { capture, run: Run::create(path, config)?, trainer, folder })
    }

    /// Resumes a run after its last whole checkpoint ([`RunFolder::resume`]).
    ///
    /// - `change`: maps the run's settings to new ones, of which only the end of the frames may differ
    ///
    /// # Errors
    /// [`PipelineError::Input`] if another setting differs, or the new end is before a timestep that is trained;
    /// [`PipelineError::Frames`] if the capture lacks a frame; as [`RunFolder::lock`] and [`RunFolder::resume`]; the
    /// errors of `change`.
    pub fn resume<E: From<PipelineError>>(
        path: &Path,
        change: impl FnOnce(&TrainConfig) -> Result<TrainConfig, E>,
        capture: &Capture,
        backend: &Backend,
        observer: &mut dyn Observer,
    ) -> Result<Self, E> {
        let folder = RunFolder::lock(path)?;
        let run = Run::open(path).map_err(PipelineError::from)?;
        let config = change(run.config())?;
        Ok(Self::go_on(folder, run, &config, path, capture, backend, observer)?)
    }

    fn go_on(
        folder: RunFolder,
        mut run: Run,
        config: &TrainConfig,
        path: &Path,
        capture: &Capture,
        backend: &Backend,
        observer: &mut dyn Observer,
    ) -> Result<Self, PipelineError> {
        let mut with_same_end = config.clone();
        with_same_end.data.end_frame = run.config().data.end_frame;
        if let Some(key) = with_same_end.first_difference(run.config()) {
            let found = format!("{key} differs from the run's");
            return Err(PipelineError::input(path.display(), found, "only the end of the frames to change"));
        }
        check_frames(config, capture)?;
        folder.remove_leftovers()?;
        let resumed = folder.resume(&run, backend, observer)?;
        let num_timesteps = resumed.as_ref().map_or(0, Trainer::timesteps);
        let (first, end) = (config.data.first_frame, config.data.end_frame);
        if end < first + num_timesteps {
            let trained = first + num_timesteps;
            let found = format!("has trained the frames {first}..{trained}, found {first}..{end}");
            return Err(PipelineError::input(path.display(), found, "no earlier end"));
        }
        run.truncate_metrics(num_timesteps)?;
        if config != run.config() {
            run.set_config(config)?;
        }
        let trainer = match resumed {
            Some(trainer) => trainer,
            None => match run.start()? {
                Some(start) => continued_trainer(config, &start, backend),
                None => new_trainer(config, capture, backend)?,
            },
        };
        let capture = capture_for(config, capture)?.into_owned();
        Ok(Self { capture, run, trainer, folder })
    }
}

fn check_frames(config: &TrainConfig, capture: &Capture) -> Result<(), PipelineError> {
    let (wanted, has) = (config.data.first_frame..config.data.end_frame, 0..capture.num_frames());
    if wanted.is_empty() || wanted.end > has.end {
        return Err(PipelineError::Frames { path: config.data.capture.clone().into(), wanted, has });
    }
    Ok(())
}
