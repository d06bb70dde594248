//! Run folders, whose timesteps are checkpoints.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_codec::{BitMap, Quantizers};
use tcgs_core::{Drawable, DynamicGaussians, Gaussians, Lives};
use tcgs_train::{Checkpoint, Parameters, Run, StandIns};

use crate::PipelineError;
use crate::scene::content::MaskLogits;
use crate::scene::open::SceneKind;
use crate::scene::{OpenScene, OpenSettings, SceneContent};

pub(crate) const KIND: SceneKind =
    SceneKind { mark: "a run folder", endings: &[], starts: &[], is_folder: Run::is_run, open };

#[derive(Debug)]
pub(crate) struct RunContent {
    pub run: Run,
    /// The first checkpoint, with the values that the others do not repeat.
    pub first: Checkpoint,
    /// As returned by [`Run::lives`].
    lives: Option<Lives>,
    num_timesteps: usize,
}

fn open(path: &Path, _: OpenSettings) -> Result<OpenScene, PipelineError> {
    let run = Run::open(path)?;
    let num_timesteps = run.timesteps();
    if num_timesteps == 0 {
        let (culprit, expected) = (path.join("checkpoints"), "a run with at least one finished timestep");
        return Err(PipelineError::input(culprit.display(), "no checkpoint", expected));
    }
    let (first, lives) = (run.checkpoint(0, None)?, run.lives(num_timesteps)?);
    let content = RunContent { run, first, lives, num_timesteps };
    let (data, layout) = (&content.run.config().data, Arc::clone(content.first.parameters.gaussians.layout()));
    Ok(OpenScene {
        path: path.into(),
        first_frame: data.first_frame,
        downscale: data.downscale,
        frame_rate: data.frame_rate,
        bytes: layout.raw_bytes(content.num_identities(), num_timesteps),
        kind: "run folder",
        num_timesteps,
        num_identities: Some(content.num_identities()),
        layout,
        content: Box::new(content),
    })
}

impl RunContent {
    fn num_identities(&self) -> usize {
        self.lives.as_ref().map_or(self.first.parameters.num_gaussians(), |lives| lives.len())
    }

    fn parameters(&self, timestep: usize) -> Result<Parameters, PipelineError> {
        Ok(self.run.living(timestep, &self.first, self.lives.as_ref())?)
    }

    /// Stand-ins for the Gaussians at the timesteps at which they do not live.
    pub fn stand_ins(&self) -> Result<StandIns, PipelineError> {
        match self.lives {
            Some(_) => Ok(self.run.stand_ins(&self.first, self.num_timesteps)?),
            None => Ok(StandIns::none(self.first.parameters.gaussians.layout())),
        }
    }

    /// Bits and quantizers at the end of the run; none if quantisation was off.
    pub fn learned_bits(&self) -> Result<Option<(BitMap, Quantizers)>, PipelineError> {
        // Includes the bits of dead Gaussians.
        let Some(first) = &self.first.quantizers else { return Ok(None) };
        let bit_map = first.bit_map_of(self.num_identities());
        let last = match self.num_timesteps - 1 {
            0 => self.first.quantizers.clone(),
            last => self.run.checkpoint(last, Some(&self.first))?.quantizers,
        };
        Ok(last.map(|quantizers| (bit_map, quantizers.table())))
    }
}

impl SceneContent for RunContent {
    fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        Ok(self.parameters(timestep)?.gaussians)
    }

    fn floats(&self) -> Result<Option<Cow<'_, DynamicGaussians>>, PipelineError> {
        Ok(Some(Cow::Owned(self.run.trained_until(self.num_timesteps)?.scene)))
    }

    fn drawn(&self, timestep: usize) -> Result<Drawable, PipelineError> {
        let (mask, parameters) = (&self.run.config().mask, self.parameters(timestep)?);
        if !mask.enabled {
            return Ok(Drawable::new(&parameters.gaussians));
        }
        let masked = tcgs_train::masked_out(&parameters.mask_logits, mask.threshold);
        let shown: Vec<usize> = (0..masked.len()).filter(|&i| !masked[i]).collect();
        Ok(Drawable::new(&parameters.gaussians.select(&shown)))
    }

    fn files(&self, _: &Path) -> Vec<PathBuf> {
        (0..self.num_timesteps).map(|timestep| self.run.checkpoint_path(timestep)).collect()
    }

    fn lives(&self) -> Option<&Lives> {
        self.lives.as_ref()
    }

    fn foreground(&self, timestep: usize) -> Result<Option<Vec<bool>>, PipelineError> {
        Ok(Some(match self.lives {
            Some(_) => self.parameters(timestep)?.foreground,
            None => self.first.parameters.foreground.clone(),
        }))
    }

    fn run(&self) -> Option<&RunContent> {
        Some(self)
    }

    fn mask_logits(&self) -> MaskLogits<'_> {
        Box::new(self.run.mask_logits(self.num_timesteps, &self.first, self.lives.as_ref()))
    }
}
