//! Runs as scenes: timesteps from checkpoints, and results of training beside Gaussians: capture, lives, bits, masks.

use std::path::Path;

use tcgs_capture::Capture;
use tcgs_codec::{BitMap, Quantizers};
use tcgs_core::Lives;
use tcgs_train::{Checkpoint, Parameters, Run, StandIns, TrainError};

use super::Content;
use crate::{OpenScene, PipelineError, capture_for};

#[derive(Debug)]
pub(super) struct RunContent {
    pub run: Run,
    /// The first checkpoint, with the values that the others do not repeat.
    pub first: Checkpoint,
    /// As returned by [`Run::lives`].
    pub lives: Option<Lives>,
    pub num_timesteps: usize,
}

impl RunContent {
    pub fn num_identities(&self) -> usize {
        self.lives.as_ref().map_or(self.first.parameters.num_gaussians(), |lives| lives.len())
    }

    pub fn num_gaussians_at(&self, timestep: usize) -> usize {
        let lives = self.lives.as_ref();
        lives.map_or(self.first.parameters.num_gaussians(), |lives| lives.num_living(timestep))
    }

    pub fn checkpoint(&self, timestep: usize) -> Result<Checkpoint, PipelineError> {
        if timestep == 0 {
            return Ok(self.first.clone());
        }
        Ok(self.run.checkpoint(timestep, Some(&self.first))?)
    }

    pub fn parameters(&self, timestep: usize) -> Result<Parameters, PipelineError> {
        Ok(self.run.living(timestep, &self.first, self.lives.as_ref())?)
    }

    pub fn mask_logits(&self) -> impl Iterator<Item = Result<Vec<f32>, TrainError>> {
        self.run.mask_logits(self.num_timesteps, &self.first, self.lives.as_ref())
    }
}

impl OpenScene {
    /// The run, if the scene is one; the first run of chapters.
    pub fn run(&self) -> Option<&Run> {
        match &self.content {
            Content::Run(run) => Some(&run.run),
            Content::Chapters(chapters) => chapters.first().run(),
            _ => None,
        }
    }

    /// Folder of the capture on which the run was trained; `None` if the scene is no run, or was trained on images of a
    /// program's own.
    pub fn capture(&self) -> Option<&Path> {
        let capture = &self.run()?.config().data.capture;
        (!capture.is_empty()).then(|| Path::new(capture))
    }

    /// A capture to compare this scene with, or to train it on. Cameras that the scene's run held out are held out
    /// here, too.
    ///
    /// - `path`: the capture's folder
    ///
    /// # Errors
    /// [`PipelineError::Capture`] if it cannot be opened, or lacks a camera that was held out.
    pub(crate) fn open_capture(&self, path: &Path) -> Result<Capture, PipelineError> {
        let capture = Capture::open(path)?;
        match self.run() {
            Some(run) => Ok(capture_for(run.config(), &capture)?.into_owned()),
            None => Ok(capture),
        }
    }

    /// Lives of a run's Gaussians; none if all live at all timesteps.
    pub(crate) fn lives(&self) -> Option<&Lives> {
        match &self.content {
            Content::Run(run) => run.lives.as_ref(),
            Content::Floats { lives, .. } => lives.as_ref(),
            _ => None,
        }
    }

    /// Stand-ins for the Gaussians of a run at the timesteps at which they do not live.
    pub(crate) fn stand_ins(&self) -> Result<StandIns, PipelineError> {
        match &self.content {
            Content::Run(run) => Ok(run.run.stand_ins(&run.first, run.num_timesteps)?),
            _ => Ok(StandIns::none(&self.layout)),
        }
    }

    /// Bits and quantizers that a run learned; none for another scene, or if quantisation was off. Chapters give those
    /// of the first: the later ones have its bits, and continue its steps.
    pub(crate) fn learned_bits(&self) -> Result<Option<(BitMap, Quantizers)>, PipelineError> {
        if let Content::Chapters(chapters) = &self.content {
            return chapters.first().learned_bits();
        }
        let Content::Run(run) = &self.content else { return Ok(None) };
        // Includes the bits of dead Gaussians.
        let Some(first) = &run.first.quantizers else { return Ok(None) };
        let bit_map = first.bit_map_of(run.num_identities());
        let last = run.checkpoint(run.num_timesteps - 1)?;
        Ok(last.quantizers.map(|q| (bit_map, q.table())))
    }

    /// The first checkpoint of a run.
    pub(crate) fn first_checkpoint(&self) -> Option<&Checkpoint> {
        match &self.content {
            Content::Run(run) => Some(&run.first),
            Content::Chapters(chapters) => chapters.first().first_checkpoint(),
            _ => None,
        }
    }

    /// Mean mask of each Gaussian of a run over time (paper Eq. 6); none for a scene without masks. Reads only masks,
    /// one timestep after another.
    pub(crate) fn mean_masks(&self) -> Result<Option<Vec<f32>>, PipelineError> {
        if !self.run().is_some_and(|run| run.config().mask.enabled) {
            return Ok(None);
        }
        let mut failed = None;
        let logits: Box<dyn Iterator<Item = _>> = match &self.content {
            Content::Chapters(chapters) => Box::new(chapters.mask_logits()),
            Content::Run(run) => Box::new(run.mask_logits()),
            _ => return Ok(None),
        };
        let logits = logits.map_while(|logits| logits.map_err(|error| failed = Some(error)).ok());
        let means = tcgs_train::mean_masks(logits, self.lives());
        failed.map_or(Ok(Some(means)), |error| Err(error.into()))
    }
}
