//! Any scene over time: a `.tcgs` file, a run folder, a `params.npz`, or a sequence of files. What lives here: its
//! Gaussians. What does not: finding a scene (`found`), opening it (`open`), declarations in its files (`declared`),
//! the results of training beside Gaussians (`run`), and its subject (`subject`).

mod chapters;
mod declared;
mod found;
mod open;
mod run;
mod subject;

use std::borrow::Cow;
use std::fmt;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tcgs_codec::{CompactFile, Light, Loss, SceneFile, SceneInfo};
use tcgs_core::{Drawable, DynamicGaussians, Gaussians, Layout, Lives, SceneReader};
use tcgs_interchange::{Axes, FourdgsFile, ParamsNpz, ReadLimits, ReadNote, TimestepFiles};

use self::chapters::Chapters;
pub use self::open::{CutFiles, OpenSettings};
use self::run::RunContent;
use crate::PipelineError;

/// A scene over time, from any kind of file or folder.
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
/// assert_eq!((scene.num_identities(), scene.frames()), (Some(5), 0..1));
/// assert_eq!(scene.at(0)?, floats.at(0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct OpenScene {
    /// As given, or the file that was found below a folder ([`Self::open`]).
    pub path: PathBuf,
    /// Frame of the capture that timestep 0 shows.
    pub first_frame: usize,
    /// Factor by which the capture's images were shrunk for training.
    pub downscale: usize,
    /// Frames a second; 0 if unknown.
    pub frame_rate: f64,
    /// Length of a `.tcgs` file; for anything else the raw size. That counts means, rotations and colours of every
    /// timestep, and columns that do not vary by the layout once: `N (40 T + 16)` without harmonics. If the number of
    /// Gaussians changes, it counts all columns of every timestep.
    pub bytes: u64,
    layout: Arc<Layout>,
    content: Content,
}

/// The content of a scene. Runs, sequences of files and `params.npz` read a timestep on demand.
#[derive(Debug)]
enum Content {
    /// A file whose segments are decoded on demand; an LRU cache keeps some.
    File(Box<FileContent>),
    /// The symbols of a compression.
    Symbols(Box<CompactFile>),
    Run(Box<RunContent>),
    /// Runs one after another.
    Chapters(Box<Chapters>),
    Floats {
        scene: Box<DynamicGaussians>,
        /// None if all Gaussians live at all timesteps.
        lives: Option<Lives>,
        kind: &'static str,
    },
    /// A `params.npz`, of which a timestep is read on demand.
    Params(Box<ParamsContent>),
    /// PLY, SPZ or glTF.
    TimestepFiles(TimestepFiles),
    /// A `.4dgs` file, in memory.
    Fourdgs(Box<FourdgsFile>),
}

struct FileContent {
    info: SceneInfo,
    loss: Option<Loss>,
    light: Light,
    file: Mutex<SceneFile<File>>,
}

#[derive(Debug)]
struct ParamsContent {
    num_gaussians: usize,
    num_timesteps: usize,
    /// Whether the file declares its frames.
    has_origin: bool,
    /// Limits under which the file was opened.
    limits: ReadLimits,
    file: Mutex<ParamsNpz>,
}

impl FileContent {
    fn file(&self) -> MutexGuard<'_, SceneFile<File>> {
        // A panic elsewhere leaves a cache with a segment more or less.
        self.file.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl fmt::Debug for FileContent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FileContent").field("info", &self.info).finish_non_exhaustive()
    }
}

