//! `params.npz` of Dynamic 3D Gaussians, of which a timestep is read on demand.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use tcgs_core::{DynamicGaussians, Gaussians, SceneReader};
use tcgs_interchange::{ParamsNpz, ParamsOrigin, ReadLimits, read_params_foreground, read_params_origin};

use crate::PipelineError;
use crate::scene::open::{SceneKind, refuse_unread};
use crate::scene::{OpenScene, OpenSettings, SceneContent};

pub(crate) const KIND: SceneKind =
    SceneKind { mark: "a params.npz", endings: &["npz"], starts: &[b"PK\x03\x04"], is_folder: |_| false, open };

#[derive(Debug)]
struct ParamsContent {
    path: PathBuf,
    num_gaussians: usize,
    /// Whether the file declares its frames.
    has_origin: bool,
    /// Limits under which the file was opened.
    limits: ReadLimits,
    file: Mutex<ParamsNpz>,
}

fn open(path: &Path, settings: OpenSettings) -> Result<OpenScene, PipelineError> {
    refuse_unread(path)?;
    let limits = settings.read.limits;
    let params = ParamsNpz::open(path, limits)?;
    let (num_gaussians, num_timesteps) = (params.num_gaussians_at(0), params.num_timesteps());
    let layout = Arc::clone(params.layout());
    let declared = read_params_origin(path, limits)?;
    let origin = declared.unwrap_or(ParamsOrigin { first_frame: 0, downscale: 1, frame_rate: 30.0 });
    let (has_origin, file) = (declared.is_some(), Mutex::new(params));
    Ok(OpenScene {
        path: path.into(),
        first_frame: origin.first_frame as usize,
        downscale: origin.downscale as usize,
        frame_rate: f64::from(origin.frame_rate),
        bytes: layout.raw_bytes(num_gaussians, num_timesteps),
        kind: "Dynamic 3D Gaussians parameters",
        num_timesteps,
        num_identities: Some(num_gaussians),
        layout,
        content: Box::new(ParamsContent { path: path.into(), num_gaussians, has_origin, limits, file }),
    })
}

impl SceneContent for ParamsContent {
    fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        // A panic elsewhere leaves the file at another position, and every read begins with a seek.
        Ok(self.file.lock().unwrap_or_else(PoisonError::into_inner).at(timestep)?)
    }

    fn floats(&self) -> Result<Option<Cow<'_, DynamicGaussians>>, PipelineError> {
        Ok(Some(Cow::Owned(ParamsNpz::open(&self.path, self.limits)?.read_all()?)))
    }

    fn declares_first_frame(&self) -> bool {
        self.has_origin
    }

    fn declares_frame_rate(&self, _: f64) -> bool {
        self.has_origin
    }

    fn foreground(&self, _: usize) -> Result<Option<Vec<bool>>, PipelineError> {
        let foreground = read_params_foreground(&self.path, self.limits)?;
        match &foreground {
            Some(marks) if marks.len() != self.num_gaussians => {
                let found = format!("seg_colors of {} Gaussians", marks.len());
                Err(PipelineError::input(self.path.display(), found, self.num_gaussians.to_string()))
            }
            _ => Ok(foreground),
        }
    }
}
