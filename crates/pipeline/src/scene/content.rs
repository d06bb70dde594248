//! The questions that [`OpenScene`](super::OpenScene) asks its content. What lives here: the trait. What does not: its
//! implementations (`kinds`), and values that are fixed when a scene is opened: these are fields of `OpenScene`.

use std::borrow::Cow;
use std::fmt::Debug;
use std::iter;
use std::ops::Range;
use std::path::{Path, PathBuf};

use tcgs_codec::{FileCamera, Loss, SceneInfo};
use tcgs_core::{Drawable, DynamicGaussians, Gaussians, Lives, Trust};
use tcgs_interchange::{Axes, ReadNote};
use tcgs_train::TrainError;

use super::kinds::RunContent;
use crate::PipelineError;

/// Mask logits of one timestep after another.
pub(crate) type MaskLogits<'a> = Box<dyn Iterator<Item = Result<Vec<f32>, TrainError>> + 'a>;

/// The content of a scene. A method without a comment is the one of [`OpenScene`](super::OpenScene) with this name; a
/// default is the answer of a kind that has no such thing.
pub(crate) trait SceneContent: Debug + Send + Sync {
    /// None if all Gaussians of the scene live at all timesteps. A kind that does not identify them answers always.
    fn num_gaussians_at(&self, timestep: usize) -> Option<usize> {
        self.lives().map(|lives| lives.num_living(timestep))
    }

    /// - `timestep`: one of the scene
    fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError>;

    /// All timesteps; none of a kind whose timesteps are read with [`Self::at`].
    fn floats(&self) -> Result<Option<Cow<'_, DynamicGaussians>>, PipelineError> {
        Ok(None)
    }

    /// - `timestep`: one of the scene
    fn drawn(&self, timestep: usize) -> Result<Drawable, PipelineError> {
        Ok(Drawable::new(&self.at(timestep)?.lit(self.light(timestep))))
    }

    /// See [`SceneReader::span`](tcgs_core::SceneReader::span).
    fn span(&self, timestep: usize) -> Range<usize> {
        timestep..timestep + 1
    }

    /// Files of the scene; none if it is in memory.
    ///
    /// - `path`: of the scene
    fn files(&self, path: &Path) -> Vec<PathBuf> {
        vec![path.into()]
    }

    fn has_loose_timesteps(&self) -> bool {
        false
    }

    fn segment_length(&self) -> Option<u32> {
        None
    }

    fn notes(&self) -> Vec<ReadNote> {
        Vec::new()
    }

    fn axes(&self) -> Option<Axes> {
        None
    }

    /// The description in a compressed scene; none for any other.
    fn info(&self) -> Option<&SceneInfo> {
        None
    }

    fn cameras(&self) -> Result<Vec<FileCamera>, PipelineError> {
        Ok(Vec::new())
    }

    fn trust(&self) -> Result<Option<Trust>, PipelineError> {
        Ok(None)
    }

    fn light(&self, _timestep: usize) -> [f32; 3] {
        [1.0; 3]
    }

    fn loss(&self) -> Option<&Loss> {
        None
    }

    fn declared_errors(&self) -> Vec<(String, f32)> {
        Vec::new()
    }

    /// Whether the files say [`OpenScene::first_frame`](super::OpenScene::first_frame).
    fn declares_first_frame(&self) -> bool {
        true
    }

    /// Whether the files say this frame rate of the scene.
    fn declares_frame_rate(&self, frame_rate: f64) -> bool {
        frame_rate > 0.0
    }

    fn lives(&self) -> Option<&Lives> {
        None
    }

    fn living(&self, timestep: usize) -> Result<Option<Vec<usize>>, PipelineError> {
        Ok(self.lives().map(|lives| lives.living(timestep)))
    }

    fn foreground(&self, _timestep: usize) -> Result<Option<Vec<bool>>, PipelineError> {
        Ok(None)
    }

    /// The run; the first one of chapters.
    fn run(&self) -> Option<&RunContent> {
        None
    }

    /// Mask logits of every timestep of runs.
    fn mask_logits(&self) -> MaskLogits<'_> {
        Box::new(iter::empty())
    }
}
