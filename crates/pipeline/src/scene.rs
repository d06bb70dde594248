//! Any scene over time: a `.tcgs` file, a run folder, a `params.npz`, or PLY files.

use std::fs;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_codec::{CompactScene, DecodeLimits, UpAxis};
use tcgs_core::{Activated, DynamicGaussians, Gaussians, activate};
use tcgs_interchange::{HigherHarmonics, ParamsOrigin};
use tcgs_train::{Run, TrainedScene};

use crate::PipelineError;

/// What a scene may be, for messages.
const EXPECTED: &str = "a .tcgs file, a run folder, a params.npz or PLY files";

/// How a scene is read.
#[derive(Clone, Copy, Debug)]
pub struct OpenSettings {
    /// What to do with PLY files whose colours depend on the direction of view. Default: refuse.
    pub higher_harmonics: HigherHarmonics,
}

impl Default for OpenSettings {
    fn default() -> Self {
        Self { higher_harmonics: HigherHarmonics::Refuse }
    }
}

/// A scene over time, whatever kind of file or folder it lies in.
///
/// ```
/// use tcgs_core::{DynamicGaussians, Gaussians};
/// use tcgs_interchange::{ParamsExtras, write_params_npz};
/// use tcgs_pipeline::{OpenScene, OpenSettings};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("params.npz");
/// let mut floats = DynamicGaussians::default();
/// floats.push(Gaussians::zeros(5));
/// write_params_npz(&path, &floats, &ParamsExtras::default())?;
///
/// let scene = OpenScene::open(&path, OpenSettings::default())?;
/// assert_eq!((scene.num_gaussians(), scene.frames()), (5, 0..1));
/// assert_eq!(scene.at(0)?, floats.at(0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct OpenScene {
    /// As given.
    pub path: PathBuf,
    /// What the scene is made of.
    pub content: SceneContent,
    /// Frame of the capture that timestep 0 shows.
    pub first_frame: usize,
    /// Factor by which the capture's images were shrunk for training.
    pub downscale: usize,
    /// Frames a second; 0 if unknown.
    pub frame_rate: f64,
    /// Length of a `.tcgs` file; the raw size of anything else.
    pub bytes: u64,
}

/// What a scene is made of.
#[derive(Debug)]
pub enum SceneContent {
    /// A `.tcgs` file.
    Compact(Box<CompactScene>),
    /// A run, with its masks.
    Run(Box<(Run, TrainedScene)>),
    /// Nothing but floats.
    Floats {
        /// All of them.
        scene: Box<DynamicGaussians>,
        /// The kind of file that they are from, in words.
        kind: &'static str,
    },
}

impl OpenScene {
    /// Opens a scene. A file is taken for what its ending says, so that a damaged one is judged as what it was meant to
    /// be; one with another ending for what its first bytes say.
    ///
    /// # Errors
    /// [`PipelineError`] if there is no such file or folder, or it is none of the kinds, or damaged.
    pub fn open(path: &Path, settings: OpenSettings) -> Result<Self, PipelineError> {
        if path.is_dir() {
            return if !Run::is_run(path) && is_ply_folder(path) {
                Self::open_ply(path, settings)
            } else {
                Self::open_run(path)
            };
        }
        match kind_of_file(path)? {
            Kind::Tcgs => {
                let bytes = fs::read(path).map_err(|error| PipelineError::unreadable(path, error, EXPECTED))?;
                Self::decode(path, &bytes)
            }
            Kind::Npz => {
                let scene = tcgs_interchange::read_params_npz(path)?;
                let unknown = ParamsOrigin { first_frame: 0, downscale: 1, frame_rate: 30.0 };
                let origin = tcgs_interchange::read_params_origin(path)?.unwrap_or(unknown);
                Ok(Self::of_floats(path, scene, "Dynamic 3D Gaussians parameters", origin))
            }
            Kind::Ply => Self::open_ply(path, settings),
        }
    }

    fn open_ply(path: &Path, settings: OpenSettings) -> Result<Self, PipelineError> {
        let sequence = tcgs_interchange::read_ply_sequence(path, settings.higher_harmonics)?;
        let first_frame = sequence.first_frame.unwrap_or(0);
        let origin = ParamsOrigin { first_frame, downscale: 1, frame_rate: 30.0 };
        Ok(Self::of_floats(path, sequence.scene, "PLY files", origin))
    }

    fn of_floats(path: &Path, scene: DynamicGaussians, kind: &'static str, origin: ParamsOrigin) -> Self {
        Self {
            path: path.into(),
            bytes: scene.raw_bytes(),
            content: SceneContent::Floats { scene: Box::new(scene), kind },
            first_frame: origin.first_frame as usize,
            downscale: origin.downscale as usize,
            frame_rate: f64::from(origin.frame_rate),
        }
    }

    /// The scene in the bytes of a `.tcgs` file.
    ///
    /// - `path`: of the file, for messages
    ///
    /// # Errors
    /// [`PipelineError::Decode`] if the bytes are not those of a whole file.
    pub fn decode(path: &Path, bytes: &[u8]) -> Result<Self, PipelineError> {
        let compact = tcgs_codec::decode(bytes, &DecodeLimits::default())
            .map_err(|error| PipelineError::Decode { path: path.into(), error })?;
        let info = &compact.info;
        Ok(Self {
            path: path.into(),
            first_frame: info.first_frame as usize,
            downscale: info.downscale as usize,
            frame_rate: f64::from(info.frame_rate),
            bytes: bytes.len() as u64,
            content: SceneContent::Compact(Box::new(compact)),
        })
    }

