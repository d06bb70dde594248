//! Long calls: progress for Python, and termination by Ctrl-C or an exception in a callback.

use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use tcgs_pipeline::{Event, Observer, PipelineError, PrepareStep};

use crate::detached::refuse_fork;
use crate::errors::exception;

/// Least time between two acquisitions of the interpreter's lock, which may wait for other threads.
const PATIENCE: Duration = Duration::from_millis(50);

/// Progress of a long call, for its callback.
#[pyclass(name = "Progress", module = "tcgs", frozen, get_all)]
#[derive(Default)]
pub struct PyProgress {
    /// The part of the call, such as "training".
    work: &'static str,
    /// Finished steps.
    done: usize,
    /// Steps in all; 0 if unknown.
    total: usize,
    /// Timestep of a training, from 0.
    timestep: Option<usize>,
    /// Frame of the capture.
    frame: Option<usize>,
    /// Weighted sum of the losses in an iteration.
    loss: Option<f64>,
    /// Mean PSNR of a trained timestep, or of a tried setting, dB.
    psnr: Option<f64>,
    /// Number of Gaussians in a training.
    num_gaussians: Option<usize>,
    /// Length of the file of a tried setting, bytes.
    bytes: Option<u64>,
    /// A warning in words, or None.
    message: Option<String>,
}

#[pymethods]
impl PyProgress {
    fn __repr__(&self) -> String {
        format!("Progress({} {}/{})", self.work, self.done, self.total)
    }
}

/// The observer of a long call.
pub struct Watch {
    callback: Option<Py<PyAny>>,
    /// The exception that Python raised.
    raised: Option<PyErr>,
    work: &'static str,
    done: usize,
    total: usize,
    looked: Instant,
}

impl Watch {
    /// Makes a call without the lock of the interpreter.
    ///
    /// - `callback`: called with a [`PyProgress`]; none: a line in a terminal or notebook, if `progress`
    ///
    /// # Errors
    /// The callback's exception, `KeyboardInterrupt` after Ctrl-C, or the exception of the call's error.
    pub fn call<T: Send>(
        py: Python<'_>,
        callback: Option<Py<PyAny>>,
        progress: bool,
        call: impl FnOnce(&mut Self) -> Result<T, PipelineError> + Send,
    ) -> PyResult<T> {
        refuse_fork()?;
        let callback = match callback {
            None if progress => {
                let bar = py.import("tcgs._progress")?.call_method0("bar")?;
                (!bar.is_none()).then(|| bar.unbind())
            }
            given => given,
        };
        let mut watch = Self { callback, raised: None, work: "", done: 0, total: 0, looked: Instant::now() };
        let result = py.detach(|| call(&mut watch));
        // Ctrl-C may have come after the last step.
        py.check_signals()?;
        match (result, watch.raised) {
            (Ok(value), None) => Ok(value),
            (_, Some(raised)) => Err(raised),
            (Err(error), None) => Err(exception(error)),
        }
    }

    /// Checks for Ctrl-C between two steps without progress.
    ///
    /// # Errors
    /// [`PipelineError::Stopped`] after Ctrl-C.
    pub fn check(&mut self) -> Result<(), PipelineError> {
        let asked = Python::attach(|py| py.check_signals());
        asked.map_err(|raised| {
            self.raised = Some(raised);
            PipelineError::Stopped
        })
    }

    fn ask(&mut self, progress: PyProgress) -> ControlFlow<()> {
        self.looked = Instant::now();
        let asked = Python::attach(|py| {
            py.check_signals()?;
            match &self.callback {
                Some(callback) => callback.call1(py, (progress,)).map(drop),
                None => Ok(()),
            }
        });
        match asked {
            Ok(()) => ControlFlow::Continue(()),
            Err(raised) => {
                self.raised = Some(raised);
                ControlFlow::Break(())
            }
        }
    }
}

impl Observer for Watch {
    fn hear(&mut self, event: &Event) -> ControlFlow<()> {
        let mut told = PyProgress::default();
        // Steps are numerous; other events are reported at once.
        let mut is_step = false;
        match event {
            Event::Begun { work, num_steps } => (self.work, self.done, self.total) = (work.name(), 0, *num_steps),
            Event::FewPoints { found, expected } => {
                told.message = Some(format!(
                    "warning: {found} points to start from, expected {expected} or more: what lies far from all of them \
                     stays empty"
                ));
            }
            Event::SetAside { checkpoint, problem } => {
                let checkpoint = checkpoint.display();
                told.message = Some(format!("{checkpoint}: {problem}; set aside, its timestep is trained again"));
            }
            Event::Iteration { progress, num_done } => {
                (self.done, is_step) = (*num_done, true);
                (told.timestep, told.loss) = (Some(progress.timestep), Some(progress.loss));
                told.num_gaussians = Some(progress.num_gaussians);
            }
            Event::Timestep { summary, num_done } => {
                self.done = *num_done;
                (told.timestep, told.frame) = (Some(summary.timestep), Some(summary.frame));
                (told.psnr, told.num_gaussians) = (Some(summary.psnr), Some(summary.num_gaussians));
            }
            Event::Tried(trial) => (told.bytes, told.psnr) = (Some(trial.bytes), trial.psnr),
            Event::Tuned(trial) => (told.bytes, told.psnr) = (Some(trial.bytes), Some(trial.psnr)),
            Event::Measured(trial) => told.bytes = Some(trial.bytes),
            Event::Step { num_done, .. } => (self.done, is_step) = (*num_done, true),
            Event::Prepared(PrepareStep::NoMasks { name, problem }) => {
                told.message = Some(format!("masks: none are made; {name}: {problem}"));
            }
            Event::Prepared(PrepareStep::PointsStrewn { why, .. }) => {
                told.message = Some(format!(
                    "warning: points are strewn where the cameras agree in colour: {why}; views between the cameras will be \
                     poor"
                ));
            }
            Event::Prepared(PrepareStep::LeftOver(warning)) => told.message = Some((*warning).into()),
            Event::Prepared(_) => return ControlFlow::Continue(()),
            Event::Frame(frame) => {
                self.done += 1;
                (told.frame, is_step) = (Some(*frame), self.done < self.total);
            }
            _ => {}
        }
        if is_step && self.looked.elapsed() < PATIENCE {
            return ControlFlow::Continue(());
        }
        (told.work, told.done, told.total) = (self.work, self.done, self.total);
        self.ask(told)
    }
}
