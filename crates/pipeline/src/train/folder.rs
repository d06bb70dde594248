//! The folder of a run: recognised, locked, cleared, and continued.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

use tcgs_interchange::{create_folders, is_unfinished};
use tcgs_train::{Checkpoint, Run, TrainError, Trainer};

use crate::observe::tell;
use crate::{Backend, Event, Observer, PipelineError};

/// Names of the files that this program writes into a run folder.
const OURS: [&str; 6] = ["scene.tcgs", "metrics.jsonl", "resume0.npz", "resume1.npz", "config.toml", "start.npz"];
/// Ending of the names of checkpoints that were set aside.
const DAMAGED: &str = ".damaged";

/// An open folder, locked as long as the file lives; none if another process has locked it.
#[cfg(not(windows))]
fn open_locked(folder: &Path) -> io::Result<Option<File>> {
    let file = File::open(folder)?;
    // Some drives have no locks: any other error counts as a lock.
    let is_taken = matches!(file.try_lock(), Err(fs::TryLockError::WouldBlock));
    Ok((!is_taken).then_some(file))
}

/// The same on Windows, which cannot lock folders. The folder itself is opened for writing and shared with no other
/// writer. Listing the folder and opening its files need no such right.
#[cfg(windows)]
fn open_locked(folder: &Path) -> io::Result<Option<File>> {
    use std::os::windows::fs::OpenOptionsExt;
    const FILE_ADD_FILE: u32 = 2;
    const FILE_SHARE_READ_AND_DELETE: u32 = 1 | 4;
    const FILE_FLAG_BACKUP_SEMANTICS: u32 = 0x0200_0000;
    const ERROR_SHARING_VIOLATION: i32 = 32;
    let mut options = File::options();
    options.access_mode(FILE_ADD_FILE).share_mode(FILE_SHARE_READ_AND_DELETE).custom_flags(FILE_FLAG_BACKUP_SEMANTICS);
    match options.open(folder) {
        Err(error) if error.raw_os_error() == Some(ERROR_SHARING_VIOLATION) => Ok(None),
        opened => opened.map(Some),
    }
}

/// A run folder, locked: one process at a time writes a run.
///
/// ```
/// use tcgs_pipeline::RunFolder;
/// let parent = tempfile::tempdir()?;
/// let path = parent.path().join("run");
/// assert!(!RunFolder::holds_run(&path)?);
/// let folder = RunFolder::make(&path)?;
/// assert!(RunFolder::lock(&path).is_err(), "another writer");
/// drop(folder);
/// assert!(!path.exists(), "no run began in it");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct RunFolder {
    path: PathBuf,
    /// The outermost folder that was made. It is removed again unless a run begins.
    made: Option<PathBuf>,
    /// Open as long as it is locked.
    _lock: File,
}

impl RunFolder {
    /// Whether the place of a run already holds one; if not, a run may begin there.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if it is a file, or a folder with other things in it.
    pub fn holds_run(folder: &Path) -> Result<bool, PipelineError> {
        let expected = "a run, an empty folder or a new name";
        // Other programs also have a config.toml and a folder of checkpoints. Every run names its frames.
        if Run::is_run(folder) {
            return match Run::open(folder) {
                Ok(run) if run.config().data.end_frame > 0 => Ok(true),
                Ok(_) => Err(PipelineError::input(folder.display(), "a config.toml of no run", expected)),
                Err(error) => Err(PipelineError::input(folder.display(), format!("no run: {error}"), expected)),
            };
        }
        if !folder.exists() {
            return match folder.is_symlink() {
                true => Err(PipelineError::input(folder.display(), "a link to a folder that does not exist", expected)),
                false => Ok(false),
            };
        }
        if !folder.is_dir() {
            return Err(PipelineError::input(folder.display(), "is a file", "the name of a folder"));
        }
        // A run stopped before its first file leaves only an empty folder or two.
        let is_empty = |entry: &fs::DirEntry| {
            let name = entry.file_name();
            is_unfinished(&name)
                || name == "start.npz" && Checkpoint::load(&entry.path(), None, false).is_ok()
                || name == "checkpoints" && fs::read_dir(entry.path()).is_ok_and(|mut inside| inside.next().is_none())
        };
        let entries = fs::read_dir(folder).and_then(Iterator::collect::<io::Result<Vec<_>>>);
        let entries = entries.map_err(|error| PipelineError::unreadable(folder, error, expected))?;
        if !entries.iter().all(is_empty) {
            return Err(PipelineError::input(folder.display(), "a folder with other things in it", expected));
        }
        Ok(false)
    }