impl OpenScene {
    /// Joins runs that continue one another into one scene: chapters of a capture.
    ///
    /// Chapters are taken in the order of their frames. If two overlap, the earlier one counts up to the last segment
    /// border after the later one's first frame, so that each segment of a file is of one chapter. Without such a
    /// border it counts up to its end.
    ///
    /// - `chapters`: run folders, one or more
    /// - `segment_length`: timesteps of a segment; none for the codec's choice
    ///
    /// # Errors
    /// [`PipelineError::Input`] if one is no run, frames are missing between two, or one adds no frame. Also if they do
    /// not have the same Gaussians in the same order, which a `.tcgs` file requires.
    pub fn join(mut chapters: Vec<Self>, segment_length: Option<u32>) -> Result<Self, PipelineError> {
        if chapters.len() == 1 {
            return Ok(chapters.remove(0));
        }
        let chapters = Chapters::join(chapters, segment_length)?;
        let first = chapters.first();
        let bytes = first.layout.raw_bytes(first.num_gaussians_at(0), chapters.num_timesteps());
        let (path, layout) = (first.path.clone(), Arc::clone(&first.layout));
        let Self { first_frame, downscale, frame_rate, .. } = *first;
        let content = Content::Chapters(Box::new(chapters));
        Ok(Self { path, first_frame, downscale, frame_rate, bytes, layout, content })
    }

    /// Timesteps of a segment at whose borders chapters are joined; none for any other scene.
    pub(crate) fn segment_length(&self) -> Option<u32> {
        match &self.content {
            Content::Chapters(chapters) => Some(chapters.segment_length()),
            _ => None,
        }
    }

    /// Whether the timesteps come from a program that need not identify Gaussians across timesteps.
    pub(crate) fn has_loose_timesteps(&self) -> bool {
        matches!(&self.content, Content::TimestepFiles(_) | Content::Fourdgs(_))
    }

    /// A scene of Gaussians in memory.
    ///
    /// - `name`: the scene's name in messages
    /// - `frame_rate`: timesteps a second; 0 if unknown
    ///
    /// ```
    /// use std::path::Path;
    /// use tcgs_core::{DynamicGaussians, Gaussians};
    /// use tcgs_pipeline::OpenScene;
    ///
    /// let mut floats = DynamicGaussians::default();
    /// floats.push(Gaussians::zeros(5));
    /// let scene = OpenScene::of_floats(Path::new("made here"), floats, 30.0);
    /// assert_eq!((scene.num_identities(), scene.kind()), (Some(5), "floats"));
    /// ```
    pub fn of_floats(name: &Path, floats: DynamicGaussians, frame_rate: f64) -> Self {
        let (path, bytes, layout) = (name.into(), floats.raw_bytes(), Arc::clone(floats.layout()));
        let content = Content::Floats { scene: Box::new(floats), lives: None, kind: "floats" };
        Self { path, first_frame: 0, downscale: 1, frame_rate, bytes, layout, content }
    }

    /// The same scene with other Gaussians in memory: the result of a step between this one and a file.
    ///
    /// - `kind`: the value of [`Self::kind`]
    pub fn with_floats(&self, scene: DynamicGaussians, kind: &'static str) -> Self {
        let layout = Arc::clone(scene.layout());
        self.with(layout, Content::Floats { scene: Box::new(scene), lives: None, kind })
    }

    /// Some Gaussians of a scene of floats, in memory: the result of pruning.
    ///
    /// - `keep`: their indices, ascending
    ///
    /// # Errors
    /// As [`Self::floats`].
    pub fn pruned(&self, keep: &[usize]) -> Result<Self, PipelineError> {
        let scene = Box::new(self.floats()?.select(keep));
        let lives = self.lives().map(|lives| lives.select(keep));
        Ok(self.with(Arc::clone(scene.layout()), Content::Floats { scene, lives, kind: "pruned" }))
    }

    /// The same scene with the symbols of a compression.
    pub fn with_symbols(&self, compact: CompactFile) -> Self {
        self.with(compact.layout(), Content::Symbols(Box::new(compact)))
    }

    fn with(&self, layout: Arc<Layout>, content: Content) -> Self {
        Self { path: self.path.clone(), layout, content, ..*self }
    }

