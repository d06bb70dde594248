//! `.4dgs` files, in memory.

use std::path::Path;
use std::sync::Arc;

use tcgs_core::{Gaussians, SceneReader};
use tcgs_interchange::{Axes, FourdgsFile, ReadNote};

use crate::PipelineError;
use crate::scene::open::SceneKind;
use crate::scene::{OpenScene, OpenSettings, SceneContent};

pub(crate) const KIND: SceneKind =
    SceneKind { mark: "a .4dgs file", endings: &["4dgs"], starts: &[b"\x894DG"], is_folder: |_| false, open };

fn open(path: &Path, settings: OpenSettings) -> Result<OpenScene, PipelineError> {
    let file = FourdgsFile::open(path, settings.read)?;
    Ok(OpenScene {
        path: path.into(),
        first_frame: 0,
        downscale: 1,
        frame_rate: file.frame_rate(),
        bytes: file.raw_bytes(),
        kind: ".4dgs file",
        num_timesteps: file.num_timesteps(),
        num_identities: file.num_identities(),
        layout: Arc::clone(file.layout()),
        content: Box::new(file),
    })
}

impl SceneContent for FourdgsFile {
    fn num_gaussians_at(&self, timestep: usize) -> Option<usize> {
        Some(SceneReader::num_gaussians_at(self, timestep))
    }

    fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        Ok(FourdgsFile::at(self, timestep)?)
    }

    fn has_loose_timesteps(&self) -> bool {
        true
    }

    fn notes(&self) -> Vec<ReadNote> {
        FourdgsFile::notes(self)
    }

    fn axes(&self) -> Option<Axes> {
        Some(FourdgsFile::axes(self))
    }

    fn declares_first_frame(&self) -> bool {
        false
    }
}
