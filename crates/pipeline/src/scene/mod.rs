//! Any scene over time: a `.tcgs` file, a run folder, a `params.npz`, or PLY files.

mod chapters;

use std::borrow::Cow;
use std::fmt;
use std::fs::{self, File};
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tcgs_codec::{BitMap, CompactScene, DecodeLimits, Loss, Quantizers, SceneFile, SceneInfo, SegmentCache, UpAxis};
use tcgs_core::{Activated, DynamicGaussians, Gaussians, Layout, SceneReader, activate};
use tcgs_interchange::{HigherHarmonics, ParamsNpz, ParamsOrigin, PlyFiles};
use tcgs_train::{Checkpoint, Parameters, Run};

use self::chapters::Chapters;
use crate::PipelineError;

/// What a scene may be, for messages.
const EXPECTED: &str = "a .tcgs file, a run folder, a params.npz or PLY files";

/// How a scene is read.
#[derive(Clone, Copy, Debug)]
pub struct OpenSettings {
    /// What to do with PLY files whose colours depend on the direction of view. Default: refuse.
    pub higher_harmonics: HigherHarmonics,
    /// What to do with a `.tcgs` file that was cut. Default: refuse.
    pub cut_files: CutFiles,
}

/// What to do with a `.tcgs` file that was cut, such as by a transfer that broke off.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CutFiles {
    /// Refuse the file.
    #[default]
    Refuse,
    /// Read what is whole: [`SceneFile::recover`]. [`OpenScene::loss`] says what is missing.
    Recover,
}

impl Default for OpenSettings {
    fn default() -> Self {
        Self { higher_harmonics: HigherHarmonics::Refuse, cut_files: CutFiles::Refuse }
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
    /// Frame of the capture that timestep 0 shows.
    pub first_frame: usize,
    /// Factor by which the capture's images were shrunk for training.
    pub downscale: usize,
    /// Frames a second; 0 if unknown.
    pub frame_rate: f64,
    /// Length of a `.tcgs` file; of anything else the raw size `N (40 T + 16)`: means, rotations and colours of every
    /// timestep, scales and opacities once.
    pub bytes: u64,
    layout: Arc<Layout>,
    content: Content,
}

/// What a scene is made of. Of a run, of PLY files and of a `params.npz` a timestep is read when it is asked for.
#[derive(Debug)]
enum Content {
    /// A file, of which segments are decoded when they are asked for; an LRU keeps some.
    File(Box<FileContent>),
    /// The symbols of a compression.
    Symbols(Box<CompactScene>),
    Run(Box<RunContent>),
    /// Runs one after another.
    Chapters(Box<Chapters>),
    Floats {
        scene: Box<DynamicGaussians>,
        kind: &'static str,
    },
    /// A `params.npz`, of which a timestep is read when it is asked for.
    Params(Box<ParamsContent>),
    Ply {
        files: PlyFiles,
        higher_harmonics: HigherHarmonics,
        num_gaussians: usize,
    },
}

struct FileContent {
    info: SceneInfo,
    loss: Option<Loss>,
    file: Mutex<SceneFile<File>>,
}

#[derive(Debug)]
struct ParamsContent {
    num_gaussians: usize,
    num_timesteps: usize,
    file: Mutex<ParamsNpz>,
}

impl FileContent {
    fn file(&self) -> MutexGuard<'_, SceneFile<File>> {
        // What a panic elsewhere leaves is a cache with a segment more or less.
        self.file.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Debug for FileContent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FileContent").field("info", &self.info).finish_non_exhaustive()
    }
}

#[derive(Debug)]
struct RunContent {
    run: Run,
    /// What the first checkpoint holds and the others do not repeat.
    first: Checkpoint,
    num_timesteps: usize,
}

impl RunContent {
    fn checkpoint(&self, timestep: usize) -> Result<Checkpoint, PipelineError> {
        if timestep == 0 {
            return Ok(self.first.clone());
        }
        Ok(self.run.checkpoint(timestep, Some(&self.first))?)
    }

    fn parameters(&self, timestep: usize) -> Result<Parameters, PipelineError> {
        if timestep == 0 {
            return Ok(self.first.parameters.clone());
        }
        Ok(self.run.parameters(timestep, Some(&self.first))?)
    }
}