    /// Assumptions of readers when the scene was opened, and replacements at the timesteps read so far. Empty unless
    /// the scene's files are another program's.
    ///
    /// ```
    /// use tcgs_core::Gaussians;
    /// use tcgs_interchange::write_ply_to;
    /// use tcgs_pipeline::{OpenScene, OpenSettings};
    ///
    /// let folder = tempfile::tempdir()?;
    /// let path = folder.path().join("a.ply");
    /// let mut gaussians = Gaussians::zeros(5);
    /// gaussians.logit_opacities_mut()[0] = f32::INFINITY;
    /// write_ply_to(std::fs::File::create(&path)?, &gaussians)?;
    ///
    /// let scene = OpenScene::open(&path, OpenSettings::default())?;
    /// assert!(scene.notes().is_empty() && scene.at(0)?.logit_opacities()[0].is_finite());
    /// assert!(scene.notes()[0].to_string().contains("opacities 1, scales 0"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn notes(&self) -> Vec<ReadNote> {
        match &self.content {
            Content::TimestepFiles(files) => files.notes(),
            Content::Fourdgs(file) => file.notes(),
            _ => Vec::new(),
        }
    }

    /// Axes of the Gaussians in other programs' files; none for anything else. Scenes are in the axes of PLY files.
    pub fn axes(&self) -> Option<Axes> {
        match &self.content {
            Content::TimestepFiles(files) => Some(files.axes()),
            Content::Fourdgs(file) => Some(file.axes()),
            _ => None,
        }
    }

    /// Whether the scene is one of floats whose timesteps are on disk and were checked to be of one scene.
    pub(crate) fn is_on_disk(&self) -> bool {
        matches!(self.content, Content::Run(_) | Content::Chapters(_) | Content::Params(_))
    }

    /// Whether the scene is already compressed.
    pub fn is_compressed(&self) -> bool {
        matches!(self.content, Content::File(_) | Content::Symbols(_))
    }

    /// Number of Gaussians that live at some timestep, for a run before pruning. None if the files do not identify
    /// Gaussians across timesteps, and their number changes.
    pub fn num_identities(&self) -> Option<usize> {
        Some(match &self.content {
            Content::File(file) => file.info.num_gaussians as usize,
            Content::Symbols(compact) => compact.num_identities(),
            Content::Run(run) => run.num_identities(),
            Content::Chapters(chapters) => return chapters.first().num_identities(),
            Content::Floats { scene, .. } => scene.num_gaussians(),
            Content::Params(params) => params.num_gaussians,
            Content::TimestepFiles(files) => return files.num_identities(),
            Content::Fourdgs(file) => return file.num_identities(),
        })
    }

    /// Number of Gaussians at one timestep, for a run before pruning. An upper bound for a `.tcgs` file in which
    /// Gaussians are born or die, because opening it does not read all lives.
    ///
    /// # Panics
    /// If the number changes over time and there is no such timestep.
    pub fn num_gaussians_at(&self, timestep: usize) -> usize {
        match &self.content {
            Content::File(file) => file.file().num_gaussians_at(timestep),
            Content::Symbols(compact) => compact.num_gaussians_at(timestep),
            Content::Run(run) => run.num_gaussians_at(timestep),
            Content::Chapters(chapters) => chapters.first().num_gaussians_at(0),
            Content::Floats { lives: Some(lives), .. } => lives.num_living(timestep),
            Content::Floats { scene, .. } => scene.num_gaussians(),
            Content::Params(params) => params.num_gaussians,
            Content::TimestepFiles(files) => files.num_gaussians_at(timestep),
            Content::Fourdgs(file) => file.num_gaussians_at(timestep),
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
            Content::TimestepFiles(files) => files.num_timesteps(),
            Content::Fourdgs(file) => file.num_timesteps(),
        }
    }

    /// Frames of the capture that the scene shows.
    pub fn frames(&self) -> Range<usize> {
        self.first_frame..self.first_frame + self.num_timesteps()
    }

    /// The requested frames, or all.
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

    /// All Gaussians of one timestep, in stored form, before [`Self::light`] is applied. For a run this includes
    /// Gaussians that its masks leave out. Reads no other timestep.
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
            Content::Floats { scene, lives: Some(lives), .. } => scene.at(timestep).select(&lives.living(timestep)),
            Content::Floats { scene, .. } => scene.at(timestep),
            // A panic elsewhere leaves the file at another position, and every read begins with a seek.
            Content::Params(params) => params.file.lock().unwrap_or_else(PoisonError::into_inner).at(timestep)?,
            Content::TimestepFiles(files) => files.at(timestep)?,
            Content::Fourdgs(file) => file.at(timestep)?,
        })
    }

    /// [`Self::at`], with colours multiplied by [`Self::light`], for a renderer.
    ///
    /// # Errors
    /// As there.
    pub fn lit(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        Ok(self.at(timestep)?.lit(self.light(timestep)))
    }

    /// One timestep activated, as every camera draws it; for a run without the Gaussians that its masks leave out then.
    ///
    /// # Errors
    /// As [`Self::at`].
    pub fn drawn(&self, timestep: usize) -> Result<Drawable, PipelineError> {
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
            return Ok(Drawable::new(&parameters.gaussians.select(&shown)));
        }
        Ok(Drawable::new(&self.lit(timestep)?))
    }

    fn check_timestep(&self, timestep: usize) -> Result<(), PipelineError> {
        let num_timesteps = self.num_timesteps();
        if timestep < num_timesteps {
            return Ok(());
        }
        let (found, expected) = (format!("no timestep {timestep}"), format!("one below {num_timesteps}"));
        Err(PipelineError::input(self.path.display(), found, expected))
    }

    /// All timesteps of a scene of floats. A Gaussian that does not live at a timestep stands there as it was born or
    /// died. Sequences of files are checked to continue one another.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if the scene is compressed; [`PipelineError`] if a file is damaged, or the files of a
    /// sequence differ in their number of Gaussians.
    pub fn floats(&self) -> Result<Cow<'_, DynamicGaussians>, PipelineError> {
        match &self.content {
            Content::File(_) | Content::Symbols(_) => {
                Err(PipelineError::input(self.path.display(), "is compressed already", "a scene of floats"))
            }
            Content::Run(run) => Ok(Cow::Owned(run.run.trained_until(run.num_timesteps)?.scene)),
            Content::Fourdgs(_) if !self.all_live() => {
                let expected = "the same Gaussians at every timestep";
                Err(PipelineError::input(self.path.display(), "has a changing number of Gaussians", expected))
            }
            Content::Chapters(_) | Content::Fourdgs(_) => {
                let mut floats = DynamicGaussians::new(Arc::clone(&self.layout));
                for timestep in 0..self.num_timesteps() {
                    floats.push(self.at(timestep)?);
                }
                Ok(Cow::Owned(floats))
            }
            Content::Floats { scene, .. } => Ok(Cow::Borrowed(scene)),
            Content::Params(params) => Ok(Cow::Owned(ParamsNpz::open(&self.path, params.limits)?.read_all()?)),
            Content::TimestepFiles(files) => Ok(Cow::Owned(files.read(0..files.num_timesteps())?)),
        }
    }

    /// The kind of the scene in two words.
    pub fn kind(&self) -> &'static str {
        match &self.content {
            Content::File(_) | Content::Symbols(_) => "compressed file",
            Content::Run(_) => "run folder",
            Content::Chapters(_) => "run folders",
            Content::Floats { kind, .. } => kind,
            Content::Params(_) => "Dynamic 3D Gaussians parameters",
            Content::TimestepFiles(files) => files.kind(),
            Content::Fourdgs(_) => ".4dgs file",
        }
    }
}

/// Timesteps are read on demand, as by [`OpenScene::at`].
impl SceneReader for OpenScene {
    type Error = PipelineError;

    fn layout(&self) -> &Arc<Layout> {
        &self.layout
    }

    fn num_identities(&self) -> Option<usize> {
        OpenScene::num_identities(self)
    }

    fn num_gaussians_at(&self, timestep: usize) -> usize {
        OpenScene::num_gaussians_at(self, timestep)
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
