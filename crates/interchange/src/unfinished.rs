//! Files and folders that appear whole or not at all, and what becomes of them when a process is killed.
//!
//! New content is written inside a folder `.writing-XXXXXX` beside the place of the output, and so on the same file
//! system. Once whole, it is renamed into its place. The folder holds a mark beside the content: a file with a text
//! about the folder. The writing process keeps it locked. A process that is killed leaves the folder behind.
//! [`remove_unfinished`] recognises such a folder by the mark's text. A free lock tells it that no process writes into
//! the folder any more.

use std::{
    ffi::{OsStr, OsString},
    fs::{self, File, OpenOptions, TryLockError},
    io::{self, ErrorKind, Read, Write},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, SystemTime},
};

use tempfile::TempPath;

/// How the names of folders with unfinished content begin.
const PREFIX: &str = ".writing-";
/// Name of the mark inside such a folder.
const MARK: &str = "unfinished-by-tcgs";
/// Content of the mark. Nothing is removed without it, so it must not change.
const MARK_TEXT: &str = "tcgs writes here what it renames when it is whole. If no tcgs runs, this folder is left over from one\n\
                         that was stopped, and may be removed.\n";

/// Tries to remove or rename a folder into which others write meanwhile.
const REMOVALS: usize = 100;

/// Age, since its last change, at which a killed process's unfinished output is removed. A day gives a person enough
/// time to look at it.
pub const ABANDONED: Duration = Duration::from_secs(24 * 3600);

/// The temporary folders of this process.
static HELD: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());
/// Locked while finished content is moved to its place.
static MOVING: Mutex<()> = Mutex::new(());

/// Behaviour of [`write_whole`] if the file exists already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// The file stays as it is, and writing fails with [`io::ErrorKind::AlreadyExists`].
    Keep,
    /// The new file takes its place.
    Replace,
}

/// Writes a file atomically: `write` fills a temporary file on the same file system, which is synced to the disk and
/// then renamed to `path`. So neither an error, nor a killed process, nor a power cut leaves half a file.
///
/// - `path`: in a folder that exists; a symbolic link is replaced, not followed
/// - `write`: writes the content to an unbuffered file
///
/// # Errors
/// The errors of the file system and of `write`; [`io::ErrorKind::AlreadyExists`] with [`Existing::Keep`] if `path`
/// exists. `path` is unchanged after an error.
///
/// ```
/// use std::io::Write;
/// use tcgs_interchange::{Existing, write_whole};
///
/// let folder = tempfile::tempdir()?;
/// let path = folder.path().join("result.json");
/// write_whole(&path, Existing::Keep, |file| file.write_all(b"{}"))?;
/// assert!(write_whole(&path, Existing::Keep, |file| file.write_all(b"[]")).is_err());
/// assert_eq!(std::fs::read(&path)?, b"{}");
/// # Ok::<(), std::io::Error>(())
/// ```
pub fn write_whole(path: &Path, existing: Existing, write: impl FnOnce(&mut File) -> io::Result<()>) -> io::Result<()> {
    let folder = parent_folder(path);
    let unfinished = Unfinished::begin(folder)?;
    let new = unfinished.path().join("new");
    let mut file = File::create_new(&new)?;
    write(&mut file)?;
    file.sync_all()?;
    drop(file);
    let new = TempPath::try_from_path(new)?;
    match existing {
        Existing::Keep => new.persist_noclobber(path)?,
        Existing::Replace => new.persist(path)?,
    }
    // The rename itself must survive a power cut too. Elsewhere a folder cannot be opened like a file.
    if cfg!(unix) {
        File::open(folder)?.sync_all()?;
    }
    Ok(())
}