    /// Locks a run folder until dropped. Network drives without locks are accepted unlocked.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if another process has locked it; [`PipelineError::Unreadable`] if there is none.
    pub fn lock(folder: &Path) -> Result<Self, PipelineError> {
        let path = folder.to_path_buf();
        match open_locked(folder).map_err(|error| PipelineError::unreadable(folder, error, "a run folder"))? {
            Some(lock) => Ok(Self { path, made: None, _lock: lock }),
            None => {
                let found = "another process is training into it";
                Err(PipelineError::input(folder.display(), found, "that to end first"))
            }
        }
    }

    /// Creates a run's folder and locks it. A created folder is removed again if the value is dropped before a run
    /// begins.
    ///
    /// # Errors
    /// [`PipelineError::Unwritable`] if it cannot be made; as [`Self::lock`].
    pub fn make(folder: &Path) -> Result<Self, PipelineError> {
        let is_missing = |folder: &&Path| !folder.as_os_str().is_empty() && !folder.exists();
        let made = folder.ancestors().take_while(is_missing).last().map(Path::to_path_buf);
        create_folders(folder).map_err(|error| PipelineError::Unwritable { path: folder.into(), error })?;
        let mut locked = Self::lock(folder)?;
        locked.made = made;
        Ok(locked)
    }

    /// Removes the files that a run wrote, and nothing else. An interrupted call leaves a shorter run.
    ///
    /// # Errors
    /// [`PipelineError::Unwritable`] if a file cannot be removed.
    pub fn clear(&self) -> Result<(), PipelineError> {
        self.remove_leftovers()?;
        let checkpoints = self.path.join("checkpoints");
        if checkpoints.is_dir() {
            let paths = fs::read_dir(&checkpoints)
                .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>());
            let mut paths = paths.map_err(|error| PipelineError::Unwritable { path: checkpoints, error })?;
            paths.sort();
            for path in paths.into_iter().rev().filter(|path| is_checkpoint(path)) {
                remove(path)?;
            }
        }
        OURS.iter().try_for_each(|name| remove(self.path.join(name)))
    }

    /// Removes the temporary files of a killed process. The lock excludes other writers.
    ///
    /// # Errors
    /// [`PipelineError::Unwritable`] if a file cannot be removed.
    pub fn remove_leftovers(&self) -> Result<(), PipelineError> {
        for folder in [self.path.clone(), self.path.join("checkpoints")] {
            tcgs_interchange::remove_unfinished(&folder, Duration::ZERO);
            let Ok(entries) = fs::read_dir(&folder) else { continue };
            for entry in entries.flatten() {
                if !is_unfinished(&entry.file_name()) {
                    continue;
                }
                // Old versions wrote temporary files of such names. A process killed right at the beginning or end
                // leaves an empty folder, or one with an empty mark.
                match entry.file_type() {
                    Ok(kind) if kind.is_file() => remove(entry.path())?,
                    Ok(kind) if kind.is_dir() => remove_hollow(&entry.path()),
                    _ => {}
                }
            }
        }
        Ok(())
    }

    /// The trainer after the last whole checkpoint; none if no timestep is finished. A damaged last checkpoint, or one
    /// with a damaged optimizer's state, is renamed and reported as [`Event::SetAside`]. Its timestep must then be
    /// trained again.
    ///
    /// - `run`: the run in this folder
    ///
    /// # Errors
    /// [`PipelineError::Train`] if a checkpoint other than the last is damaged; [`PipelineError::Stopped`] if the
    /// observer broke off.
    pub fn resume(
        &self,
        run: &Run,
        backend: &Backend,
        observer: &mut dyn Observer,
    ) -> Result<Option<Trainer>, PipelineError> {
        loop {
            let error = match run.resume_with(|state| backend.engine(state)) {
                Ok(trainer) => return Ok(trainer),
                Err(error) => error,
            };
            let finished = run.timesteps();
            let last = run.checkpoint_path(finished.saturating_sub(1));
            // The other of the two states allows resuming from this timestep. Without it, setting aside could leave
            // none.
            let has_other_state = || match finished {
                0 | 1 => true,
                2 => run.resumable(0, None).is_ok(),
                _ => run.checkpoint(0, None).and_then(|first| run.resumable(finished - 2, Some(&first))).is_ok(),
            };
            match error {
                TrainError::File { path, problem }
                    if path == last || path == run.resume_path(finished.saturating_sub(1)) && has_other_state() =>
                {
                    let mut aside = last.clone().into_os_string();
                    aside.push(DAMAGED);
                    let renamed = fs::rename(&last, &aside);
                    renamed.map_err(|error| PipelineError::Unwritable { path: last.clone(), error })?;
                    tell(observer, Event::SetAside { checkpoint: &path, problem: &problem })?;
                }
                other => return Err(other.into()),
            }
        }
    }
}

