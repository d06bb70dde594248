//! Outputs of commands. An output is written whole or not at all, and replaces existing content only with `--force`.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context;
use serde_json::Value;
use tcgs_interchange::{ABANDONED, Existing, Unfinished, parent_folder, remove_unfinished, write_whole};
use tcgs_pipeline::NewFolder;
use tcgs_train::Run;

use crate::error::wrong_input;
use crate::terminal::note;

/// Endings of files that commands write but never read as a part of a folder.
const RESULTS: [&str; 3] = ["csv", "html", "tcgs"];

/// Refuses, before the work, output files that cannot be written or that would replace an input.
///
/// - `sources`: files and folders that the command reads
/// - `force`: whether existing files are replaced
pub fn check_files(files: &[&Path], sources: &[&Path], force: bool) -> anyhow::Result<()> {
    for (i, file) in files.iter().enumerate() {
        if let Some(source) = sources.iter().find(|source| is_part_of(file, source)) {
            return Err(is_read(file, source, "expected another name for what is written"));
        }
        check_file(file, force)?;
        if files[..i].iter().any(|other| is_same(file, other)) {
            let problem = "is to be written twice, expected a name for each result";
            return Err(wrong_input(format!("{}: {problem}", file.display())));
        }
        if !is_device(file) {
            // A test: without a temporary folder here, the result could not be written.
            let file = file.canonicalize().unwrap_or_else(|_| file.to_path_buf());
            begin_beside(&file).with_context(|| format!("writing {}", file.display()))?;
        }
    }
    Ok(())
}

/// Refuses an output folder that is a source or contains one.
pub fn check_folder(folder: &Path, sources: &[&Path]) -> anyhow::Result<()> {
    let place = resolved(folder);
    match sources.iter().find(|source| resolved(source).starts_with(&place)) {
        None => Ok(()),
        Some(source) => Err(is_read(folder, source, "expected another folder for what is written")),
    }
}

/// The error of an output that would destroy a source.
fn is_read(output: &Path, source: &Path, expected: &str) -> anyhow::Error {
    let (output, source, [o, s]) = (output.display(), source.display(), [output, source].map(resolved));
    wrong_input(match (s.starts_with(&o), o.starts_with(&s)) {
        (true, false) => format!("{output}: holds {source}, which this command reads, {expected}"),
        (false, true) => format!("{output}: is a part of {source}, which this command reads, {expected}"),
        _ => format!("{output}: is what this command reads, {expected}"),
    })
}

/// Whether writing a file would change a source, which is the file itself or a folder that contains it.
fn is_part_of(file: &Path, source: &Path) -> bool {
    if is_same(file, source) {
        return !is_device(file);
    }
    let (file, folder) = (resolved(file), resolved(source));
    match file.strip_prefix(&folder) {
        Ok(_) if !file.is_file() => false,
        Ok(name) if Run::is_run(&folder) => Run::has_file(name),
        Ok(name) => !name.extension().is_some_and(|ending| RESULTS.iter().any(|result| ending == *result)),
        Err(_) => false,
    }
}

/// Whether two paths lead to the same file or folder, which need not exist.
fn is_same(a: &Path, b: &Path) -> bool {
    #[cfg(unix)]
    if let (Ok(a), Ok(b)) = (fs::metadata(a), fs::metadata(b)) {
        use std::os::unix::fs::MetadataExt;
        return (a.dev(), a.ino()) == (b.dev(), b.ino());
    }
    resolved(a) == resolved(b)
}

/// An absolute path without links; the last component need not exist.
fn resolved(path: &Path) -> PathBuf {
    let in_parent = || Some(parent_folder(path).canonicalize().ok()?.join(path.file_name()?));
    path.canonicalize().ok().or_else(in_parent).unwrap_or_else(|| path.into())
}

fn is_device(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}

/// Refuses a path that [`write_file`] cannot write.
fn check_file(path: &Path, force: bool) -> anyhow::Result<()> {
    let parent = parent_folder(path);
    if !parent.is_dir() {
        return Err(wrong_input(format!("{}: no such folder, expected one to write into", parent.display())));
    }
    if path.file_name().is_none() || path.to_string_lossy().ends_with(std::path::is_separator) {
        return Err(wrong_input(format!("{}: is the name of a folder, expected that of a file", path.display())));
    }
    NewFolder::check_name(path)?;
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => {
            Err(wrong_input(format!("{}: is a folder, expected the name of a file", path.display())))
        }
        Ok(found) if found.is_file() && !force => Err(exists(path)),
        _ => Ok(()),
    }
}