/// The folder that a path lies in.
pub fn parent_folder(path: &Path) -> &Path {
    path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A temporary folder for unfinished content. Its locked mark tells [`remove_unfinished`] that the folder is this
/// program's, and in use. Dropping the value removes the folder with everything that is still in it.
#[derive(Debug)]
pub struct Unfinished {
    /// Locked as long as it is open; first, so that the folder is removed after the file is closed.
    mark: File,
    folder: Held,
}

/// A folder that is removed when the value is dropped, and until then an entry of [`HELD`].
#[derive(Debug)]
struct Held(PathBuf);

impl Held {
    fn all() -> MutexGuard<'static, Vec<PathBuf>> {
        HELD.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn forget(&self, all: &mut Vec<PathBuf>) {
        all.retain(|path| *path != self.0);
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        let mut all = Self::all();
        if all.contains(&self.0) {
            let _ = fs::remove_dir_all(&self.0);
            self.forget(&mut all);
        }
    }
}

impl Unfinished {
    /// Creates a temporary folder inside `folder`, and the locked mark in it.
    ///
    /// - `folder`: the folder in which the finished content will lie, or whose content it will replace
    ///
    /// # Errors
    /// The errors of the file system.
    pub fn begin(folder: &Path) -> io::Result<Self> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX);
        // A temporary folder is private unless told; what is made here becomes as readable as any other.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
        let mut all = Held::all();
        let folder = Held(builder.tempdir_in(folder)?.keep());
        all.push(folder.0.clone());
        drop(all);
        let mut mark = File::create_new(folder.0.join(MARK))?;
        // Some network drives know no locks; there nothing is ever removed.
        let _ = mark.try_lock();
        // The text is written after the lock: a mark with text and without a lock belongs to a process that ended.
        mark.write_all(MARK_TEXT.as_bytes())?;
        Ok(Self { mark, folder })
    }

    /// As [`Self::begin`], for content that only one process may make at a time. The temporary folder is
    /// `.writing-NAME`; a second process with the same name is refused. On a system that cannot rename folders in use,
    /// or cannot lock files, both may begin.
    ///
    /// - `name`: of the content, the same for all processes
    ///
    /// # Errors
    /// [`io::ErrorKind::WouldBlock`] if another process makes the same; the errors of the file system.
    pub fn begin_alone(folder: &Path, name: &OsStr) -> io::Result<Self> {
        let mut begun = Self::begin(folder)?;
        let mut own = OsString::from(PREFIX);
        own.push(name);
        let own = folder.join(own);
        // A process may end between two looks.
        for _ in 0..REMOVALS {
            match begun.rename(&own) {
                Ok(()) => break,
                Err(error) if matches!(error.kind(), ErrorKind::DirectoryNotEmpty | ErrorKind::AlreadyExists) => {}
                Err(_) => break,
            }
            match Mark::open(&own.join(MARK)) {
                Mark::Abandoned(_mark) => drop(fs::remove_dir_all(&own)),
                Mark::Locked => return Err(ErrorKind::WouldBlock.into()),
                Mark::Empty(mark) if matches!(mark.try_lock(), Err(TryLockError::WouldBlock)) => {
                    return Err(ErrorKind::WouldBlock.into());
                }
                // A process has kept the folder.
                Mark::Empty(_) | Mark::Unknown if own.exists() => break,
                Mark::Empty(_) | Mark::Unknown => {}
            }
        }
        Ok(begun)
    }

    fn rename(&mut self, to: &Path) -> io::Result<()> {
        let mut all = Held::all();
        fs::rename(&self.folder.0, to)?;
        self.folder.forget(&mut all);
        self.folder.0 = to.into();
        all.push(to.into());
        Ok(())
    }

    /// Path of the temporary folder. The caller writes the content into it, under any name but `unfinished-by-tcgs`.
    pub fn path(&self) -> &Path {
        &self.folder.0
    }

    /// Hands the folder over to the caller. Dropping, [`remove_unfinished`] and [`remove_held`] leave it alone.
    pub fn keep(self) -> Kept {
        let Self { mark, folder } = self;
        folder.forget(&mut Held::all());
        // A mark without its text makes no folder removable.
        let _ = mark.set_len(0);
        Kept { _mark: mark, folder: folder.0.clone() }
    }
}

/// A folder that was an [`Unfinished`], and now belongs to the caller. As long as the value lives, no other process
/// begins the same ([`Unfinished::begin_alone`]). Dropping it removes the mark.
#[derive(Debug)]
pub struct Kept {
    _mark: File,
    folder: PathBuf,
}

impl Kept {
    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.folder
    }
}

impl Drop for Kept {
    fn drop(&mut self) {
        let _ = fs::remove_file(self.folder.join(MARK));
    }
}

/// Whether a file name is that of a folder with unfinished content: whether it begins with `.writing-`.
pub fn is_unfinished(name: &OsStr) -> bool {
    name.to_string_lossy().starts_with(PREFIX)
}

/// A guard that is held while finished content is moved to its place. A program that a signal ends takes it first, so
/// that the move is whole.
pub fn moving() -> MutexGuard<'static, ()> {
    MOVING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Creates a folder with its missing parents, as [`fs::create_dir_all`] does, but not after [`remove_held`]: a thread
/// that still works would make a removed folder again.
///
/// # Errors
/// The errors of the file system.
pub fn create_folders(path: &Path) -> io::Result<()> {
    let _waits = Held::all();
    fs::create_dir_all(path)
}

