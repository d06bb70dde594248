//! What a folder holds.

use std::path::{Path, PathBuf};

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

/// Orders names so that numbers in them count as numbers: `cam2` before `cam10`.
pub(crate) fn natural_key(name: &str) -> (Vec<(String, u64)>, String) {
    let mut key = Vec::new();
    let mut rest = name;
    while !rest.is_empty() {
        let text = rest.find(|c: char| c.is_ascii_digit()).unwrap_or(rest.len());
        let digits = rest[text..].find(|c: char| !c.is_ascii_digit()).map_or(rest.len(), |end| text + end);
        key.push((rest[..text].to_owned(), rest[text..digits].parse().unwrap_or(0)));
        rest = &rest[digits..];
    }
    // Names that are equal but for leading zeros.
    (key, name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_as_numbers() {
        let mut names = ["cam10", "cam2", "b3_2", "cam02", "b3_10", "b", "cam2.x"];
        names.sort_by_cached_key(|name| natural_key(name));
        assert_eq!(names, ["b", "b3_2", "b3_10", "cam02", "cam2", "cam2.x", "cam10"]);
    }
}
