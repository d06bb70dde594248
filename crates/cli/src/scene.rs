//! The argument SCENE of commands: opens and describes scenes.

use std::path::Path;

use clap::Args;
use tcgs_codec::{DecodeError, Loss};
use tcgs_core::{SceneReader, Trust};
use tcgs_interchange::{Axes, HigherHarmonics, ReadLimits, ReadNote, ReadSettings};
use tcgs_pipeline::{CutFiles, Fault, HasFault, OpenScene, OpenSettings, PipelineError};

use crate::error::wrong_input;
use crate::output::show_bytes;
use crate::terminal::note;

/// Options for reading a SCENE to compress.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct SourceOptions {
    /// Leave out spherical harmonics above degree 0 of PLY, SPZ, glTF and .4dgs files: colours stop depending on the
    /// view
    #[arg(long)]
    pub drop_sh: bool,
    /// Read files of other programs that claim more memory than their length warrants, or over 65,536 timesteps
    #[arg(long)]
    pub no_limits: bool,
    /// Axes of PLY, SPZ, glTF and .4dgs files, as three letters: right or left, up or down, forward or back. Scenes are
    /// in rdf [default: those that the file declares, else luf of glTF and rdf of all others]
    #[arg(long, value_name = "XYZ")]
    pub axes: Option<Axes>,
}

impl SourceOptions {
    /// Opens a scene, and prints the assumptions of readers.
    pub fn open(self, path: &Path) -> Result<OpenScene, PipelineError> {
        self.open_with(path, CutFiles::Refuse)
    }

    /// Opens a scene, and prints which file it found if that is further below the folder.
    fn open_with(self, path: &Path, cut_files: CutFiles) -> Result<OpenScene, PipelineError> {
        let scene = OpenScene::open(path, OpenSettings { cut_files, ..self.settings() })?;
        let is_below = scene.path != path && scene.path.parent() != Some(path);
        if is_below {
            note(&format!("{}: reading its highest iteration, {}", path.display(), scene.path.display()));
        }
        note_assumed(&scene);
        Ok(scene)
    }

    fn settings(self) -> OpenSettings {
        let higher_harmonics = if self.drop_sh { HigherHarmonics::Drop } else { HigherHarmonics::Keep };
        let limits = if self.no_limits { ReadLimits::NONE } else { ReadLimits::default() };
        let read = ReadSettings { higher_harmonics, axes: self.axes, limits };
        OpenSettings { read, ..OpenSettings::default() }
    }
}

/// Options for reading a SCENE of any kind.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct SceneOptions {
    #[command(flatten)]
    source: SourceOptions,
    #[command(flatten)]
    recover: RecoverOption,
}

/// Handling of a truncated file.
#[derive(Args, Clone, Copy, Debug, Default)]
pub struct RecoverOption {
    /// Read the intact part of a .tcgs file that was cut
    #[arg(long)]
    pub recover: bool,
}

impl RecoverOption {
    /// The error of a file that cannot be decoded. For a file that was cut, it advises `--recover`.
    ///
    /// - `message`: names the file and the finding
    pub fn advise(self, error: &DecodeError, message: String) -> anyhow::Error {
        match error.fault() {
            Fault::Input if error.is_cut() && !self.recover => {
                wrong_input(format!("{message}; --recover reads what is whole"))
            }
            Fault::Input => wrong_input(message),
            _ => anyhow::anyhow!(message),
        }
    }
}

impl SceneOptions {
    /// Opens a scene. Prints the assumptions of readers and the losses of a file that was cut.
    pub fn open(self, path: &Path) -> anyhow::Result<OpenScene> {
        let cut_files = if self.recover.recover { CutFiles::Recover } else { CutFiles::Refuse };
        let scene = self.source.open_with(path, cut_files).map_err(|error| match &error {
            PipelineError::Decode { error: cause, .. } => self.recover.advise(cause, error.to_string()),
            _ => error.into(),
        })?;
        if let Some(loss) = scene.loss() {
            let num_gaussians = scene.num_identities().unwrap_or_default();
            note(&describe_loss(path, loss, num_gaussians, scene.num_timesteps()));
        }
        Ok(scene)
    }
}