impl Drop for RunFolder {
    fn drop(&mut self) {
        let Some(made) = self.made.take().filter(|_| !Run::is_run(&self.path)) else { return };
        let _ = self.clear();
        let _ = fs::remove_dir(self.path.join("checkpoints"));
        for folder in self.path.ancestors() {
            // A folder that is not empty is in use by another process.
            if fs::remove_dir(folder).is_err() || folder == made {
                break;
            }
        }
    }
}

/// Removes a folder that holds nothing but empty files. A file that cannot be removed stays.
fn remove_hollow(folder: &Path) {
    let entries = fs::read_dir(folder).and_then(Iterator::collect::<io::Result<Vec<_>>>).unwrap_or_default();
    let is_empty = |entry: &fs::DirEntry| entry.metadata().is_ok_and(|found| found.is_file() && found.len() == 0);
    if entries.iter().all(is_empty) {
        for entry in entries {
            let _ = fs::remove_file(entry.path());
        }
        let _ = fs::remove_dir(folder);
    }
}

/// Removes a file, if it is there.
fn remove(path: PathBuf) -> Result<(), PipelineError> {
    match fs::remove_file(&path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(PipelineError::Unwritable { path, error }),
        _ => Ok(()),
    }
}

/// Whether a file of the folder `checkpoints` is a checkpoint, whole or damaged.
fn is_checkpoint(path: &Path) -> bool {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let name = name.strip_suffix(DAMAGED).unwrap_or(&name);
    name.strip_suffix(".npz").is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_runs_and_empty_folders_are_written_to() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("run");
        assert!(!RunFolder::holds_run(&folder).unwrap());
        fs::create_dir_all(folder.join("checkpoints")).unwrap();
        fs::write(folder.join(".writing-abc"), b"").unwrap();
        assert!(!RunFolder::holds_run(&folder).unwrap());
        fs::write(folder.join("config.toml"), b"data.end_frame = 1").unwrap();
        assert!(RunFolder::holds_run(&folder).unwrap());
        for text in ["", "baseURL = 'https://example.org'"] {
            fs::write(folder.join("config.toml"), text).unwrap();
            let refused = RunFolder::holds_run(&folder).err().unwrap().to_string();
            assert!(refused.contains("expected a run, an empty folder"), "{refused}");
        }
        fs::rename(folder.join("config.toml"), folder.join("thesis.txt")).unwrap();
        assert!(RunFolder::holds_run(&folder).err().unwrap().to_string().contains("other things"));
        assert!(RunFolder::holds_run(&folder.join("thesis.txt")).err().unwrap().to_string().contains("is a file"));
    }

    #[test]
    fn what_was_made_for_nothing_goes_again() {
        let parent = tempfile::tempdir().unwrap();
        let run = parent.path().join("a/run");
        let folder = RunFolder::make(&run).unwrap();
        fs::write(run.join("start.npz"), b"x").unwrap();
        drop(folder);
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
        let folder = RunFolder::make(&run).unwrap();
        fs::write(run.join("config.toml"), b"").unwrap();
        drop(folder);
        assert!(run.join("config.toml").exists());
        // An already existing folder stays.
        fs::remove_file(run.join("config.toml")).unwrap();
        drop(RunFolder::make(&run).unwrap());
        assert!(run.is_dir());
    }

    /// Other programs also have files of this name. The command line has a test with a true start.
    #[test]
    fn a_start_is_a_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let start = folder.path().join("start.npz");
        fs::write(&start, b"not a checkpoint").unwrap();
        assert!(RunFolder::holds_run(folder.path()).err().unwrap().to_string().contains("other things"));
    }

    #[test]
    fn clearing_spares_what_a_run_did_not_write() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("checkpoints")).unwrap();
        let ours =
            ["config.toml", "metrics.jsonl", "scene.tcgs", "resume0.npz", "checkpoints/000000.npz", ".writing-1"];
        let theirs = ["notes.txt", "checkpoints/best.npz.txt"];
        for name in ours.iter().chain(&theirs) {
            fs::write(path(name), b"x").unwrap();
        }
        RunFolder::lock(folder.path()).unwrap().clear().unwrap();
        assert!(ours.iter().all(|name| !path(name).exists()));
        assert!(theirs.iter().all(|name| path(name).exists()));
    }

    #[test]
    fn a_run_has_one_writer() {
        let folder = tempfile::tempdir().unwrap();
        let first = RunFolder::lock(folder.path()).unwrap();
        assert!(RunFolder::lock(folder.path()).err().unwrap().to_string().contains("another process"));
        drop(first);
        RunFolder::lock(folder.path()).unwrap();
    }
}