/// Writes a file whole or not at all. Devices and pipes are written to as they are.
///
/// - `force`: whether an existing file is replaced
pub fn write_file(path: &Path, bytes: &[u8], force: bool) -> anyhow::Result<()> {
    write_file_with(path, force, |mut file| file.write_all(bytes))
}

/// [`write_file`] with a writer, for content that should not be in memory twice.
pub fn write_file_with(path: &Path, force: bool, write: impl FnOnce(&File) -> io::Result<()>) -> anyhow::Result<()> {
    check_file(path, force)?;
    let context = || format!("writing {}", path.display());
    if is_device(path) {
        let device = fs::OpenOptions::new().write(true).open(path).with_context(context)?;
        return write(&device).with_context(context);
    }
    // A link stays; its target is replaced.
    let path = path.canonicalize().unwrap_or_else(|_| path.into());
    remove_unfinished(parent_folder(&path), ABANDONED);
    let existing = if force { Existing::Replace } else { Existing::Keep };
    match write_whole(&path, existing, |file| write(file)) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Err(exists(&path)),
        other => other.with_context(context),
    }
}

/// Begins a folder for unfinished content beside a path, and removes abandoned ones there.
pub fn begin_beside(place: &Path) -> io::Result<Unfinished> {
    remove_unfinished(parent_folder(place), ABANDONED);
    Unfinished::begin(parent_folder(place))
}

/// Writes a result as JSON.
pub fn write_json(path: &Path, value: &Value, force: bool) -> anyhow::Result<()> {
    write_file(path, format!("{value:#}\n").as_bytes(), force)
}

/// Moves a new folder to its place.
///
/// - `stays`: whether an old entry stays, by its name
pub fn finish(folder: NewFolder, stays: fn(&OsStr) -> bool) -> anyhow::Result<()> {
    if let Some(warning) = folder.finish_around(stays)? {
        note(&warning);
    }
    Ok(())
}

/// Whether a file's name is a number followed by `ending`.
pub fn is_numbered(path: &Path, ending: &str) -> bool {
    let name = path.file_name().and_then(OsStr::to_str).unwrap_or_default();
    name.strip_suffix(ending).is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
}

fn exists(path: &Path) -> anyhow::Error {
    wrong_input(format!("{}: exists already, expected a new name or --force to replace it", path.display()))
}

/// A time in words.
pub fn show_time(time: Duration) -> String {
    match time.as_secs_f64() {
        secs @ ..90.0 => format!("{secs:.0} s"),
        secs @ ..5400.0 => format!("{:.0} min", secs / 60.0),
        secs => format!("{:.1} h", secs / 3600.0),
    }
}

/// A colour, sRGB of 255, as CSS writes it.
pub fn show_color([red, green, blue]: [u8; 3]) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

/// Formats a size with three digits and a unit in powers of 1000.
pub fn show_bytes(bytes: u64) -> String {
    let mut value = bytes as f64;
    for unit in ["B", "kB", "MB", "GB"] {
        if value < 999.5 || unit == "GB" {
            let decimals = if unit == "B" || value >= 99.95 { 0 } else { 1 + usize::from(value < 9.995) };
            return format!("{value:.decimals$} {unit}");
        }
        value /= 1000.0;
    }
    unreachable!("the last unit takes everything")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_replaced_only_when_told() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        write_file(&path, b"one", false).unwrap();
        let error = write_file(&path, b"two", false).unwrap_err().to_string();
        assert!(error.contains("exists already") && error.contains("--force"), "{error}");
        assert_eq!(fs::read(&path).unwrap(), b"one");
        write_file(&path, b"two", true).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "a temporary file was left behind");
        assert!(write_file(folder.path(), b"", true).unwrap_err().to_string().contains("is a folder"));
        assert!(write_file(&folder.path().join("no/b"), b"", true).unwrap_err().to_string().contains("no such folder"));
    }

    #[cfg(unix)]
    #[test]
    fn links_and_devices_stay_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let (target, link) = (folder.path().join("target"), folder.path().join("link"));
        fs::write(&target, b"one").unwrap();
        std::os::unix::fs::symlink(&target, &link).unwrap();
        write_file(&link, b"two", true).unwrap();
        assert!(link.symlink_metadata().unwrap().is_symlink());
        assert_eq!(fs::read(&target).unwrap(), b"two");
        write_file(Path::new("/dev/null"), b"three", false).unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }

    #[test]
    fn sizes_have_three_digits() {
        let sizes = [0, 999, 1000, 99_960, 142_300, 999_600, 46_000_000, 2_161_000_000].map(show_bytes);
        assert_eq!(sizes, ["0 B", "999 B", "1.00 kB", "100 kB", "142 kB", "1.00 MB", "46.0 MB", "2.16 GB"]);
    }
}
