//! Writes scenes to files: chooses the format, and writes the whole file or nothing.

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::Path;

use pyo3::PyResult;
use pyo3::exceptions::PyFileExistsError;
use tcgs_interchange::{Existing, Unfinished, parent_folder, write_whole};
use tcgs_pipeline::{
    CompressOptions, CompressPreset, Export, OpenScene, PipelineError, TimestepKind, capture_kind_of, compress_scene,
    settings_of,
};

use crate::errors::exception;
use crate::watch::Watch;

/// Writes a scene in the format that the ending of `path` names.
pub fn save(scene: &OpenScene, path: &Path, overwrite: bool, watch: &mut Watch) -> Result<(), PipelineError> {
    let frames = scene.frames();
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    let kind = match ending.as_deref() {
        Some("tcgs") if scene.path.is_file() && scene.is_compressed() => {
            let unreadable =
                |error| PipelineError::Unreadable { path: scene.path.clone(), error, expected: "a .tcgs file" };
            let mut file = fs::File::open(&scene.path).map_err(unreadable)?;
            return write(path, overwrite, |mut to| io::copy(&mut file, &mut to).map(drop));
        }
        Some("tcgs") => {
            if scene.is_compressed() {
                return Err(wrong(&scene.path, "is compressed already, and its file is gone", "a scene of floats"));
            }
            let kind = capture_kind_of(scene, None)?;
            let (keypoints, mapping) = settings_of(CompressPreset::Default, kind, scene)?;
            let options = CompressOptions { keypoints, mapping, ..CompressOptions::default() };
            let file = compress_scene(scene, &options)?.file;
            watch.check()?;
            return write(path, overwrite, |mut to| to.write_all(&file));
        }
        Some("npz") => {
            let export = Export::new(scene)?;
            let params = export.params(frames)?;
            return write(path, overwrite, |to| params.write(BufWriter::new(to))?.flush());
        }
        Some("4dgs") => {
            let bytes = Export::new(scene)?.fourdgs(frames)?;
            return write(path, overwrite, |mut to| to.write_all(&bytes));
        }
        Some("usda") => {
            let export = Export::new(scene)?;
            let fill = export.usda(frames)?;
            return write(path, overwrite, fill);
        }
        None => return save_folder(scene, path, watch),
        Some(_) => match TimestepKind::of(path) {
            Some(kind) => kind,
            None => {
                let expected = ".tcgs, .npz, .4dgs, .usda, .ply, .compressed.ply, .spz, .glb or .sog, or a new folder \
                                for PLY files";
                return Err(wrong(path, "has an unknown ending", expected));
            }
        },
    };
    if frames.len() > 1 {
        let found = format!("is a file of one timestep, and the scene has {}", frames.len());
        return Err(wrong(path, &found, "the name of a new folder"));
    }
    let fill = Export::new(scene)?.timestep(kind, frames.start)?;
    write(path, overwrite, |to| fill(to))
}

/// A PLY file for each timestep in a new folder.
fn save_folder(scene: &OpenScene, path: &Path, watch: &mut Watch) -> Result<(), PipelineError> {
    let export = Export::new(scene)?;
    write_folder(path, |new| export.write_folder(TimestepKind::Ply, scene.frames(), new, watch).map(drop))
}

/// Makes a new folder, whole or not at all.
///
/// - `fill`: fills the folder, which has a temporary name until then
pub fn write_folder(path: &Path, fill: impl FnOnce(&Path) -> Result<(), PipelineError>) -> Result<(), PipelineError> {
    let unwritable = |error| PipelineError::Unwritable { path: path.into(), error };
    if path.exists() {
        return Err(unwritable(io::ErrorKind::AlreadyExists.into()));
    }
    let parent = parent_folder(path);
    let unfinished = Unfinished::begin(parent).map_err(unwritable)?;
    let new = unfinished.path().join("new");
    fs::create_dir(&new).map_err(unwritable)?;
    fill(&new)?;
    fs::rename(&new, path).map_err(unwritable)
}

/// Refuses early an output that could not be written at the end.
pub fn check_out(out: &Path, overwrite: bool) -> PyResult<()> {
    if out.is_dir() {
        return Err(exception(wrong(out, "is a folder", "the name of a file")));
    }
    if out.exists() && !overwrite {
        let message = format!("{}: exists already, expected a new name or overwrite=True", out.display());
        return Err(PyFileExistsError::new_err(message));
    }
    let parent = parent_folder(out);
    if !parent.is_dir() {
        let error = io::ErrorKind::NotFound.into();
        return Err(exception(PipelineError::Unwritable { path: out.into(), error }));
    }
    Ok(())
}

/// Writes a file whole or not at all.
pub fn write(
    path: &Path,
    overwrite: bool,
    fill: impl FnOnce(&fs::File) -> io::Result<()>,
) -> Result<(), PipelineError> {
    let existing = if overwrite { Existing::Replace } else { Existing::Keep };
    write_whole(path, existing, |file| fill(file))
        .map_err(|error| PipelineError::Unwritable { path: path.into(), error })
}

/// Wrong input.
///
/// - `path`: the culprit
pub fn wrong(path: &Path, found: &str, expected: &str) -> PipelineError {
    PipelineError::Input { culprit: path.display().to_string(), found: found.into(), expected: expected.into() }
}