impl OpenScene {
    /// Opens a scene. A file is taken for what its ending says, so that a damaged one is judged as what it was meant to
    /// be; one with another ending for what its first bytes say.
    ///
    /// Of a run and of PLY files the first timestep is read now, and the others when they are asked for; of a `.tcgs` file
    /// a segment is decoded when one of its timesteps is asked for. A `params.npz` is read through and checked now, and a
    /// timestep of it is read again when it is asked for; one that is compressed is held in memory ([`ParamsNpz`]).
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
                let file = File::open(path).map_err(|error| PipelineError::unreadable(path, error, EXPECTED))?;
                Self::open_file(path, file, settings.cut_files)
            }
            Kind::Npz => {
                let params = ParamsNpz::open(path)?;
                let (num_gaussians, num_timesteps) = (params.num_gaussians(), params.num_timesteps());
                let layout = Arc::clone(params.layout());
                let unknown = ParamsOrigin { first_frame: 0, downscale: 1, frame_rate: 30.0 };
                let origin = tcgs_interchange::read_params_origin(path)?.unwrap_or(unknown);
                Ok(Self {
                    path: path.into(),
                    bytes: layout.raw_bytes(num_gaussians, num_timesteps),
                    layout,
                    content: Content::Params(Box::new(ParamsContent {
                        num_gaussians,
                        num_timesteps,
                        file: Mutex::new(params),
                    })),
                    first_frame: origin.first_frame as usize,
                    downscale: origin.downscale as usize,
                    frame_rate: f64::from(origin.frame_rate),
                })
            }
            Kind::Ply => Self::open_ply(path, settings),
        }
    }

    fn open_ply(path: &Path, settings: OpenSettings) -> Result<Self, PipelineError> {
        let files = PlyFiles::list(path)?;
        let higher_harmonics = settings.higher_harmonics;
        let num_gaussians = tcgs_interchange::read_ply(&files.files[0], higher_harmonics)?.num_gaussians();
        Ok(Self {
            path: path.into(),
            bytes: Layout::base().raw_bytes(num_gaussians, files.files.len()),
            first_frame: files.first_frame.unwrap_or(0) as usize,
            downscale: 1,
            frame_rate: 30.0,
            layout: Layout::base(),
            content: Content::Ply { files, higher_harmonics, num_gaussians },
        })
    }

    fn open_file(path: &Path, mut file: File, cut_files: CutFiles) -> Result<Self, PipelineError> {
        let decode_error = |error| PipelineError::Decode { path: path.into(), error };
        let again = file.try_clone().map_err(|error| PipelineError::unreadable(path, error, EXPECTED))?;
        let open = match cut_files {
            CutFiles::Refuse => SceneFile::open,
            CutFiles::Recover => SceneFile::recover,
        };
        let scene = open(again, &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES).map_err(decode_error)?;
        let loss = scene.loss().copied();
        let length = loss.map_or(scene.archive().file_bytes(), |loss| loss.bytes);
        // Data of applications are small, and no segment is: their checksums are verified now.
        let application = scene.archive().application_ranges().into_iter().enumerate();
        for (index, range) in application.filter(|(_, range)| range.end <= length) {
            let mut bytes = Vec::new();
            file.seek(SeekFrom::Start(range.start))
                .and_then(|_| (&mut file).take(range.end - range.start).read_to_end(&mut bytes))
                .map_err(|error| PipelineError::unreadable(path, error, EXPECTED))?;
            scene.archive().read_application(index, &bytes).map_err(decode_error)?;
        }
        let info = scene.info();
        Ok(Self {
            path: path.into(),
            first_frame: info.first_frame as usize,
            downscale: info.downscale as usize,
            frame_rate: f64::from(info.frame_rate),
            bytes: length,
            layout: Arc::clone(scene.layout()),
            content: Content::File(Box::new(FileContent { info: info.clone(), loss, file: Mutex::new(scene) })),
        })
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
            layout: Arc::clone(&compact.layout),
            content: Content::Symbols(Box::new(compact)),
        })
    }

    fn open_run(path: &Path) -> Result<Self, PipelineError> {
        if !Run::is_run(path) {
            let found = "a folder without config.toml and without PLY files";
            return Err(PipelineError::input(path.display(), found, EXPECTED));
        }
        let run = Run::open(path)?;
        let num_timesteps = run.timesteps();
        if num_timesteps == 0 {
            let (culprit, expected) = (path.join("checkpoints"), "a run with at least one finished timestep");
            return Err(PipelineError::input(culprit.display(), "no checkpoint", expected));
        }
        let first = run.checkpoint(0, None)?;
        let data = &run.config().data;
        Ok(Self {
            path: path.into(),
            first_frame: data.first_frame,
            downscale: data.downscale,
            frame_rate: data.frame_rate,
            bytes: first.parameters.gaussians.layout().raw_bytes(first.parameters.num_gaussians(), num_timesteps),
            layout: Arc::clone(first.parameters.gaussians.layout()),
            content: Content::Run(Box::new(RunContent { run, first, num_timesteps })),
        })
    }

    /// Runs that continue one another as one scene: chapters of a capture.
    ///
    /// Chapters are taken in the order of their frames. Where two overlap, the earlier one counts up to the last border of
    /// segments after the later one's first frame, so that a file's segments are of one chapter each; up to its end if no
    /// border lies there.
    ///
    /// - `chapters`: run folders, one or more
    /// - `segment_length`: timesteps of a segment; none: as the codec chooses it
    ///
    /// # Errors
    /// [`PipelineError::Input`] if one is no run, there are frames between two, one adds no frame, or they are not of the
    /// same Gaussians in the same order, which is what a `.tcgs` file holds.
    pub fn join(mut chapters: Vec<Self>, segment_length: Option<u32>) -> Result<Self, PipelineError> {
        if chapters.len() == 1 {
            return Ok(chapters.remove(0));
        }
        let chapters = Chapters::join(chapters, segment_length)?;
        let first = chapters.first();
        let bytes = first.layout.raw_bytes(first.num_gaussians(), chapters.num_timesteps());
        let (path, layout) = (first.path.clone(), Arc::clone(&first.layout));
        let Self { first_frame, downscale, frame_rate, .. } = *first;
        let content = Content::Chapters(Box::new(chapters));
        Ok(Self { path, first_frame, downscale, frame_rate, bytes, layout, content })
    }

    /// Timesteps of a segment at whose borders chapters are joined; none of any other scene.
    pub(crate) fn segment_length(&self) -> Option<u32> {
        match &self.content {
            Content::Chapters(chapters) => Some(chapters.segment_length()),
            _ => None,
        }
    }

    /// Whether the scene is a `params.npz`.
    pub(crate) fn is_params(&self) -> bool {
        matches!(&self.content, Content::Params(_))
    }

    /// The same scene with other Gaussians in memory: what a step between this one and a file leaves.
    ///
    /// - `kind`: as [`Self::kind`] shall say
    pub fn with_floats(&self, scene: DynamicGaussians, kind: &'static str) -> Self {
        let layout = Arc::clone(scene.layout());
        self.with(layout, Content::Floats { scene: Box::new(scene), kind })
    }

    /// The same scene with the symbols of a compression.
    pub fn with_symbols(&self, compact: CompactScene) -> Self {
        self.with(Arc::clone(&compact.layout), Content::Symbols(Box::new(compact)))
    }

    fn with(&self, layout: Arc<Layout>, content: Content) -> Self {
        Self { path: self.path.clone(), layout, content, ..*self }
    }

    /// The axis that points up, as a `.tcgs` file says it; unknown of anything else.
    pub fn up(&self) -> UpAxis {
        match &self.content {
            Content::File(file) => file.info.up,
            Content::Symbols(compact) => compact.info.up,
            _ => UpAxis::Unknown,
        }
    }

    /// What a `.tcgs` file that was cut has lost; none of anything else.
    pub fn loss(&self) -> Option<&Loss> {
        match &self.content {
            Content::File(file) => file.loss.as_ref(),
            _ => None,
        }
    }

    /// The run, if the scene is one; of chapters the first.
    pub fn run(&self) -> Option<&Run> {
        match &self.content {
            Content::Run(run) => Some(&run.run),
            Content::Chapters(chapters) => chapters.first().run(),
            _ => None,
        }
    }

    /// Whether the scene is one of floats whose timesteps are read from the disk, and were checked to be of one scene.
    pub(crate) fn is_on_disk(&self) -> bool {
        matches!(self.content, Content::Run(_) | Content::Chapters(_) | Content::Params(_))
    }

    /// Whether the scene is compressed already.
    pub fn is_compressed(&self) -> bool {
        matches!(self.content, Content::File(_) | Content::Symbols(_))
    }

    /// `N`, of a run before pruning.
    pub fn num_gaussians(&self) -> usize {
        match &self.content {
            Content::File(file) => file.info.num_gaussians as usize,
            Content::Symbols(compact) => compact.num_gaussians(),
            Content::Run(run) => run.first.parameters.num_gaussians(),
            Content::Chapters(chapters) => chapters.first().num_gaussians(),
            Content::Floats { scene, .. } => scene.num_gaussians(),
            Content::Params(params) => params.num_gaussians,
            Content::Ply { num_gaussians, .. } => *num_gaussians,
        }
    }

    /// `T`.
    pub fn num_timesteps(&self) -> usize {
        match &self.content {
            Content::File(file) => file.info.num_timesteps as usize,
            Content::Symbols(compact) => compact.num_timesteps(),
            Content::Run(run) => run.num_timesteps,
            Content::Chapters(chapters) => chapters.num_timesteps(),
            Content::Floats { scene, .. } => scene.num_timesteps(),
            Content::Params(params) => params.num_timesteps,
            Content::Ply { files, .. } => files.files.len(),
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

    /// All Gaussians of one timestep, in stored form; of a run also those that its masks leave out. Reads no other
    /// timestep.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if there is no such timestep; [`PipelineError`] if its file is damaged.
    pub fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        self.check_timestep(timestep)?;
        Ok(match &self.content {
            Content::File(file) => {
                file.file().at(timestep).map_err(|error| PipelineError::Decode { path: self.path.clone(), error })?
            }
            Content::Symbols(compact) => compact.at(timestep),
            Content::Run(run) => run.parameters(timestep)?.gaussians,
            Content::Chapters(chapters) => {
                let (chapter, timestep) = chapters.place(timestep);
                chapter.at(timestep)?
            }
            Content::Floats { scene, .. } => scene.at(timestep),
            // What a panic elsewhere leaves is a file at another place, and every read begins by seeking its own.
            Content::Params(params) => params.file.lock().unwrap_or_else(PoisonError::into_inner).at(timestep)?,
            Content::Ply { files, higher_harmonics, num_gaussians } => {
                let gaussians = tcgs_interchange::read_ply(&files.files[timestep], *higher_harmonics)?;
                if gaussians.num_gaussians() != *num_gaussians {
                    let found = format!("has {} Gaussians", gaussians.num_gaussians());
                    let expected = format!("{num_gaussians} as in {}", files.files[0].display());
                    return Err(PipelineError::input(files.files[timestep].display(), found, expected));
                }
                gaussians
            }
        })
    }

    /// One timestep activated, as it is drawn: of a run without the Gaussians that its masks leave out then.
    ///
    /// # Errors
    /// As [`Self::at`].
    pub fn drawn(&self, timestep: usize) -> Result<Arc<Activated>, PipelineError> {
        self.check_timestep(timestep)?;
        if let Content::Chapters(chapters) = &self.content {
            let (chapter, timestep) = chapters.place(timestep);
            return chapter.drawn(timestep);
        }
        if let Content::Run(run) = &self.content
            && run.run.config().mask.enabled
        {
            let parameters = run.parameters(timestep)?;
            let masked = tcgs_train::masked_out(&parameters.mask_logits, run.run.config().mask.threshold);
            let shown: Vec<usize> = (0..masked.len()).filter(|&i| !masked[i]).collect();
            return Ok(Arc::new(activate(&parameters.gaussians.select(&shown))));
        }
        Ok(Arc::new(activate(&self.at(timestep)?)))
    }

    fn check_timestep(&self, timestep: usize) -> Result<(), PipelineError> {
        let num_timesteps = self.num_timesteps();
        if timestep < num_timesteps {
            return Ok(());
        }
        let (found, expected) = (format!("no timestep {timestep}"), format!("one below {num_timesteps}"));
        Err(PipelineError::input(self.path.display(), found, expected))
    }

    /// All timesteps of a scene of floats. PLY files are checked to continue one another.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if the scene is compressed; [`PipelineError`] if a file is damaged.
    pub fn floats(&self) -> Result<Cow<'_, DynamicGaussians>, PipelineError> {
        match &self.content {
            Content::File(_) | Content::Symbols(_) => {
                Err(PipelineError::input(self.path.display(), "is compressed already", "a scene of floats"))
            }
            Content::Run(run) => Ok(Cow::Owned(run.run.trained()?.scene)),
            Content::Chapters(_) => {
                let mut floats = DynamicGaussians::new(Arc::clone(&self.layout));
                for timestep in 0..self.num_timesteps() {
                    floats.push(self.at(timestep)?);
                }
                Ok(Cow::Owned(floats))
            }
            Content::Floats { scene, .. } => Ok(Cow::Borrowed(scene)),
            Content::Params(_) => Ok(Cow::Owned(tcgs_interchange::read_params_npz(&self.path)?)),
            Content::Ply { files, higher_harmonics, .. } => {
                Ok(Cow::Owned(files.read(0..files.files.len(), *higher_harmonics)?))
            }
        }
    }

    /// Bits and quantizers that a run learned; none of another scene, or where quantisation was off. Of chapters those of
    /// the first: all have its bits, and steps that went on from there.
    pub(crate) fn learned_bits(&self) -> Result<Option<(BitMap, Quantizers)>, PipelineError> {
        if let Content::Chapters(chapters) = &self.content {
            return chapters.first().learned_bits();
        }
        let Content::Run(run) = &self.content else { return Ok(None) };
        let last = run.checkpoint(run.num_timesteps - 1)?;
        Ok(last.quantizers.map(|q| (q.bit_map.clone(), q.table())))
    }

    /// The first checkpoint of a run.
    pub(crate) fn first_checkpoint(&self) -> Option<&Checkpoint> {
        match &self.content {
            Content::Run(run) => Some(&run.first),
            Content::Chapters(chapters) => chapters.first().first_checkpoint(),
            _ => None,
        }
    }

    /// Mean mask of each Gaussian of a run over time (paper Eq. 6); none of a scene without masks. Reads nothing but
    /// masks, one timestep after another.
    pub(crate) fn mean_masks(&self) -> Result<Option<Vec<f32>>, PipelineError> {
        if !self.run().is_some_and(|run| run.config().mask.enabled) {
            return Ok(None);
        }
        let mut failed = None;
        let logits: Box<dyn Iterator<Item = _>> = match &self.content {
            Content::Chapters(chapters) => Box::new(chapters.mask_logits()),
            _ => Box::new(self.run().into_iter().flat_map(Run::mask_logits)),
        };
        let logits = logits.map_while(|logits| logits.map_err(|error| failed = Some(error)).ok());
        let means = tcgs_train::mean_masks(logits);
        failed.map_or(Ok(Some(means)), |error| Err(error.into()))
    }

    /// The kind of the scene in two words.
    pub fn kind(&self) -> &'static str {
        match &self.content {
            Content::File(_) | Content::Symbols(_) => "compressed file",
            Content::Run(_) => "run folder",
            Content::Chapters(_) => "run folders",
            Content::Floats { kind, .. } => kind,
            Content::Params(_) => "Dynamic 3D Gaussians parameters",
            Content::Ply { .. } => "PLY files",
        }
    }
}

/// Timesteps are read when they are asked for, as by [`OpenScene::at`].
impl SceneReader for OpenScene {
    type Error = PipelineError;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn num_gaussians(&self) -> usize {
        OpenScene::num_gaussians(self)
    }

    fn num_timesteps(&self) -> usize {
        OpenScene::num_timesteps(self)
    }

    fn span(&self, timestep: usize) -> Range<usize> {
        match &self.content {
            Content::File(file) => file.file().span(timestep),
            _ => timestep..timestep + 1,
        }
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, PipelineError> {
        OpenScene::at(self, timestep)
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
    let read = File::open(path).and_then(|file| file.take(4).read_to_end(&mut start));
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
