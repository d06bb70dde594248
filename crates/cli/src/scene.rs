//! What commands call a SCENE: a `.tcgs` file, a run folder, a `params.npz`, or PLY files.

use std::fs;
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use tcgs_codec::{CompactScene, DecodeLimits, UpAxis};
use tcgs_core::{Activated, DynamicGaussians, Gaussians, activate};
use tcgs_interchange::{HigherHarmonics, InterchangeError, ParamsOrigin};
use tcgs_train::{Run, TrainedScene};

use crate::error::{is_wrong_path, wrong_input};

/// What a SCENE may be, for messages.
const EXPECTED: &str = "a .tcgs file, a run folder, a params.npz or PLY files";

/// How a SCENE is read.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct SceneOptions {
    /// Of PLY files, leave out spherical harmonics above degree 0: colours stop depending on the view
    #[arg(long)]
    pub drop_sh: bool,
}

/// A scene, wherever it comes from.
pub struct Scene {
    /// As given.
    pub path: PathBuf,
    /// What it holds.
    pub model: Model,
    /// Frame of the capture that timestep 0 shows.
    pub first_frame: usize,
    /// Factor by which the capture's images were shrunk for training.
    pub downscale: usize,
    /// Frames a second; 0 if unknown.
    pub frame_rate: f64,
    /// Length of the file; of floats, their raw size.
    pub bytes: u64,
}

/// What a scene is made of.
pub enum Model {
    /// A `.tcgs` file.
    Compact(Box<CompactScene>),
    /// A run, with its masks.
    Run(Box<(Run, TrainedScene)>),
    /// Nothing but floats.
    Floats {
        /// All of them.
        scene: Box<DynamicGaussians>,
        /// What other program's files they are from, in words.
        kind: &'static str,
    },
}

impl Scene {
    /// What points up, as a file says it.
    pub fn up(&self) -> UpAxis {
        match &self.model {
            Model::Compact(compact) => compact.info.up,
            _ => UpAxis::Unknown,
        }
    }

    /// Loads a scene.
    pub fn load(path: &Path, options: SceneOptions) -> anyhow::Result<Self> {
        if path.is_dir() {
            return if !Run::is_run(path) && is_ply_folder(path) {
                Self::load_ply(path, options)
            } else {
                Self::load_run(path)
            };
        }
        match kind_of_file(path)? {
            Kind::Tcgs => {
                let bytes = fs::read(path).map_err(|error| unreadable(path, error, EXPECTED))?;
                Self::decode(path, &bytes)
            }
            Kind::Npz => {
                let scene = tcgs_interchange::read_params_npz(path)?;
                let unknown = ParamsOrigin { first_frame: 0, downscale: 1, frame_rate: 30.0 };
                let origin = tcgs_interchange::read_params_origin(path)?.unwrap_or(unknown);
                Ok(Self::of_floats(path, scene, "Dynamic 3D Gaussians parameters", origin))
            }
            Kind::Ply => Self::load_ply(path, options),
        }
    }

    fn load_ply(path: &Path, options: SceneOptions) -> anyhow::Result<Self> {
        let harmonics = if options.drop_sh { HigherHarmonics::Drop } else { HigherHarmonics::Refuse };
        let sequence = tcgs_interchange::read_ply_sequence(path, harmonics).map_err(|error| match error {
            InterchangeError::HigherHarmonics { .. } => {
                wrong_input(format!("{error}, or --drop-sh to do without the others"))
            }
            other => other.into(),
        })?;
        let first_frame = sequence.first_frame.unwrap_or(0);
        let origin = ParamsOrigin { first_frame, downscale: 1, frame_rate: 30.0 };
        Ok(Self::of_floats(path, sequence.scene, "PLY files", origin))
    }

    fn of_floats(path: &Path, scene: DynamicGaussians, kind: &'static str, origin: ParamsOrigin) -> Self {
        Self {
            path: path.into(),
            bytes: scene.raw_bytes(),
            model: Model::Floats { scene: Box::new(scene), kind },
            first_frame: origin.first_frame as usize,
            downscale: origin.downscale as usize,
            frame_rate: f64::from(origin.frame_rate),
        }
    }

    /// The scene in the bytes of a `.tcgs` file.
    pub fn decode(path: &Path, bytes: &[u8]) -> anyhow::Result<Self> {
        let compact = tcgs_codec::decode(bytes, &DecodeLimits::default())
            .map_err(|error| wrong_input(format!("{}: {error}, expected a whole .tcgs file", path.display())))?;
        let info = &compact.info;
        Ok(Self {
            path: path.into(),
            first_frame: info.first_frame as usize,
            downscale: info.downscale as usize,
            frame_rate: f64::from(info.frame_rate),
            bytes: bytes.len() as u64,
            model: Model::Compact(Box::new(compact)),
        })
    }

