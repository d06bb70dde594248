//! Opens scenes: recognises the kind of a file or folder, and reads its beginning.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::Path;
use std::sync::{Arc, Mutex};

use tcgs_codec::{CompactFile, DecodeLimits, SceneFile, SegmentCache};
use tcgs_core::{SceneReader, open_file};
use tcgs_interchange::{FourdgsFile, ParamsNpz, ParamsOrigin, ReadSettings, TimestepFiles, UnreadKind};
use tcgs_train::Run;

use super::found::trained_file;
use super::{Content, FileContent, OpenScene, ParamsContent, RunContent};
use crate::PipelineError;

/// Kinds of scenes, for messages.
const EXPECTED: &str = "a .tcgs file, a run folder, a params.npz, a .4dgs file, or PLY, SPZ or glTF files";

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
    /// Read the whole segments: [`SceneFile::recover`]. [`OpenScene::loss`] tells the missing ones.
    Recover,
}

impl OpenScene {
    /// Opens a scene. The ending of a file's name decides its kind, so that a damaged file is judged as the intended
    /// kind. If the ending is unknown, the first bytes decide.
    ///
    /// Opening reads the first timestep of a run and the headers of a sequence of files; the rest is read on demand. A
    /// segment of a `.tcgs` file is decoded when one of its timesteps is requested. A `params.npz` is read through and
    /// checked at once, and its timesteps are read again on demand. A compressed one is held in memory ([`ParamsNpz`]),
    /// and so is a `.4dgs` file.
    ///
    /// A folder may be the output folder of a program that trains 3D Gaussian splatting, or the folder `point_cloud` in
    /// it. Then the file `iteration_N/point_cloud.ply` of the highest iteration is opened, and [`OpenScene::path`] is
    /// that of the file.
    ///
    /// # Errors
    /// [`PipelineError`] if there is no such file or folder, or it is none of the kinds, or damaged.
    pub fn open(path: &Path, settings: OpenSettings) -> Result<Self, PipelineError> {
        if path.is_dir() {
            return match trained_file(path) {
                _ if Run::is_run(path) => Self::open_run(path),
                Some(file) => Self::open_timestep_files(&file, settings),
                None if TimestepFiles::is_folder(path) => Self::open_timestep_files(path, settings),
                None => Self::open_run(path),
            };
        }
        match kind_of_file(path)? {
            Kind::Tcgs => {
                let file = open_file(path).map_err(|error| PipelineError::unreadable(path, error, EXPECTED))?;
                Self::open_file(path, file, settings.cut_files)
            }
            Kind::Npz => {
                let params = ParamsNpz::open(path, settings.read.limits)?;
                let (num_gaussians, num_timesteps) = (params.num_gaussians_at(0), params.num_timesteps());
                let layout = Arc::clone(params.layout());
                let unknown = ParamsOrigin { first_frame: 0, downscale: 1, frame_rate: 30.0 };
                let declared = tcgs_interchange::read_params_origin(path, settings.read.limits)?;
                let origin = declared.unwrap_or(unknown);
                Ok(Self {
                    path: path.into(),
                    bytes: layout.raw_bytes(num_gaussians, num_timesteps),
                    layout,
                    content: Content::Params(Box::new(ParamsContent {
                        num_gaussians,
                        num_timesteps,
                        has_origin: declared.is_some(),
                        limits: settings.read.limits,
                        file: Mutex::new(params),
                    })),
                    first_frame: origin.first_frame as usize,
                    downscale: origin.downscale as usize,
                    frame_rate: f64::from(origin.frame_rate),
                })
            }
            Kind::Timestep => Self::open_timestep_files(path, settings),
            Kind::Fourdgs => {
                let file = FourdgsFile::open(path, settings.read)?;
                Ok(Self {
                    path: path.into(),
                    bytes: file.raw_bytes(),
                    first_frame: 0,
                    downscale: 1,
                    frame_rate: file.frame_rate(),
                    layout: Arc::clone(file.layout()),
                    content: Content::Fourdgs(Box::new(file)),
                })
            }
        }
    }

    /// Whether [`Self::open`] takes a path for a `.tcgs` file, by the ending of its name or by its first bytes.
    pub fn is_tcgs(path: &Path) -> bool {
        !path.is_dir() && kind_of_file(path).is_ok_and(|kind| matches!(kind, Kind::Tcgs))
    }

    fn open_timestep_files(path: &Path, settings: OpenSettings) -> Result<Self, PipelineError> {
        let files = TimestepFiles::open(path, settings.read)?;
        Ok(Self {
            path: path.into(),
            bytes: files.raw_bytes(),
            first_frame: files.first_frame().unwrap_or(0) as usize,
            downscale: 1,
            frame_rate: 30.0,
            layout: Arc::clone(files.layout()),
            content: Content::TimestepFiles(files),
        })
    }

