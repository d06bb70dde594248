//! Any scene over time: a `.tcgs` file, a run folder, a `params.npz`, or a sequence of files. What lives here: its
//! Gaussians. What does not: recognising a scene (`open`), its kinds (`kinds`) and what they are asked (`content`),
//! declarations in its files (`declared`), the results of training beside Gaussians (`trained`), and its subject
//! (`subject`).

mod content;
mod declared;
mod kinds;
mod open;
mod subject;
mod trained;

use std::borrow::Cow;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use tcgs_codec::CompactFile;
use tcgs_core::{Drawable, DynamicGaussians, Gaussians, Layout, SceneReader};

use self::content::SceneContent;
use self::kinds::{chapters, compressed, floats};
pub use self::open::{CutFiles, OpenSettings};
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
    /// The kind in two words.
    kind: &'static str,
    num_timesteps: usize,
    num_identities: Option<usize>,
    layout: Arc<Layout>,
    content: Box<dyn SceneContent>,
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
        chapters::join(chapters, segment_length)
    }

    /// Timesteps of a segment at whose borders chapters are joined; none for any other scene.
    pub(crate) fn segment_length(&self) -> Option<u32> {
        self.content.segment_length()
    }

    /// Whether the timesteps come from a program that need not identify Gaussians across timesteps.
    pub(crate) fn has_loose_timesteps(&self) -> bool {
        self.content.has_loose_timesteps()
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
        Self { frame_rate, ..floats::of_floats(name, floats, None, "floats") }
    }

    /// The same scene with other Gaussians in memory: the result of a step between this one and a file.
    ///
    /// - `kind`: the value of [`Self::kind`]
    pub fn with_floats(&self, scene: DynamicGaussians, kind: &'static str) -> Self {
        self.describing(floats::of_floats(&self.path, scene, None, kind))
    }

    /// Some Gaussians of a scene of floats, in memory: the result of pruning.
    ///
    /// - `keep`: their indices, ascending
    ///
    /// # Errors
    /// As [`Self::floats`].
    pub fn pruned(&self, keep: &[usize]) -> Result<Self, PipelineError> {
        let (scene, lives) = (self.floats()?.select(keep), self.lives().map(|lives| lives.select(keep)));
        Ok(self.describing(floats::of_floats(&self.path, scene, lives, "pruned")))
    }

    /// The same scene with the symbols of a compression.
    pub fn with_symbols(&self, compact: CompactFile) -> Self {
        self.describing(compressed::of_symbols(&self.path, compact, self.bytes))
    }

    /// Another scene with the frames and the raw size of this one.
    fn describing(&self, other: Self) -> Self {
        let Self { first_frame, downscale, frame_rate, bytes, .. } = *self;
        Self { first_frame, downscale, frame_rate, bytes, ..other }
    }

    /// Whether the scene is one of floats whose timesteps are on disk and were checked to be of one scene.
    pub(crate) fn is_on_disk(&self) -> bool {
        let is_in_files = !self.content.files(&self.path).is_empty();
        is_in_files && !self.is_compressed() && !self.has_loose_timesteps()
    }

    /// Whether the scene is already compressed.
    pub fn is_compressed(&self) -> bool {
        self.content.info().is_some()
    }

    /// Number of Gaussians that live at some timestep, for a run before pruning. None if the files do not identify
    /// Gaussians across timesteps, and their number changes.
    pub fn num_identities(&self) -> Option<usize> {
        self.num_identities
    }

    /// Number of Gaussians at one timestep, for a run before pruning. An upper bound for a `.tcgs` file in which
    /// Gaussians are born or die, because opening it does not read all lives.
    ///
    /// # Panics
    /// If the number changes over time and there is no such timestep.
    pub fn num_gaussians_at(&self, timestep: usize) -> usize {
        self.content.num_gaussians_at(timestep).or(self.num_identities).unwrap_or_default()
    }

    /// `T`.
    pub fn num_timesteps(&self) -> usize {
        self.num_timesteps
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
        self.content.at(timestep)
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
        self.content.drawn(timestep)
    }

    fn check_timestep(&self, timestep: usize) -> Result<(), PipelineError> {
        let num_timesteps = self.num_timesteps;
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
        let refuse = |found, expected| Err(PipelineError::input(self.path.display(), found, expected));
        if self.is_compressed() {
            return refuse("is compressed already", "a scene of floats");
        }
        if let Some(floats) = self.content.floats()? {
            return Ok(floats);
        }
        if !self.all_live() {
            return refuse("has a changing number of Gaussians", "the same Gaussians at every timestep");
        }
        let mut floats = DynamicGaussians::new(Arc::clone(&self.layout));
        for timestep in 0..self.num_timesteps {
            floats.push(self.at(timestep)?);
        }
        Ok(Cow::Owned(floats))
    }

    /// The kind of the scene in two words.
    pub fn kind(&self) -> &'static str {
        self.kind
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
        self.content.span(timestep)
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, PipelineError> {
        OpenScene::at(self, timestep)
    }
}