    fn load_run(path: &Path) -> anyhow::Result<Self> {
        if !Run::is_run(path) {
            let problem = "a folder without config.toml and without PLY files";
            return Err(wrong_input(format!("{}: {problem}, expected {EXPECTED}", path.display())));
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
            model: Model::Run(Box::new((run, trained))),
        })
    }

    /// `N`.
    pub fn num_gaussians(&self) -> usize {
        match &self.model {
            Model::Compact(compact) => compact.num_gaussians(),
            Model::Run(run) => run.1.scene.num_gaussians(),
            Model::Floats { scene, .. } => scene.num_gaussians(),
        }
    }

    /// `T`.
    pub fn num_timesteps(&self) -> usize {
        match &self.model {
            Model::Compact(compact) => compact.num_timesteps(),
            Model::Run(run) => run.1.scene.num_timesteps(),
            Model::Floats { scene, .. } => scene.num_timesteps(),
        }
    }

    /// Frames of the capture that it shows.
    pub fn frames(&self) -> Range<usize> {
        self.first_frame..self.first_frame + self.num_timesteps()
    }

    /// The frames asked for, or all.
    pub fn choose_frames(&self, wanted: Option<&Range<usize>>) -> anyhow::Result<Range<usize>> {
        let has = self.frames();
        match wanted {
            None => Ok(has),
            Some(wanted) if has.start <= wanted.start && wanted.end <= has.end => Ok(wanted.clone()),
            Some(wanted) => Err(wrong_input(format!(
                "--frames {}..{}: {} has the frames {}..{}, expected some of these",
                wanted.start,
                wanted.end,
                self.path.display(),
                has.start,
                has.end
            ))),
        }
    }

    /// All Gaussians of one timestep, in stored form; of a run also those that its masks leave out.
    pub fn at(&self, timestep: usize) -> Gaussians {
        match &self.model {
            Model::Compact(compact) => compact.at(timestep),
            Model::Run(run) => run.1.scene.at(timestep),
            Model::Floats { scene, .. } => scene.at(timestep),
        }
    }

    /// One timestep as it is drawn: of a run, the floats before pruning without what is masked.
    pub fn drawn(&self, timestep: usize) -> Arc<Activated> {
        let gaussians = self.at(timestep);
        match &self.model {
            Model::Run(run) if run.0.config().mask.enabled => {
                let masked = tcgs_train::masked_out(&run.1.mask_logits[timestep], run.0.config().mask.threshold);
                let shown: Vec<usize> = (0..masked.len()).filter(|&i| !masked[i]).collect();
                Arc::new(activate(&gaussians.select(&shown)))
            }
            _ => Arc::new(activate(&gaussians)),
        }
    }

    /// What it is, in words.
    pub fn describe(&self) -> String {
        let kind = match &self.model {
            Model::Compact(_) => "compressed file",
            Model::Run(_) => "run folder",
            Model::Floats { kind, .. } => kind,
        };
        format!(
            "{} ({kind}): {} Gaussians, {} timesteps, {}",
            self.path.display(),
            self.num_gaussians(),
            self.num_timesteps(),
            crate::output::show_bytes(self.bytes)
        )
    }
}

enum Kind {
    Tcgs,
    Npz,
    Ply,
}

/// By its name, so that a damaged file is judged as what it was meant to be; else by its first bytes.
fn kind_of_file(path: &Path) -> anyhow::Result<Kind> {
    let mut start = Vec::new();
    let read = fs::File::open(path).and_then(|file| file.take(4).read_to_end(&mut start));
    read.map_err(|error| unreadable(path, error, EXPECTED))?;
    match path.extension().and_then(|e| e.to_str()).unwrap_or_default() {
        "tcgs" => Ok(Kind::Tcgs),
        "npz" => Ok(Kind::Npz),
        "ply" => Ok(Kind::Ply),
        _ if start == b"TCGS" => Ok(Kind::Tcgs),
        _ if start == b"PK\x03\x04" => Ok(Kind::Npz),
        _ if start.starts_with(b"ply") => Ok(Kind::Ply),
        _ => Err(wrong_input(format!("{}: a file of another kind, expected {EXPECTED}", path.display()))),
    }
}

/// A file given by the user that cannot be read.
///
/// - `expected`: what it should have been
pub fn unreadable(path: &Path, error: std::io::Error, expected: &str) -> anyhow::Error {
    let message = format!("{}: {error}, expected {expected}", path.display());
    if is_wrong_path(&error) { wrong_input(message) } else { anyhow::Error::new(error).context(message) }
}

/// Whether a folder holds PLY files.
fn is_ply_folder(path: &Path) -> bool {
    let Ok(entries) = fs::read_dir(path) else { return false };
    entries.flatten().any(|entry| entry.path().extension().is_some_and(|e| e.eq_ignore_ascii_case("ply")))
}
