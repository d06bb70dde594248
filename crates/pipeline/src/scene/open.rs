//! Opens scenes: recognises the kind of a file or folder. What does not live here: the kinds, each with its opening
//! (`kinds`), and scenes that are made, not opened (`mod`).

use std::io::Read;
use std::path::Path;
use std::sync::LazyLock;

use tcgs_codec::{CompactFile, DecodeLimits};
use tcgs_core::open_file;
use tcgs_interchange::{ReadSettings, UnreadKind, is_sog_file};

use super::kinds;
use crate::{OpenScene, PipelineError};

/// A kind of file or folder that opens as a scene.
pub(super) struct SceneKind {
    /// Its files or folders, for messages.
    pub mark: &'static str,
    /// Endings of its files' names.
    pub endings: &'static [&'static str],
    /// First bytes of its files, four at most.
    pub starts: &'static [&'static [u8]],
    /// Whether a folder is of this kind.
    pub is_folder: fn(&Path) -> bool,
    pub open: fn(&Path, OpenSettings) -> Result<OpenScene, PipelineError>,
}

/// All kinds, in the order of messages. A folder of two kinds is of the first.
pub(super) const KINDS: [SceneKind; 5] =
    [kinds::compressed::KIND, kinds::run::KIND, kinds::params::KIND, kinds::fourdgs::KIND, kinds::timestep_files::KIND];

/// Settings for reading a scene.
#[derive(Clone, Copy, Debug, Default)]
pub struct OpenSettings {
    /// Settings for files of other programs.
    pub read: ReadSettings,
    /// Whether a cut `.tcgs` file is read. Default: it is refused.
    pub cut_files: CutFiles,
}

/// Whether a cut `.tcgs` file is read, such as one from an interrupted transfer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CutFiles {
    /// Refuse the file.
    #[default]
    Refuse,
    /// Read the whole segments, as [`SceneFile::recover`](tcgs_codec::SceneFile::recover) does. [`OpenScene::loss`]
    /// tells the missing ones.
    Recover,
}

impl OpenScene {
    /// Opens a scene. The ending of a file's name decides its kind, so that a damaged file is judged as the intended
    /// kind. If the ending is unknown, the first bytes decide.
    ///
    /// Opening reads the first timestep of a run and the headers of a sequence of files; the rest is read on demand. A
    /// segment of a `.tcgs` file is decoded when one of its timesteps is requested. A `params.npz` is read through and
    /// checked at once, and its timesteps are read again on demand. A compressed `params.npz` is held in memory
    /// ([`ParamsNpz`](tcgs_interchange::ParamsNpz)), and so is a `.4dgs` file.
    ///
    /// A folder may be the output folder of a program that trains 3D Gaussian splatting, or the folder `point_cloud` in
    /// it. Then the file `iteration_N/point_cloud.ply` of the highest iteration is opened, and [`OpenScene::path`] is
    /// that of the file.
    ///
    /// # Errors
    /// [`PipelineError`] if there is no such file or folder, or it is none of the kinds, or damaged.
    pub fn open(path: &Path, settings: OpenSettings) -> Result<Self, PipelineError> {
        let kind = if path.is_dir() { kind_of_folder(path) } else { kind_of_file(path) };
        (kind?.open)(path, settings)
    }

    /// Whether [`Self::open`] takes a path for a `.tcgs` file, by the ending of its name or by its first bytes.
    pub fn is_tcgs(path: &Path) -> bool {
        !path.is_dir() && kind_of_file(path).is_ok_and(|kind| kind.mark == kinds::compressed::KIND.mark)
    }

    /// The scene in the bytes of a `.tcgs` file.
    ///
    /// - `path`: of the file, for messages
    ///
    /// # Errors
    /// [`PipelineError::Decode`] if the bytes are not those of a whole file.
    pub fn decode(path: &Path, bytes: &[u8]) -> Result<Self, PipelineError> {
        let compact = CompactFile::decode(bytes, &DecodeLimits::default())
            .map_err(|error| PipelineError::Decode { path: path.into(), error })?;
        Ok(kinds::compressed::of_symbols(path, compact, bytes.len() as u64))
    }
}

/// All kinds, for messages.
pub(super) fn expected() -> &'static str {
    static EXPECTED: LazyLock<String> = LazyLock::new(|| {
        let [first @ .., last] = KINDS.map(|kind| kind.mark);
        format!("{}, or {last}", first.join(", "))
    });
    &EXPECTED
}

/// Refuses a file of a kind that is known but not read.
pub(super) fn refuse_unread(path: &Path) -> Result<(), PipelineError> {
    UnreadKind::of(path).map_or(Ok(()), |kind| {
        let found = format!("{}, which is not read yet", kind.name);
        Err(PipelineError::input(path.display(), found, kind.expected))
    })
}

/// Whether a file's name has one of some endings, in letters of either case.
pub(super) fn has_ending(path: &Path, endings: &[&str]) -> bool {
    path.extension().is_some_and(|found| endings.iter().any(|ending| found.eq_ignore_ascii_case(ending)))
}

fn kind_of_folder(path: &Path) -> Result<SceneKind, PipelineError> {
    if let Some(kind) = KINDS.into_iter().find(|kind| (kind.is_folder)(path)) {
        return Ok(kind);
    }
    let found = "a folder without config.toml and without PLY, SPZ, glTF or SOG files";
    Err(PipelineError::input(path.display(), found, expected()))
}

/// The kind by the ending of the file's name, or by its first bytes.
fn kind_of_file(path: &Path) -> Result<SceneKind, PipelineError> {
    let mut start = Vec::new();
    let read = open_file(path).and_then(|file| file.take(4).read_to_end(&mut start));
    read.map_err(|error| PipelineError::unreadable(path, error, expected()))?;
    let by_ending = KINDS.into_iter().find(|kind| has_ending(path, kind.endings));
    let by_start = || {
        // A ZIP archive, as a params.npz is, or the table of an unpacked SOG.
        if (start == b"PK\x03\x04" || has_ending(path, &["json"])) && is_sog_file(path) {
            return Some(kinds::timestep_files::KIND);
        }
        KINDS.into_iter().find(|kind| kind.starts.iter().any(|known| start.starts_with(known)))
    };
    if let Some(kind) = by_ending.or_else(by_start) {
        return Ok(kind);
    }
    refuse_unread(path)?;
    Err(PipelineError::input(path.display(), "a file of another kind", expected()))
}
