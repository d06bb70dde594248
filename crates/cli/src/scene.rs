//! What commands call a SCENE, and how one is described.

use std::path::Path;

use clap::Args;
use tcgs_interchange::HigherHarmonics;
use tcgs_pipeline::{Fault, HasFault, OpenScene, OpenSettings, PipelineError};

use crate::error::wrong_input;
use crate::output::show_bytes;

/// How a SCENE is read.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct SceneOptions {
    /// Of PLY files, leave out spherical harmonics above degree 0: colours stop depending on the view
    #[arg(long)]
    pub drop_sh: bool,
}

impl SceneOptions {
    /// Opens a scene.
    pub fn open(self, path: &Path) -> Result<OpenScene, PipelineError> {
        let higher_harmonics = if self.drop_sh { HigherHarmonics::Drop } else { HigherHarmonics::Refuse };
        OpenScene::open(path, OpenSettings { higher_harmonics })
    }
}

/// What a scene is, in words.
pub fn describe(scene: &OpenScene) -> String {
    let (path, kind, size) = (scene.path.display(), scene.kind(), show_bytes(scene.bytes));
    format!("{path} ({kind}): {} Gaussians, {} timesteps, {size}", scene.num_gaussians(), scene.num_timesteps())
}

/// A file given by the user that cannot be read.
///
/// - `expected`: what it should have been
pub fn unreadable(path: &Path, error: std::io::Error, expected: &str) -> anyhow::Error {
    let message = format!("{}: {error}, expected {expected}", path.display());
    match error.fault() {
        Fault::Input => wrong_input(message),
        _ => anyhow::anyhow!(message),
    }
}
