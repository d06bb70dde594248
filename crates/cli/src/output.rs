//! Outputs of commands. An output is written whole or not at all, and replaces existing content only with `--force`.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use anyhow::Context;
use serde_json::Value;
use tcgs_interchange::{Existing, Unfinished, is_unfinished, remove_unfinished, write_whole};
use tcgs_train::Run;

use crate::error::wrong_input;
use crate::interrupt;
use crate::terminal::note;

/// Age, since its last change, at which a killed process's unfinished output is removed. A day gives a person enough
/// time to look at it.
const ABANDONED: Duration = Duration::from_secs(24 * 3600);

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
    let in_parent = || Some(parent(path).canonicalize().ok()?.join(path.file_name()?));
    path.canonicalize().ok().or_else(in_parent).unwrap_or_else(|| path.into())
}

fn is_device(path: &Path) -> bool {
    fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir())
}

/// Refuses a path that [`write_file`] cannot write.
fn check_file(path: &Path, force: bool) -> anyhow::Result<()> {
    let parent = parent(path);
    if !parent.is_dir() {
        return Err(wrong_input(format!("{}: no such folder, expected one to write into", parent.display())));
    }
    if path.file_name().is_none() || path.to_string_lossy().ends_with(std::path::is_separator) {
        return Err(wrong_input(format!("{}: is the name of a folder, expected that of a file", path.display())));
    }
    check_name(path)?;
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => {
            Err(wrong_input(format!("{}: is a folder, expected the name of a file", path.display())))
        }
        Ok(found) if found.is_file() && !force => Err(exists(path)),
        _ => Ok(()),
    }
}

/// Refuses a dangling link and an illegal name.
fn check_name(path: &Path) -> anyhow::Result<()> {
    match (path.symlink_metadata(), path.metadata()) {
        (Ok(_), Err(error)) if error.kind() == ErrorKind::NotFound => {
            Err(wrong_input(format!("{}: a link to a file that does not exist, expected another name", path.display())))
        }
        (_, Err(error)) if error.kind() != ErrorKind::NotFound => {
            Err(wrong_input(format!("{}: {error}, expected a name that can be written", path.display())))
        }
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
    remove_unfinished(parent(&path), ABANDONED);
    let existing = if force { Existing::Replace } else { Existing::Keep };
    match write_whole(&path, existing, |file| write(file)) {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Err(exists(&path)),
        other => other.with_context(context),
    }
}

/// Temporary and final path of each [`NewFolder`].
static MAKING: Mutex<Vec<[PathBuf; 2]>> = Mutex::new(Vec::new());

/// Replaces temporary paths in a message: a file in a [`NewFolder`] gets its final path.
pub fn by_final_names(mut message: String) -> String {
    for [new, place] in MAKING.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        message = message.replace(&new.display().to_string(), &place.display().to_string());
    }
    message
}

/// Begins a folder for unfinished content beside a path, and removes abandoned ones there.
pub fn begin_beside(place: &Path) -> io::Result<Unfinished> {
    remove_unfinished(parent(place), ABANDONED);
    Unfinished::begin(parent(place))
}

/// Writes a result as JSON.
pub fn write_json(path: &Path, value: &Value, force: bool) -> anyhow::Result<()> {
    write_file(path, format!("{value:#}\n").as_bytes(), force)
}

/// A folder under construction, until [`NewFolder::finish`] puts it in its place.
///
/// A place that does not exist yet gets a temporary folder beside it, which is renamed. A place that exists gets one
/// inside it: a shell may stand in the folder, or a disk may be mounted there.
pub struct NewFolder {
    place: PathBuf,
    making: Unfinished,
    new: PathBuf,
    inside: bool,
}

