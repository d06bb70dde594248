//! Compressed scenes: `.tcgs` files, and the symbols of a compression in memory.

use std::fmt;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tcgs_codec::{
    CompactFile, DecodeError, DecodeLimits, FOREGROUND, FileCamera, Light, Loss, SceneFile, SceneInfo, SegmentCache,
    read_labels, read_trust, read_views,
};
use tcgs_core::{Gaussians, Layout, SceneReader, Trust, open_file};

use crate::PipelineError;
use crate::scene::open::{CutFiles, SceneKind, expected};
use crate::scene::{OpenScene, OpenSettings, SceneContent};

pub(crate) const KIND: SceneKind =
    SceneKind { mark: "a .tcgs file", endings: &["tcgs"], starts: &[b"TCGS"], is_folder: |_| false, open };

/// A file whose segments are decoded on demand; an LRU cache keeps some.
struct FileContent {
    path: PathBuf,
    info: SceneInfo,
    loss: Option<Loss>,
    light: Light,
    file: Mutex<SceneFile<File>>,
}

fn open(path: &Path, settings: OpenSettings) -> Result<OpenScene, PipelineError> {
    let unreadable = |error| PipelineError::unreadable(path, error, expected());
    let decode_error = |error| PipelineError::Decode { path: path.into(), error };
    let mut file = open_file(path).map_err(unreadable)?;
    let again = file.try_clone().map_err(unreadable)?;
    let open = match settings.cut_files {
        CutFiles::Refuse => SceneFile::open,
        CutFiles::Recover => SceneFile::recover,
    };
    let scene = open(again, &DecodeLimits::default(), SegmentCache::DEFAULT_BYTES).map_err(decode_error)?;
    let loss = scene.loss().copied();
    let length = loss.map_or(scene.archive().file_bytes(), |loss| loss.bytes);
    // Data of applications are small and in no segment: their checksums are verified at once.
    let application = scene.archive().application_ranges().into_iter().enumerate();
    for (index, range) in application.filter(|(_, range)| range.end <= length) {
        let mut bytes = Vec::new();
        file.seek(SeekFrom::Start(range.start))
            .and_then(|_| (&mut file).take(range.end - range.start).read_to_end(&mut bytes))
            .map_err(unreadable)?;
        scene.archive().read_application(index, &bytes).map_err(decode_error)?;
    }
    let light = scene.light().clone();
    let (info, layout) = (scene.info().clone(), Arc::clone(scene.layout()));
    let content = FileContent { path: path.into(), info: info.clone(), loss, light, file: Mutex::new(scene) };
    Ok(described(path, &info, layout, length, Box::new(content)))
}

/// A scene of the symbols of a compression.
///
/// - `bytes`: length of their file
pub(crate) fn of_symbols(path: &Path, compact: CompactFile, bytes: u64) -> OpenScene {
    described(path, &compact.info.clone(), compact.layout(), bytes, Box::new(compact))
}

fn described(
    path: &Path,
    info: &SceneInfo,
    layout: Arc<Layout>,
    bytes: u64,
    content: Box<dyn SceneContent>,
) -> OpenScene {
    OpenScene {
        path: path.into(),
        first_frame: info.first_frame as usize,
        downscale: info.downscale as usize,
        frame_rate: f64::from(info.frame_rate),
        bytes,
        kind: "compressed file",
        num_timesteps: info.num_timesteps as usize,
        num_identities: Some(info.num_gaussians as usize),
        layout,
        content,
    }
}

impl FileContent {
    fn file(&self) -> MutexGuard<'_, SceneFile<File>> {
        // A panic elsewhere leaves a cache with a segment more or less.
        self.file.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn decoded<T>(&self, result: Result<T, DecodeError>) -> Result<T, PipelineError> {
        result.map_err(|error| PipelineError::Decode { path: self.path.clone(), error })
    }
}

impl fmt::Debug for FileContent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FileContent").field("info", &self.info).finish_non_exhaustive()
    }
}

impl SceneContent for FileContent {
    fn num_gaussians_at(&self, timestep: usize) -> Option<usize> {
        Some(self.file().num_gaussians_at(timestep))
    }

    fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        self.decoded(self.file().at(timestep))
    }

    fn span(&self, timestep: usize) -> Range<usize> {
        self.file().span(timestep)
    }

    fn info(&self) -> Option<&SceneInfo> {
        Some(&self.info)
    }

    fn cameras(&self) -> Result<Vec<FileCamera>, PipelineError> {
        let data = self.file().application_data();
        self.decoded(data.map(|data| read_views(&data)))
    }

    fn trust(&self) -> Result<Option<Trust>, PipelineError> {
        let data = self.file().application_data();
        self.decoded(data.map(|data| read_trust(&data)))
    }

    fn light(&self, timestep: usize) -> [f32; 3] {
        self.light.at(timestep)
    }

    fn loss(&self) -> Option<&Loss> {
        self.loss.as_ref()
    }

    fn declared_errors(&self) -> Vec<(String, f32)> {
        self.file().archive().declared_errors().to_vec()
    }

    fn living(&self, timestep: usize) -> Result<Option<Vec<usize>>, PipelineError> {
        self.decoded(self.file().living(timestep).map(Some))
    }

    fn foreground(&self, timestep: usize) -> Result<Option<Vec<bool>>, PipelineError> {
        let data = self.decoded(self.file().application_data())?;
        let labels = read_labels(&data);
        let of_all = labels.and_then(|labels| labels.members(FOREGROUND, self.info.num_gaussians as usize));
        let living = self.living(timestep)?;
        Ok(of_all.zip(living).map(|(of_all, living)| living.into_iter().map(|g| of_all[g]).collect()))
    }
}

impl SceneContent for CompactFile {
    fn num_gaussians_at(&self, timestep: usize) -> Option<usize> {
        Some(CompactFile::num_gaussians_at(self, timestep))
    }

    fn at(&self, timestep: usize) -> Result<Gaussians, PipelineError> {
        Ok(CompactFile::at(self, timestep))
    }

    fn files(&self, _: &Path) -> Vec<PathBuf> {
        Vec::new()
    }

    fn info(&self) -> Option<&SceneInfo> {
        Some(&self.info)
    }

    fn light(&self, timestep: usize) -> [f32; 3] {
        self.light.at(timestep)
    }

    fn declared_errors(&self) -> Vec<(String, f32)> {
        self.declared_errors.clone()
    }
}
