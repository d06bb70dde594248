//! Listing folders and reading files of a capture.

use std::collections::{BTreeMap, HashSet};
use std::ffi::OsString;
use std::fs::DirEntry;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use tcgs_core::{natural_key, open_file, read_file, read_text};

use crate::CaptureError;

/// Most bytes of a JSON file of cameras, which may list half a million images.
pub(crate) const MAX_JSON_BYTES: u64 = 1 << 28;
/// Most bytes of the file of an image, a COLMAP model or points. Their readers hold no more than a few times as much.
const MAX_BYTES: u64 = 1 << 32;
/// Most bytes of a text of calibrations, clocks or descriptions: a thousand cameras. Parsers of TOML, YAML and XML take
/// up to a hundred times as much memory.
const MAX_TEXT_BYTES: u64 = 1 << 22;

/// Reads an image, or a file of COLMAP.
pub(crate) fn bytes(path: &Path) -> Result<Vec<u8>, CaptureError> {
    read_file(path, MAX_BYTES).map_err(|error| CaptureError::Io { path: path.into(), error })
}

/// Reads a text that a person or a calibration wrote.
///
/// # Errors
/// [`CaptureError`] if the file cannot be read, or is larger than any such file.
pub fn text(path: &Path) -> Result<String, CaptureError> {
    read_text(path, MAX_TEXT_BYTES).map_err(|error| CaptureError::Io { path: path.into(), error })
}

/// Reads a text of COLMAP, which lists every feature of every image.
///
/// # Errors
/// [`CaptureError`] if the file cannot be read, or is larger than any such file.
pub fn long_text(path: &Path) -> Result<String, CaptureError> {
    read_text(path, MAX_BYTES).map_err(|error| CaptureError::Io { path: path.into(), error })
}

/// Refuses a path that is no regular file: a reader of a device or a pipe might never end.
pub(crate) fn check_regular(path: &Path) -> Result<(), CaptureError> {
    open_file(path).map(drop).map_err(|error| CaptureError::Io { path: path.into(), error })
}

/// The visible files and folders of a folder, in the natural order of their names.
///
/// # Errors
/// [`CaptureError`] if the folder cannot be listed.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>, CaptureError> {
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
///
/// # Errors
/// [`CaptureError`] if the folder cannot be listed.
pub fn images(folder: &Path) -> Result<Vec<PathBuf>, CaptureError> {
    let mut listings = Listings::default();
    let mut paths = list(folder)?;
    paths.retain(|path| has_extension(path, &["png", "jpg", "jpeg"]) && listings.has_file(path));
    Ok(paths)
}

/// The files that exist, found by listing every folder once. Thousands of frames by tens of cameras would otherwise be
/// hundreds of thousands of queries to the file system. On a network each is a round trip.
#[derive(Default)]
pub(crate) struct Listings {
    /// Names of the files in each folder; none for a folder that does not exist.
    folders: BTreeMap<PathBuf, Option<HashSet<OsString>>>,
}

impl Listings {
    /// Whether a path is a file.
    pub fn has_file(&mut self, path: &Path) -> bool {
        let (Some(folder), Some(name)) = (path.parent(), path.file_name()) else { return path.is_file() };
        if !self.folders.contains_key(folder) {
            self.folders.insert(folder.into(), names_of_files(folder));
        }
        // Three cases are asked for one by one: a folder that may be entered but not listed, links, and names that only
        // the file system takes for the same.
        self.folders[folder].as_ref().is_some_and(|names| names.contains(name) || path.is_file())
    }
}

/// Names of the files in a folder, as its listing says; links are left out. `None` if there is no such folder.
fn names_of_files(folder: &Path) -> Option<HashSet<OsString>> {
    let entries = match std::fs::read_dir(folder) {
        Ok(entries) => entries,
        Err(error) if error.kind() == ErrorKind::NotFound => return None,
        Err(_) => return Some(HashSet::new()),
    };
    let is_file = |entry: &DirEntry| entry.file_type().is_ok_and(|kind| kind.is_file());
    Some(entries.flatten().filter(is_file).map(|entry| entry.file_name()).collect())
}

/// Whether a path has one of the extensions, in lower or upper case.
pub fn has_extension(path: &Path, extensions: &[&str]) -> bool {
    path.extension().is_some_and(|found| extensions.iter().any(|wanted| found.eq_ignore_ascii_case(wanted)))
}

/// The last part of a path.
pub fn name(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

/// The last part of a path without its extension.
pub fn stem(path: &Path) -> String {
    path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}