/// Removes every [`Unfinished`] of this process. A program that a signal ends calls this, because values are not
/// dropped then. Afterwards a thread that begins, keeps or drops an [`Unfinished`], or calls [`create_folders`], waits
/// for the end of the process.
pub fn remove_held() {
    let all = Held::all();
    for folder in all.iter() {
        // Other threads may still write into it.
        for _ in 0..REMOVALS {
            let _ = fs::remove_dir_all(folder);
            if !folder.exists() {
                break;
            }
        }
    }
    std::mem::forget(all);
}

/// Removes the temporary folders that killed processes of this program left inside a folder. A folder without this
/// program's mark, a folder whose mark a process has locked, and the target of a symbolic link are never touched.
/// Entries that cannot be read or removed stay, without an error.
///
/// - `folder`: the folder to clean; its subfolders are not searched
/// - `age`: a temporary folder is removed only if nothing in it has changed for this long
pub fn remove_unfinished(folder: &Path, age: Duration) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        // The type of the entry itself: a symbolic link is no folder.
        if !is_unfinished(&entry.file_name()) || !entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            continue;
        }
        let path = entry.path();
        // Held until the folder is gone.
        let Mark::Abandoned(_mark) = Mark::open(&path.join(MARK)) else { continue };
        let newest = newest_change(&path).and_then(|time| SystemTime::now().duration_since(time).ok());
        if newest.is_some_and(|unchanged_for| unchanged_for >= age) {
            let _ = fs::remove_dir_all(&path);
        }
    }
}

/// The state of a folder by its mark.
enum Mark {
    /// The process ended. The mark is locked as long as the file is open.
    Abandoned(File),
    /// Another process writes into the folder.
    Locked,
    /// The folder is kept.
    Empty(File),
    /// The folder is not this program's, or the drive knows no locks.
    Unknown,
}

impl Mark {
    fn open(path: &Path) -> Self {
        // An exclusive lock of a network drive needs a file that may be written.
        let Ok(mut mark) = OpenOptions::new().read(true).write(true).open(path) else { return Self::Unknown };
        let mut text = Vec::new();
        let read = (&mut mark).take(MARK_TEXT.len() as u64 + 1).read_to_end(&mut text);
        if text.is_empty() && read.is_ok() {
            return Self::Empty(mark);
        }
        if read.is_err() || text != MARK_TEXT.as_bytes() {
            return Self::Unknown;
        }
        match mark.try_lock() {
            Ok(()) => Self::Abandoned(mark),
            Err(TryLockError::WouldBlock) => Self::Locked,
            Err(TryLockError::Error(_)) => Self::Unknown,
        }
    }
}

