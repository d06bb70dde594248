//! Events of a long call, and its cancellation.

mod prepare_step;

use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;

use tcgs_core::View;
use tcgs_train::{Progress, Trained};

use crate::error::PipelineError;

pub use prepare_step::PrepareStep;

/// Something that happened in a long call.
#[derive(Clone, Copy, Debug)]
#[non_exhaustive]
pub enum Event<'a> {
    /// A part of the work begins.
    Begun {
        /// The part.
        work: Work,
        /// Its number of steps; [`Work`] defines a step.
        num_steps: usize,
    },
    /// A training starts from fewer points than a scene needs to become dense.
    FewPoints {
        /// Number of points.
        found: usize,
        /// Smallest number of points without a warning.
        expected: usize,
    },
    /// A checkpoint is damaged and was set aside; its timestep is to be trained again.
    SetAside {
        /// The file's original name.
        checkpoint: &'a Path,
        /// The problem with it.
        problem: &'a str,
    },
    /// A timestep is about to be trained.
    TimestepBegun {
        /// Counted from the run's first.
        timestep: usize,
        /// Frame of the capture.
        frame: usize,
        /// The views that its PSNR is measured on.
        judged: &'a Arc<[View]>,
        /// As [`TimestepSummary::held_out`].
        held_out: bool,
    },
    /// An iteration of [`Work::Training`] is computed.
    Iteration {
        /// The iteration.
        progress: &'a Progress,
        /// Steps of the work that are done.
        num_done: usize,
    },
    /// A timestep is trained: its metrics and its checkpoint are on the disk.
    Timestep {
        /// The timestep.
        summary: &'a TimestepSummary,
        /// Steps of the work that are done.
        num_done: usize,
    },
    /// A search for a target tried a setting.
    Tried(&'a Trial),
    /// Tuning tried a setting.
    Tuned(&'a TuningTrial),
    /// A search for small errors tried a setting.
    Measured(&'a ErrorTrial),
    /// A step of any other work: this frame, or an image of it, is done.
    Frame(usize),
    /// A step of [`prepare`](crate::prepare()) goes on.
    Step {
        /// Steps of the work that are done.
        num_done: usize,
        /// The current step in words.
        what: &'a str,
    },
    /// A step of [`prepare`](crate::prepare()) has a result.
    Prepared(&'a PrepareStep<'a>),
}

/// A timestep that is trained and saved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimestepSummary {
    /// Counted from the run's first.
    pub timestep: usize,
    /// Frame of the capture.
    pub frame: usize,
    /// Number of Gaussians after it.
    pub num_gaussians: usize,
    /// Trained share of the scene and of its views.
    pub trained: Trained,
    /// Weighted sum of the losses, mean over its last 50 iterations; 0 if it had none.
    pub loss: f64,
    /// Mean PSNR over the views, in dB.
    pub psnr: f64,
    /// Whether the views were held out from training; without held-out views they are the training views.
    pub held_out: bool,
    /// Seconds of training, without loading and measuring.
    pub seconds: f64,
}

/// One setting and its result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// Quality of [`CompressSettings::with_quality`](tcgs_codec::CompressSettings::with_quality), in hundredths.
    pub(crate) steps: i32,
    /// Length of the file.
    pub bytes: u64,
    /// Mean PSNR in dB; none if it was not measured.
    pub psnr: Option<f64>,
}

impl Trial {
    /// Settings that a search distinguishes within one unit of quality.
    pub(crate) const STEPS: i32 = 100;

    /// The quality tried, a whole number of hundredths.
    pub fn quality(&self) -> f64 {
        f64::from(self.steps) / f64::from(Self::STEPS)
    }
}

/// One setting and its errors.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorTrial {
    /// Length of the file.
    pub bytes: u64,
    /// For each bounded attribute its name and its largest error, as the file declares it; infinite if it cannot.
    pub errors: Vec<(String, f64)>,
}

/// A setting that tuning tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TuningTrial {
    /// The setting that was changed, in words.
    pub setting: &'static str,
    /// Length of the file.
    pub bytes: u64,
    /// Mean PSNR, dB.
    pub psnr: f64,
    /// Share of bytes saved at equal PSNR against the start, if it is the best so far; estimated by the curve of
    /// qualities. None if it is not better.
    pub saved: Option<f64>,
}

/// A part of a long call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Work {
    /// Timesteps are trained. A step is one of the iterations that the settings give to a timestep. A timestep may take
    /// fewer; all of its steps are done when it ends.
    Training,
    /// Images are rendered and compared. A step is an image.
    Evaluating,
    /// Images are rendered. A step is an image.
    Rendering,
    /// Timesteps are written for other programs. A step is a timestep.
    Exporting,
    /// Timesteps are compared. A step is a timestep.
    Verifying,
    /// Qualities are tried on training images before a refinement. A step is a timestep at one quality.
    Measuring,
    /// The codes of a compressed scene are trained. A step is an iteration.
    Refining,
    /// Clocks of videos are measured. A step is a thousandth.
    MeasuringClocks,
    /// COLMAP finds the cameras of videos.
    FindingCameras,
    /// A calibration is refined.
    RefiningCameras,
    /// Exposure and white balance of cameras are compared.
    ComparingColors,
    /// Masks are made. A step is a hundredth.
    Masking,
    /// Initial points are made.
    MakingPoints,
    /// A capture is checked.
    Checking,
}

impl Work {
    /// One word: `training`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Training => "training",
            Self::Evaluating => "evaluating",
            Self::Rendering => "rendering",
            Self::Exporting => "exporting",
            Self::Verifying => "verifying",
            Self::Measuring => "measuring",
            Self::Refining | Self::RefiningCameras => "refining",
            Self::MeasuringClocks => "clocks",
            Self::FindingCameras => "cameras",
            Self::ComparingColors => "colours",
            Self::Masking => "masks",
            Self::MakingPoints => "preparing",
            Self::Checking => "checking",
        }
    }
}

/// Hears the events of a long call, and may stop it. Every `FnMut(&Event) -> ControlFlow<()>` is an observer.
///
/// A call that is stopped returns [`PipelineError::Stopped`] and leaves nothing half-written.
///
/// ```
/// use std::ops::ControlFlow;
/// use tcgs_pipeline::{Event, Observer, Work};
/// let mut steps = 0;
/// let mut first_three = |event: &Event| {
///     steps += usize::from(matches!(event, Event::Frame(_)));
///     if steps < 3 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
/// };
/// assert!(first_three.hear(&Event::Begun { work: Work::Evaluating, num_steps: 9 }).is_continue());
/// ```
pub trait Observer {
    /// Called in the thread of the call, between two steps. [`ControlFlow::Break`] stops the call.
    fn hear(&mut self, event: &Event) -> ControlFlow<()>;
}

impl<F: FnMut(&Event) -> ControlFlow<()>> Observer for F {
    fn hear(&mut self, event: &Event) -> ControlFlow<()> {
        self(event)
    }
}

/// An observer that hears nothing and stops nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unobserved;

impl Observer for Unobserved {
    fn hear(&mut self, _: &Event) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

/// Reports an event; an observer that breaks off ends the call.
pub(crate) fn tell(observer: &mut dyn Observer, event: Event) -> Result<(), PipelineError> {
    match observer.hear(&event) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(PipelineError::Stopped),
    }
}
