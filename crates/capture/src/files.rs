//! What a folder holds.

use std::path::{Path, PathBuf};

use tcgs_core::natural_key;

use crate::CaptureError;

/// The visible files and folders of a folder, in the natural order of their names.
pub(crate) fn list(folder: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let failed = |error| CaptureError::Io { path: folder.into(), error };
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if !name(&path).starts_with('.') {
            paths.push(path);
        }
    }
    paths.sort_by_cached_key(|path| natural_key(&name(path)));
    Ok(paths)
}

/// The images of a folder, in the natural order of their names.
pub(crate) fn images(folder: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let mut paths = list(folder)?;
    paths.retain(|path| has_extension(path, &["png", "jpg", "jpeg"]) && path.is_file());
    Ok(paths)
}

pub(crate) fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|found| extensions.iter().any(|wanted| found.eq_ignore_ascii_case(wanted)))
}

/// The last part of a path.
pub(crate) fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The last part of a path without its extension.
pub(crate) fn stem(path: &Path) -> String {
    path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