/// Prints the assumptions of readers of other programs' files.
fn note_assumed(scene: &OpenScene) {
    for assumed in scene.notes() {
        if let ReadNote::AssumedAxes(_) = assumed {
            note(&format!("note: {}: {assumed}; --axes rub if it is upside down", scene.path.display()));
        }
    }
}

/// Prints the numbers that readers of other programs' files replaced. Commands call it at their end, because a timestep
/// is read when it is needed.
pub fn note_replaced(scene: &OpenScene) {
    for replaced in scene.notes() {
        if let ReadNote::Replaced { .. } = replaced {
            note(&format!("note: {}: {replaced}", scene.path.display()));
        }
    }
}

/// Describes the rest of a file that was cut, in one line.
pub fn describe_loss(path: &Path, loss: &Loss, num_gaussians: usize, num_timesteps: usize) -> String {
    let Loss { bytes, bytes_before, timesteps_before, gaussians_before } = loss;
    format!(
        "warning: {}: the file was cut at {bytes} of {bytes_before} bytes: {num_timesteps} of {timesteps_before} timesteps \
         and {num_gaussians} of {gaussians_before} Gaussians are whole",
        path.display()
    )
}

/// Describes a scene in words.
pub fn describe(scene: &OpenScene) -> String {
    let (path, kind, size) = (scene.path.display(), scene.kind(), show_bytes(scene.bytes));
    let num_timesteps = scene.num_timesteps();
    let [least, most] = numbers(scene);
    let all = scene.num_identities().unwrap_or(most);
    let number = match (least == most, most == all) {
        (true, true) => all.to_string(),
        (true, false) => format!("{most} of {all}"),
        (false, true) => format!("{least} to {most}"),
        (false, false) => format!("{least} to {most} of {all}"),
    };
    let harmonics = match scene.layout().sh_degree() {
        0 => String::new(),
        degree => format!(" with harmonics of degree {degree}"),
    };
    let antialiased = if scene.layout().is_antialiased() { ", antialiased" } else { "" };
    format!("{path} ({kind}): {number} Gaussians{harmonics}{antialiased}, {num_timesteps} timesteps, {size}")
}

/// From where pictures can be trusted, in words.
pub fn describe_trust(trust: &Trust) -> String {
    let groups = trust.groups();
    let beyond = Trust::ASIDE_DEGREES;
    let num_alone = groups.iter().filter(|&&size| size == 1).count();
    let from = match (groups.len() - num_alone, num_alone) {
        (1, 0) => return format!("trust: pictures from between the cameras, and from up to {beyond}° beyond them"),
        (0, _) => format!("within {beyond}° of each camera"),
        (1, _) => format!("between the cameras of one group, and within {beyond}° of each other camera"),
        (together, 0) => format!("between the cameras of {together} groups, and from up to {beyond}° beyond them"),
        (together, _) => {
            format!("between the cameras of {together} groups, and within {beyond}° of each other camera")
        }
    };
    format!("trust: pictures from {from}; what only other views show was guessed")
}

/// The smallest and the largest number of Gaussians at any timestep.
pub fn numbers(scene: &OpenScene) -> [usize; 2] {
    let counts = (0..scene.num_timesteps()).map(|timestep| scene.num_gaussians_at(timestep));
    [counts.clone().min(), counts.max()].map(|count| count.or(scene.num_identities()).unwrap_or_default())
}

/// The error of a user's file that cannot be read.
///
/// - `expected`: the expected kind of file
pub fn unreadable(path: &Path, error: std::io::Error, expected: &str) -> anyhow::Error {
    let message = format!("{}: {error}, expected {expected}", path.display());
    match error.fault() {
        Fault::Input => wrong_input(message),
        _ => anyhow::anyhow!(message),
    }
}