    fn open_file(path: &Path, mut file: File, cut_files: CutFiles) -> Result<Self, PipelineError> {
        let decode_error = |error| PipelineError::Decode { path: path.into(), error };
        let again = file.try_clone().map_err(|error| PipelineError::unreadable(path, error, EXPECTED))?;
        let open = match cut_files {
            CutFiles::Refuse => SceneFile::open,
            CutFiles::Recover => SceneFile::recover,
        };
        let mut scene = open(again, &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES).map_err(decode_error)?;
        let loss = scene.loss().copied();
        let length = loss.map_or(scene.archive().file_bytes(), |loss| loss.bytes);
        // Data of applications are small and in no segment: their checksums are verified at once.
        let application = scene.archive().application_ranges().into_iter().enumerate();
        for (index, range) in application.filter(|(_, range)| range.end <= length) {
            let mut bytes = Vec::new();
            file.seek(SeekFrom::Start(range.start))
                .and_then(|_| (&mut file).take(range.end - range.start).read_to_end(&mut bytes))
                .map_err(|error| PipelineError::unreadable(path, error, EXPECTED))?;
            scene.archive().read_application(index, &bytes).map_err(decode_error)?;
        }
        let light = scene.light().map_err(decode_error)?.clone();
        let info = scene.info();
        Ok(Self {
            path: path.into(),
            first_frame: info.first_frame as usize,
            downscale: info.downscale as usize,
            frame_rate: f64::from(info.frame_rate),
            bytes: length,
            layout: Arc::clone(scene.layout()),
            content: Content::File(Box::new(FileContent { info: info.clone(), loss, light, file: Mutex::new(scene) })),
        })
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
        let info = &compact.info;
        Ok(Self {
            path: path.into(),
            first_frame: info.first_frame as usize,
            downscale: info.downscale as usize,
            frame_rate: f64::from(info.frame_rate),
            bytes: bytes.len() as u64,
            layout: compact.layout(),
            content: Content::Symbols(Box::new(compact)),
        })
    }

    fn open_run(path: &Path) -> Result<Self, PipelineError> {
        if !Run::is_run(path) {
            refuse_unread(path)?;
            let found = "a folder without config.toml and without PLY, SPZ or glTF files";
            return Err(PipelineError::input(path.display(), found, EXPECTED));
        }
        let run = Run::open(path)?;
        let num_timesteps = run.timesteps();
        if num_timesteps == 0 {
            let (culprit, expected) = (path.join("checkpoints"), "a run with at least one finished timestep");
            return Err(PipelineError::input(culprit.display(), "no checkpoint", expected));
        }
        let (first, lives) = (run.checkpoint(0, None)?, run.lives(num_timesteps)?);
        let content = RunContent { run, first, lives, num_timesteps };
        let (data, gaussians) = (&content.run.config().data, &content.first.parameters.gaussians);
        Ok(Self {
            path: path.into(),
            first_frame: data.first_frame,
            downscale: data.downscale,
            frame_rate: data.frame_rate,
            bytes: gaussians.layout().raw_bytes(content.num_identities(), num_timesteps),
            layout: Arc::clone(gaussians.layout()),
            content: Content::Run(Box::new(content)),
        })
    }
}

enum Kind {
    Tcgs,
    Npz,
    /// One of [`TimestepFiles`].
    Timestep,
    Fourdgs,
}

/// Refuses a file or folder of a kind that is known but not read.
fn refuse_unread(path: &Path) -> Result<(), PipelineError> {
    UnreadKind::of(path).map_or(Ok(()), |kind| {
        let found = format!("{}, which is not read yet", kind.name);
        Err(PipelineError::input(path.display(), found, kind.expected))
    })
}

/// The kind by the file's name, or by its first bytes.
fn kind_of_file(path: &Path) -> Result<Kind, PipelineError> {
    let mut start = Vec::new();
    let read = open_file(path).and_then(|file| file.take(4).read_to_end(&mut start));
    read.map_err(|error| PipelineError::unreadable(path, error, EXPECTED))?;
    match path.extension().and_then(|e| e.to_str()).unwrap_or_default() {
        "tcgs" => Ok(Kind::Tcgs),
        "npz" => refuse_unread(path).map(|()| Kind::Npz),
        "4dgs" => Ok(Kind::Fourdgs),
        "ply" | "spz" | "glb" | "gltf" => Ok(Kind::Timestep),
        _ if start == b"TCGS" => Ok(Kind::Tcgs),
        _ if start == b"\x894DG" => Ok(Kind::Fourdgs),
        _ => {
            // A .splat file begins with a position, so its first bytes are arbitrary.
            refuse_unread(path)?;
            let is_known = |known: &&[u8]| start.starts_with(known);
            match &start[..] {
                b"PK\x03\x04" => Ok(Kind::Npz),
                _ if [&b"ply"[..], b"NGSP", b"\x1F\x8B", b"glTF"].iter().any(is_known) => Ok(Kind::Timestep),
                _ => Err(PipelineError::input(path.display(), "a file of another kind", EXPECTED)),
            }
        }
    }
}