/// When anything in a folder last changed, the folder itself included; none if that cannot be read.
fn newest_change(path: &Path) -> Option<SystemTime> {
    let metadata = path.symlink_metadata().ok()?;
    let mut newest = metadata.modified().ok()?;
    if metadata.is_dir() {
        for entry in fs::read_dir(path).ok()? {
            newest = newest.max(newest_change(&entry.ok()?.path())?);
        }
    }
    Some(newest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    const DAY: Duration = Duration::from_secs(24 * 3600);

    /// A folder of a killed process, of a given age.
    #[cfg(unix)]
    fn abandoned(folder: &Path, age: Duration) -> PathBuf {
        let path = folder.join(format!("{PREFIX}{}", age.as_secs()));
        fs::create_dir_all(path.join("new/3")).unwrap();
        fs::write(path.join("new/3/000000.png"), b"half").unwrap();
        fs::write(path.join(MARK), MARK_TEXT).unwrap();
        set_age(&path, age);
        path
    }

    /// Sets the age of a folder and of all in it.
    #[cfg(unix)]
    fn set_age(path: &Path, age: Duration) {
        if path.is_dir() {
            fs::read_dir(path).unwrap().for_each(|entry| set_age(&entry.unwrap().path(), age));
        }
        File::open(path).unwrap().set_modified(SystemTime::now() - age).unwrap();
    }

    #[test]
    fn a_file_is_whole_or_not_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        let failing = |file: &mut File| {
            file.write_all(b"half")?;
            assert!(!path.exists());
            Err(io::Error::other("the disk is full"))
        };
        let error = write_whole(&path, Existing::Keep, failing).unwrap_err();
        assert_eq!(error.to_string(), "the disk is full");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
        write_whole(&path, Existing::Keep, |file| file.write_all(b"one")).unwrap();
        let error = write_whole(&path, Existing::Keep, |file| file.write_all(b"two")).unwrap_err();
        assert_eq!((error.kind(), fs::read(&path).unwrap()), (ErrorKind::AlreadyExists, b"one".to_vec()));
        write_whole(&path, Existing::Replace, |file| file.write_all(b"two")).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        assert!(write_whole(&folder.path().join("no/a"), Existing::Keep, |_| Ok(())).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn a_file_is_as_readable_as_any_other() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (usual, ours) = (folder.path().join("usual"), folder.path().join("ours"));
        fs::write(&usual, b"").unwrap();
        write_whole(&ours, Existing::Keep, |_| Ok(())).unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&usual));
    }

    // Elsewhere a folder's times cannot be set this way.
    #[cfg(unix)]
    #[test]
    fn only_what_is_old_ours_and_abandoned_is_removed() {
        let folder = tempfile::tempdir().unwrap();
        let in_folder = |name: &str| folder.path().join(name);
        let old = abandoned(folder.path(), 2 * DAY);
        let young = abandoned(folder.path(), DAY / 2);
        // Somebody else's: no mark, another text in it, or a mark where no folder of that name is.
        let unmarked = in_folder(".writing-unmarked");
        fs::create_dir(&unmarked).unwrap();
        let other = in_folder(".writing-other");
        fs::create_dir(&other).unwrap();
        fs::write(other.join(MARK), format!("{MARK_TEXT}And more.\n")).unwrap();
        let file = in_folder(".writing-file");
        fs::write(&file, MARK_TEXT).unwrap();
        let elsewhere = tempfile::tempdir().unwrap();
        let linked = abandoned(elsewhere.path(), 3 * DAY);
        let link = in_folder(".writing-link");
        std::os::unix::fs::symlink(&linked, &link).unwrap();
        let named_otherwise = in_folder("frames");
        fs::rename(abandoned(folder.path(), 4 * DAY), &named_otherwise).unwrap();
        // A process still writes into this one, though nothing has changed for long.
        let used = Unfinished::begin(folder.path()).unwrap();
        for path in [&unmarked, &other, &file, &named_otherwise, &used.path().to_owned()] {
            set_age(path, 5 * DAY);
        }
        // One that was touched since is not old, though its mark is.
        let touched = abandoned(folder.path(), 6 * DAY);
        fs::write(touched.join("new/3/000001.png"), b"later").unwrap();

        remove_unfinished(folder.path(), DAY);
        assert!(!old.exists());
        for path in [&young, &unmarked, &other, &file, &link, &linked, &named_otherwise, &touched] {
            assert!(path.exists(), "{}", path.display());
        }
        assert!(linked.join("new/3/000000.png").exists() && used.path().is_dir());
        remove_unfinished(folder.path(), Duration::ZERO);
        assert!(!young.exists() && !touched.exists() && used.path().is_dir() && unmarked.exists());
        remove_unfinished(&in_folder("no such folder"), DAY);
    }

    #[test]
    fn of_two_that_make_the_same_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let begin = || Unfinished::begin_alone(folder.path(), "frames".as_ref());
        let first = begin().unwrap();
        let refused = begin().err().map(|error| error.kind());
        if cfg!(windows) {
            return;
        }
        assert_eq!(
            (first.path().file_name().unwrap(), refused),
            (".writing-frames".as_ref(), Some(ErrorKind::WouldBlock))
        );
        let _other = Unfinished::begin_alone(folder.path(), "other".as_ref()).unwrap();
        drop(first);
        let names = || fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect::<Vec<_>>();
        assert_eq!(names(), [".writing-other"], "the loser left nothing");
        // The next process removes the folder of a killed one, and spares a kept one.
        let left = folder.path().join(".writing-frames");
        fs::create_dir(&left).unwrap();
        fs::write(left.join(MARK), MARK_TEXT).unwrap();
        fs::write(left.join("new"), b"half").unwrap();
        let again = begin().unwrap();
        assert!(again.path() == left && !left.join("new").exists());
        fs::write(left.join("new"), b"precious").unwrap();
        let kept = again.keep();
        assert_eq!(
            begin().err().map(|error| error.kind()),
            Some(ErrorKind::WouldBlock),
            "the first one is at it still"
        );
        drop(kept);
        let beside = begin().unwrap();
        assert!(beside.path() != left && fs::read(left.join("new")).unwrap() == b"precious");
    }

    #[test]
    fn what_is_kept_stays() {
        let folder = tempfile::tempdir().unwrap();
        let unfinished = Unfinished::begin(folder.path()).unwrap();
        fs::write(unfinished.path().join("new"), b"precious").unwrap();
        let kept = unfinished.keep().path().to_path_buf();
        remove_unfinished(folder.path(), Duration::ZERO);
        assert_eq!(fs::read(kept.join("new")).unwrap(), b"precious");
        assert_eq!(fs::read_dir(&kept).unwrap().count(), 1, "the mark is gone");
    }
}