impl NewFolder {
    /// Begins a folder.
    ///
    /// - `force`: whether an existing folder is replaced. Even then `is_ours` must know the names of all its files, so
    ///   that a slip cannot cost a home directory
    pub fn begin(place: &Path, force: bool, is_ours: fn(&Path) -> bool) -> anyhow::Result<Self> {
        check_name(place)?;
        let inside = place.exists();
        if inside && !is_empty_folder(place) {
            if !force {
                return Err(exists(place));
            }
            let foreign = foreign_file(place, is_ours).with_context(|| format!("reading {}", place.display()))?;
            if let Some(foreign) = foreign {
                let problem = "not written by this command, expected a new name or a folder of its files alone";
                return Err(wrong_input(format!("{}: {problem}", foreign.display())));
            }
        }
        let parent = parent(place);
        if !parent.is_dir() {
            return Err(wrong_input(format!("{}: no such folder, expected one to write into", parent.display())));
        }
        let around = if inside { place } else { parent };
        let context = || format!("writing {}", place.display());
        remove_unfinished(around, ABANDONED);
        let making = match Unfinished::begin_alone(around, place.file_name().unwrap_or("folder".as_ref())) {
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                let problem = "another process is writing it, expected that to end first";
                return Err(wrong_input(format!("{}: {problem}", place.display())));
            }
            begun => begun.with_context(context)?,
        };
        // Another process may have written the folder since the first check.
        if !inside && place.exists() || inside && !force && !is_empty_folder(place) {
            return Err(exists(place));
        }
        let new = making.path().join("new");
        fs::create_dir(&new).with_context(context)?;
        MAKING.lock().unwrap_or_else(PoisonError::into_inner).push([new.clone(), place.into()]);
        Ok(Self { place: place.into(), making, new, inside })
    }

    /// The temporary path of the folder's content.
    pub fn path(&self) -> &Path {
        &self.new
    }

    /// The temporary folder that holds [`Self::path`] and the mark by which a later command removes it.
    pub fn temporary(&self) -> &Path {
        self.making.path()
    }

    /// Moves the content to its place.
    pub fn finish(self) -> anyhow::Result<()> {
        self.finish_around(|_| false)
    }

    /// Moves the content to its place, where some entries stay. If moving fails, nothing is lost: the error says where
    /// the content is.
    ///
    /// - `stays`: whether an old entry stays, by its name; not called if a new entry has the same name
    pub fn finish_around(self, stays: fn(&OsStr) -> bool) -> anyhow::Result<()> {
        let Self { place, making, new, inside } = self;
        let context = format!("writing {}", place.display());
        // From here on the unfinished folder may hold the only copy of some content, so no process may clean it up.
        let _whole = interrupt::moving();
        MAKING.lock().unwrap_or_else(PoisonError::into_inner).retain(|[making, _]| *making != new);
        let making = making.keep();
        let before = making.path().join("before");
        let moved = match inside {
            false => fs::rename(&new, &place).with_context(|| format!("{context}; all of it is in {}", new.display())),
            true => exchange(&place, &new, &before, stays).with_context(|| {
                format!("{context}; what is new is in {}, what was there in {}", new.display(), before.display())
            }),
        };
        moved?;
        if let Err(error) = fs::remove_dir_all(making.path()) {
            let making = making.path();
            note(&format!("{}: removing what was there before failed: {error}", making.display()));
        }
        Ok(())
    }
}

/// Moves the entries of `place` to `before`, and all of `new` to `place`. Every process's unfinished folders stay;
/// `new` and `before` lie in one of them.
fn exchange(place: &Path, new: &Path, before: &Path, stays: fn(&OsStr) -> bool) -> io::Result<()> {
    fs::create_dir(before)?;
    for entry in fs::read_dir(place)?.collect::<io::Result<Vec<_>>>()? {
        let name = entry.file_name();
        if !is_unfinished(&name) && !stays(&name) {
            fs::rename(entry.path(), before.join(name))?;
        }
    }
    for entry in fs::read_dir(new)?.collect::<io::Result<Vec<_>>>()? {
        fs::rename(entry.path(), place.join(entry.file_name()))?;
    }
    Ok(())
}

/// Whether a folder exists and is empty, apart from unfinished output of a stopped process.
pub fn is_empty_folder(path: &Path) -> bool {
    let Ok(mut entries) = fs::read_dir(path) else { return false };
    entries.all(|entry| entry.is_ok_and(|entry| is_unfinished(&entry.file_name())))
}

/// The first file below `folder` that is not ours; `folder` itself if it is not a folder.
fn foreign_file(folder: &Path, is_ours: fn(&Path) -> bool) -> io::Result<Option<PathBuf>> {
    if !folder.is_dir() {
        return Ok(Some(folder.into()));
    }
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.file_name().is_some_and(is_unfinished) {
            continue;
        }
        let foreign = match path.symlink_metadata()?.is_dir() {
            true => foreign_file(&path, is_ours)?,
            false => (!is_ours(&path)).then_some(path),
        };
        if foreign.is_some() {
            return Ok(foreign);
        }
    }
    Ok(None)
}

