//! Folders of results. They appear whole or not at all, and replace results only.

use std::ffi::OsStr;
use std::fs;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use tcgs_interchange::{ABANDONED, Unfinished, is_unfinished, moving, parent_folder, remove_unfinished};

use crate::error::PipelineError;

/// Temporary and final path of each [`NewFolder`].
static MAKING: Mutex<Vec<[PathBuf; 2]>> = Mutex::new(Vec::new());

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
    ///
    /// # Errors
    /// [`PipelineError::Exists`] if the folder exists and is not replaced. Other errors if the place cannot be written,
    /// or another process writes it.
    pub fn begin(place: &Path, force: bool, is_ours: fn(&Path) -> bool) -> Result<Self, PipelineError> {
        Self::check_name(place)?;
        let exists = || PipelineError::Exists { path: place.into() };
        let inside = place.exists();
        if inside && !Self::is_empty(place) {
            if !force {
                return Err(exists());
            }
            let foreign = foreign_file(place, is_ours)
                .map_err(|error| PipelineError::unreadable(place, error, "a folder that can be listed"))?;
            if let Some(foreign) = foreign {
                let expected = "a new name or a folder of its files alone";
                return Err(PipelineError::input(foreign.display(), "not written by this command", expected));
            }
        }
        let parent = parent_folder(place);
        if !parent.is_dir() {
            return Err(PipelineError::input(parent.display(), "no such folder", "one to write into"));
        }
        let around = if inside { place } else { parent };
        let failed = |error| PipelineError::Unwritable { path: place.into(), error };
        remove_unfinished(around, ABANDONED);
        let making = match Unfinished::begin_alone(around, place.file_name().unwrap_or("folder".as_ref())) {
            Err(error) if error.kind() == ErrorKind::WouldBlock => {
                let found = "another process is writing it";
                return Err(PipelineError::input(place.display(), found, "that to end first"));
            }
            begun => begun.map_err(failed)?,
        };
        // Another process may have written the folder since the first check.
        if !inside && place.exists() || inside && !force && !Self::is_empty(place) {
            return Err(exists());
        }
        let new = making.path().join("new");
        fs::create_dir(&new).map_err(failed)?;
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
    ///
    /// - returns: a warning if what was there before could not be removed
    ///
    /// # Errors
    /// [`PipelineError::Unwritable`] if the content cannot be moved; it says where the content is.
    pub fn finish(self) -> Result<Option<String>, PipelineError> {
        self.finish_around(|_| false)
    }

    /// Moves the content to its place, where some entries stay. If moving fails, nothing is lost: the error says where
    /// the content is.
    ///
    /// - `stays`: whether an old entry stays, by its name; not called if a new entry has the same name
    /// - returns: a warning if what was there before could not be removed
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn finish_around(self, stays: fn(&OsStr) -> bool) -> Result<Option<String>, PipelineError> {
        let Self { place, making, new, inside } = self;
        // From here on the unfinished folder may hold the only copy of some content, so no process may clean it up.
        let _whole = moving();
        MAKING.lock().unwrap_or_else(PoisonError::into_inner).retain(|[making, _]| *making != new);
        let making = making.keep();
        let before = making.path().join("before");
        let (moved, left) = match inside {
            false => (fs::rename(&new, &place), format!("all of it is in {}", new.display())),
            true => (
                exchange(&place, &new, &before, stays),
                format!("what is new is in {}, what was there in {}", new.display(), before.display()),
            ),
        };
        moved.map_err(|error| {
            let error = io::Error::new(error.kind(), format!("{left}: {error}"));
            PipelineError::Unwritable { path: place, error }
        })?;
        let removed = fs::remove_dir_all(making.path());
        let what = || format!("{}: removing what was there before failed", making.path().display());
        Ok(removed.err().map(|error| format!("{}: {error}", what())))
    }

    /// Replaces temporary paths in a message: a file in a [`NewFolder`] gets its final path.
    pub fn by_final_names(mut message: String) -> String {
        for [new, place] in MAKING.lock().unwrap_or_else(PoisonError::into_inner).iter() {
            message = message.replace(&new.display().to_string(), &place.display().to_string());
        }
        message
    }

    /// Whether a folder exists and is empty, apart from unfinished output of a stopped process.
    pub fn is_empty(path: &Path) -> bool {
        let Ok(mut entries) = fs::read_dir(path) else { return false };
        entries.all(|entry| entry.is_ok_and(|entry| is_unfinished(&entry.file_name())))
    }

    /// Refuses a dangling link and an illegal name.
    ///
    /// # Errors
    /// [`PipelineError::Input`] that names the path.
    pub fn check_name(path: &Path) -> Result<(), PipelineError> {
        let wrong = |found: &str, expected: &str| Err(PipelineError::input(path.display(), found, expected));
        match (path.symlink_metadata(), path.metadata()) {
            (Ok(_), Err(error)) if error.kind() == ErrorKind::NotFound => {
                wrong("a link to a file that does not exist", "another name")
            }
            (_, Err(error)) if error.kind() != ErrorKind::NotFound => {
                wrong(&error.to_string(), "a name that can be written")
            }
            _ => Ok(()),
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    fn is_png(path: &Path) -> bool {
        path.extension().is_some_and(|e| e == "png")
    }

    #[test]
    fn folders_appear_whole_and_spare_what_is_not_theirs() {
        let parent = tempfile::tempdir().unwrap();
        let place = parent.path().join("frames");
        let fill = |force, name: &str| {
            let folder = NewFolder::begin(&place, force, is_png)?;
            fs::write(folder.path().join(name), b"x").unwrap();
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
}
