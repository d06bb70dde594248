//! Gaussians in memory.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_core::{DynamicGaussians, Gaussians, Lives};

use crate::PipelineError;
use crate::scene::{OpenScene, SceneContent};

#[derive(Debug)]
struct FloatsContent {
    floats: DynamicGaussians,
    lives: Option<Lives>,
}

/// - `lives`: none if all Gaussians live at all timesteps
/// - returns: a scene from frame 0 on, without a frame rate
pub(crate) fn of_floats(path: &Path, floats: DynamicGaussians, lives: Option<Lives>, kind: &'static str) -> OpenScene {
    OpenScene {
        path: path.into(),
        first_frame: 0,
        downscale: 1,
        frame_rate: 0.0,
        bytes: floats.raw_bytes(),
        kind,
        num_timesteps: floats.num_timesteps(),
        num_identities: Some(floats.num_gaussians()),
        layout: Arc::clone(floats.layout()),
        content: Box::new(FloatsContent { floats, lives }),
    }
}

impl SceneContent for FloatsContent {
    fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        let all = self.floats.at(timestep);
        Ok(match &self.lives {
            Some(lives) => all.select(&lives.living(timestep)),
            None => all,
        })
    }

    fn floats(&self) -> Result<Option<Cow<'_, DynamicGaussians>>, PipelineError> {
        Ok(Some(Cow::Borrowed(&self.floats)))
    }

    fn files(&self, _: &Path) -> Vec<PathBuf> {
        Vec::new()
    }

    fn declares_first_frame(&self) -> bool {
        false
    }

    fn lives(&self) -> Option<&Lives> {
        self.lives.as_ref()
    }
}