/// Whether a file's name is a number followed by `ending`.
pub fn is_numbered(path: &Path, ending: &str) -> bool {
    let name = path.file_name().and_then(OsStr::to_str).unwrap_or_default();
    name.strip_suffix(ending).is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
}

fn exists(path: &Path) -> anyhow::Error {
    wrong_input(format!("{}: exists already, expected a new name or --force to replace it", path.display()))
}

/// The folder that a path lies in.
pub fn parent(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
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

    fn is_png(path: &Path) -> bool {
        path.extension().is_some_and(|e| e == "png")
    }

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
    fn folders_appear_whole_and_spare_what_is_not_theirs() {
        let parent = tempfile::tempdir().unwrap();
        let place = parent.path().join("frames");
        let fill = |force, name: &str| -> anyhow::Result<()> {
            let folder = NewFolder::begin(&place, force, is_png)?;
            fs::write(folder.path().join(name), b"x")?;
            assert!(!place.join(name).exists(), "not before it is finished");
            folder.finish()
        };
        fill(false, "1.png").unwrap();
        assert!(fill(false, "2.png").unwrap_err().to_string().contains("exists already"));
        fill(true, "2.png").unwrap();
        assert!(!place.join("1.png").exists() && place.join("2.png").exists());
        fs::write(place.join("diary.txt"), b"x").unwrap();
        assert!(fill(true, "3.png").unwrap_err().to_string().contains("diary.txt: not written by this command"));
        fs::remove_dir_all(&place).unwrap();
        fs::create_dir(&place).unwrap();
        fill(false, "4.png").unwrap();
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1, "a temporary folder was left behind");
    }

    #[cfg(unix)]
    #[test]
    fn a_folder_that_exists_stays_the_same_one() {
        use std::os::unix::fs::MetadataExt;
        let place = tempfile::tempdir().unwrap();
        let before = fs::metadata(place.path()).unwrap().ino();
        for name in ["1.png", "2.png"] {
            let folder = NewFolder::begin(&place.path().join("."), true, is_png).unwrap();
            fs::write(folder.path().join(name), b"x").unwrap();
            folder.finish().unwrap();
            let names: Vec<_> = fs::read_dir(place.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
            assert_eq!(names, [name]);
        }
        assert_eq!(fs::metadata(place.path()).unwrap().ino(), before);
    }

    #[test]
    fn what_cannot_be_put_in_its_place_is_kept() {
        let parent = tempfile::tempdir().unwrap();
        let place = parent.path().join("frames");
        let folder = NewFolder::begin(&place, false, is_png).unwrap();
        fs::write(folder.path().join("1.png"), b"x").unwrap();
        fs::create_dir(&place).unwrap();
        fs::write(place.join("another.png"), b"x").unwrap();
        let making = folder.path().to_owned();
        let error = folder.finish().unwrap_err().to_string();
        assert!(error.contains(making.to_str().unwrap()), "{error}");
        assert!(making.join("1.png").exists() && place.join("another.png").exists());
    }

    #[test]
    fn a_replaced_folder_hands_over_what_stays() {
        let parent = tempfile::tempdir().unwrap();
        let place = parent.path().join("demo");
        fs::create_dir_all(place.join("notes")).unwrap();
        fs::write(place.join("notes/one.txt"), b"precious").unwrap();
        fs::write(place.join("old.png"), b"x").unwrap();
        let folder = NewFolder::begin(&place, true, |_| true).unwrap();
        fs::write(folder.path().join("new.png"), b"x").unwrap();
        folder.finish_around(|name| name == "notes").unwrap();
        assert_eq!(fs::read(place.join("notes/one.txt")).unwrap(), b"precious");
        assert!(place.join("new.png").exists() && !place.join("old.png").exists());
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1, "a temporary folder was left behind");
    }

    #[test]
    fn sizes_have_three_digits() {
        let sizes = [0, 999, 1000, 99_960, 142_300, 999_600, 46_000_000, 2_161_000_000].map(show_bytes);
        assert_eq!(sizes, ["0 B", "999 B", "1.00 kB", "100 kB", "142 kB", "1.00 MB", "46.0 MB", "2.16 GB"]);
    }
}