    fn open_run(path: &Path) -> Result<Self, PipelineError> {
        if !Run::is_run(path) {
            let found = "a folder without config.toml and without PLY files";
            return Err(PipelineError::input(path.display(), found, EXPECTED));
        }
        let run = Run::open(path)?;
        let trained = run.trained()?;
        let data = &run.config().data;
        Ok(Self {
            path: path.into(),
            first_frame: data.first_frame,
            downscale: data.downscale,
            frame_rate: data.frame_rate,
            bytes: trained.scene.raw_bytes(),
            content: SceneContent::Run(Box::new((run, trained))),
        })
    }

    /// The axis that points up, as a `.tcgs` file says it; unknown of anything else.
    pub fn up(&self) -> UpAxis {
        match &self.content {
            SceneContent::Compact(compact) => compact.info.up,
            _ => UpAxis::Unknown,
        }
    }

    /// `N`, of a run before pruning.
    pub fn num_gaussians(&self) -> usize {
        match &self.content {
            SceneContent::Compact(compact) => compact.num_gaussians(),
            SceneContent::Run(run) => run.1.scene.num_gaussians(),
            SceneContent::Floats { scene, .. } => scene.num_gaussians(),
        }
    }

    /// `T`.
    pub fn num_timesteps(&self) -> usize {
        match &self.content {
            SceneContent::Compact(compact) => compact.num_timesteps(),
            SceneContent::Run(run) => run.1.scene.num_timesteps(),
            SceneContent::Floats { scene, .. } => scene.num_timesteps(),
        }
    }

    /// Frames of the capture that the scene shows.
    pub fn frames(&self) -> Range<usize> {
        self.first_frame..self.first_frame + self.num_timesteps()
    }

    /// The frames asked for, or all.
    ///
    /// # Errors
    /// [`PipelineError::Frames`] if the scene lacks one of them.
    pub fn choose_frames(&self, wanted: Option<&Range<usize>>) -> Result<Range<usize>, PipelineError> {
        let has = self.frames();
        match wanted {
            None => Ok(has),
            Some(wanted) if wanted.start < wanted.end && has.start <= wanted.start && wanted.end <= has.end => {
                Ok(wanted.clone())
            }
            Some(wanted) => Err(PipelineError::Frames { path: self.path.clone(), wanted: wanted.clone(), has }),
        }
    }

    /// All Gaussians of one timestep, in stored form; of a run also those that its masks leave out.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if there is no such timestep.
    pub fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        let num_timesteps = self.num_timesteps();
        if timestep >= num_timesteps {
            let (found, expected) = (format!("no timestep {timestep}"), format!("one below {num_timesteps}"));
            return Err(PipelineError::input(self.path.display(), found, expected));
        }
        Ok(match &self.content {
            SceneContent::Compact(compact) => compact.at(timestep),
            SceneContent::Run(run) => run.1.scene.at(timestep),
            SceneContent::Floats { scene, .. } => scene.at(timestep),
        })
    }

    /// One timestep activated, as it is drawn: of a run without the Gaussians that its masks leave out then.
    ///
    /// # Errors
    /// As [`Self::at`].
    pub fn drawn(&self, timestep: usize) -> Result<Arc<Activated>, PipelineError> {
        let gaussians = self.at(timestep)?;
        Ok(match &self.content {
            SceneContent::Run(run) if run.0.config().mask.enabled => {
                let masked = tcgs_train::masked_out(&run.1.mask_logits[timestep], run.0.config().mask.threshold);
                let shown: Vec<usize> = (0..masked.len()).filter(|&i| !masked[i]).collect();
                Arc::new(activate(&gaussians.select(&shown)))
            }
            _ => Arc::new(activate(&gaussians)),
        })
    }

    /// The kind of the scene in two words.
    pub fn kind(&self) -> &'static str {
        match &self.content {
            SceneContent::Compact(_) => "compressed file",
            SceneContent::Run(_) => "run folder",
            SceneContent::Floats { kind, .. } => kind,
        }
    }
}

enum Kind {
    Tcgs,
    Npz,
    Ply,
}

/// By its name; else by its first bytes.
fn kind_of_file(path: &Path) -> Result<Kind, PipelineError> {
    let mut start = Vec::new();
    let read = fs::File::open(path).and_then(|file| file.take(4).read_to_end(&mut start));
    read.map_err(|error| PipelineError::unreadable(path, error, EXPECTED))?;
    match path.extension().and_then(|e| e.to_str()).unwrap_or_default() {
        "tcgs" => Ok(Kind::Tcgs),
        "npz" => Ok(Kind::Npz),
        "ply" => Ok(Kind::Ply),
        _ if start == b"TCGS" => Ok(Kind::Tcgs),
        _ if start == b"PK\x03\x04" => Ok(Kind::Npz),
        _ if start.starts_with(b"ply") => Ok(Kind::Ply),
        _ => Err(PipelineError::input(path.display(), "a file of another kind", EXPECTED)),
    }
}

/// Whether a folder holds PLY files.
fn is_ply_folder(path: &Path) -> bool {
    let Ok(entries) = fs::read_dir(path) else { return false };
    entries.flatten().any(|entry| entry.path().extension().is_some_and(|e| e.eq_ignore_ascii_case("ply")))
}
