//! PLY, SPZ, glTF or SOG: one file, or a folder with one for each timestep.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_core::{DynamicGaussians, Gaussians, SceneReader};
use tcgs_interchange::{Axes, ReadNote, TimestepFiles};

use super::found::trained_file;
use crate::PipelineError;
use crate::scene::open::{SceneKind, has_ending, refuse_unread};
use crate::scene::{OpenScene, OpenSettings, SceneContent};

pub(crate) const KIND: SceneKind = SceneKind {
    mark: "PLY, SPZ, glTF or SOG files",
    endings: &["ply", "spz", "glb", "gltf", "sog", "splat", "ksplat"],
    starts: &[b"ply", b"NGSP", b"\x1F\x8B", b"glTF"],
    is_folder: |path| trained_file(path).is_some() || TimestepFiles::is_folder(path),
    open,
};

fn open(path: &Path, settings: OpenSettings) -> Result<OpenScene, PipelineError> {
    let is_folder = path.is_dir();
    if !is_folder && !has_ending(path, KIND.endings) {
        // The first bytes of a file that is not read are arbitrary.
        refuse_unread(path)?;
    }
    let trained = is_folder.then(|| trained_file(path)).flatten();
    let path = trained.as_deref().unwrap_or(path);
    let files = TimestepFiles::open(path, settings.read)?;
    Ok(OpenScene {
        path: path.into(),
        first_frame: files.first_frame().unwrap_or(0) as usize,
        downscale: 1,
        frame_rate: 30.0,
        bytes: files.raw_bytes(),
        kind: files.kind(),
        num_timesteps: files.num_timesteps(),
        num_identities: files.num_identities(),
        layout: Arc::clone(files.layout()),
        content: Box::new(files),
    })
}

impl SceneContent for TimestepFiles {
    fn num_gaussians_at(&self, timestep: usize) -> Option<usize> {
        Some(SceneReader::num_gaussians_at(self, timestep))
    }

    fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        Ok(TimestepFiles::at(self, timestep)?)
    }

    fn floats(&self) -> Result<Option<Cow<'_, DynamicGaussians>>, PipelineError> {
        Ok(Some(Cow::Owned(self.read(0..self.num_timesteps())?)))
    }

    fn files(&self, _: &Path) -> Vec<PathBuf> {
        self.files_and_images()
    }

    fn has_loose_timesteps(&self) -> bool {
        true
    }

    fn notes(&self) -> Vec<ReadNote> {
        TimestepFiles::notes(self)
    }

    fn axes(&self) -> Option<Axes> {
        Some(TimestepFiles::axes(self))
    }

    fn declares_first_frame(&self) -> bool {
        self.first_frame().is_some()
    }

    fn declares_frame_rate(&self, _: f64) -> bool {
        false
    }
}
