//! Results of training beside Gaussians: the run, its capture, lives, bits and masks.

use std::path::Path;

use tcgs_capture::Capture;
use tcgs_codec::{BitMap, Quantizers};
use tcgs_core::Lives;
use tcgs_train::{Checkpoint, Run, StandIns};

use super::kinds::RunContent;
use crate::{OpenScene, PipelineError, capture_for};

impl OpenScene {
    /// The run, if the scene is one; the first run of chapters.
    pub fn run(&self) -> Option<&Run> {
        self.content.run().map(|content| &content.run)
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
        self.content.lives()
    }

    /// Stand-ins for the Gaussians of a run at the timesteps at which they do not live.
    pub(crate) fn stand_ins(&self) -> Result<StandIns, PipelineError> {
        self.content.run().map_or_else(|| Ok(StandIns::none(&self.layout)), RunContent::stand_ins)
    }

    /// Bits and quantizers that a run learned; none for another scene, or if quantisation was off. Chapters give those
    /// of the first: the later ones have its bits, and continue its steps.
    pub(crate) fn learned_bits(&self) -> Result<Option<(BitMap, Quantizers)>, PipelineError> {
        self.content.run().map_or(Ok(None), RunContent::learned_bits)
    }

    /// The first checkpoint of a run.
    pub(crate) fn first_checkpoint(&self) -> Option<&Checkpoint> {
        self.content.run().map(|content| &content.first)
    }

    /// Mean mask of each Gaussian of a run over time (paper Eq. 6); none for a scene without masks. Reads only masks,
    /// one timestep after another.
    pub(crate) fn mean_masks(&self) -> Result<Option<Vec<f32>>, PipelineError> {
        if !self.run().is_some_and(|run| run.config().mask.enabled) {
            return Ok(None);
        }
        let mut failed = None;
        let logits = self.content.mask_logits().map_while(|logits| logits.map_err(|error| failed = Some(error)).ok());
        let means = tcgs_train::mean_masks(logits, self.lives());
        failed.map_or(Ok(Some(means)), |error| Err(error.into()))
    }
}
