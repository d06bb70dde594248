//! The folder that a run is written to: what is in it, and what may be done with that.

use std::fs::{self, File};
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use tcgs_pipeline::Backend;
use tcgs_train::{Run, TrainError, Trainer};

use crate::error::wrong_input;
use crate::output::{is_leftover, note};

/// What commands write into a run folder.
const OURS: [&str; 3] = ["scene.tcgs", "metrics.jsonl", "config.toml"];

/// What is there.
pub enum Found {
    /// Nothing of worth.
    Nothing,
    /// A run.
    Run,
}

/// Looks at the place of a run.
pub fn look(folder: &Path) -> anyhow::Result<Found> {
    // Other programs have a config.toml, too.
    if Run::is_run(folder) && (folder.join("checkpoints").is_dir() || Run::open(folder).is_ok()) {
        return Ok(Found::Run);
    }
    if !folder.exists() {
        return Ok(Found::Nothing);
    }
    if !folder.is_dir() {
        return Err(wrong_input(format!("{}: is a file, expected the name of a folder", folder.display())));
    }
    // A run stopped before its first file is no more than an empty folder or two.
    let is_empty = |entry: &fs::DirEntry| {
        let name = entry.file_name();
        is_leftover(&name)
            || name == "checkpoints" && fs::read_dir(entry.path()).is_ok_and(|mut inside| inside.next().is_none())
    };
    for entry in fs::read_dir(folder).with_context(|| format!("reading {}", folder.display()))? {
        if !is_empty(&entry?) {
            let problem = "a folder with other things in it, expected a run, an empty folder or a new name";
            return Err(wrong_input(format!("{}: {problem}", folder.display())));
        }
    }
    Ok(Found::Nothing)
}

/// A run is written by one process at a time.
pub struct Lock {
    _folder: Option<File>,
}

/// Locks a run folder until dropped.
pub fn lock(folder: &Path) -> anyhow::Result<Lock> {
    // Elsewhere a folder cannot be opened like a file.
    if cfg!(not(unix)) {
        return Ok(Lock { _folder: None });
    }
    let file = File::open(folder).with_context(|| format!("opening {}", folder.display()))?;
    match file.try_lock() {
        Err(fs::TryLockError::WouldBlock) => {
            let problem = "another process is training into it, expected that to end first";
            Err(wrong_input(format!("{}: {problem}", folder.display())))
        }
        // Some network drives know no locks.
        _ => Ok(Lock { _folder: Some(file) }),
    }
}

/// Makes a run's folder and locks it.
pub fn lock_new(folder: &Path) -> anyhow::Result<Lock> {
    fs::create_dir_all(folder).with_context(|| format!("creating {}", folder.display()))?;
    lock(folder)
}

/// Removes what a run wrote, and nothing else. Stopped half-way it leaves a run that is shorter.
pub fn clear(folder: &Path) -> anyhow::Result<()> {
    let context = || format!("replacing {}", folder.display());
    remove_leftovers(folder)?;
    let checkpoints = folder.join("checkpoints");
    if checkpoints.is_dir() {
        let mut paths = Vec::new();
        for entry in fs::read_dir(&checkpoints).with_context(context)? {
            paths.push(entry.with_context(context)?.path());
        }
        paths.sort();
        for path in paths.iter().rev().filter(|path| is_checkpoint(path)) {
            fs::remove_file(path).with_context(context)?;
        }
    }
    for name in OURS {
        match fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => return Err(error).with_context(context),
            _ => {}
        }
    }
    Ok(())
}

/// Whether a file of the folder `checkpoints` is one, whole or damaged.
fn is_checkpoint(path: &Path) -> bool {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let name = name.strip_suffix(DAMAGED).unwrap_or(&name);
    name.strip_suffix(".npz").is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
}

/// Removes what a stopped process was about to rename. Nobody else writes here: the folder is locked.
pub fn remove_leftovers(folder: &Path) -> anyhow::Result<()> {
    for folder in [folder.into(), folder.join("checkpoints")] {
        tcgs_interchange::remove_unfinished(&folder, Duration::ZERO);
        let Ok(entries) = fs::read_dir(&folder) else { continue };
        for entry in entries.flatten() {
            // Earlier versions wrote files of such names.
            if is_leftover(&entry.file_name()) && entry.path().is_file() {
                fs::remove_file(entry.path()).with_context(|| format!("removing {}", entry.path().display()))?;
            }
        }
    }
    Ok(())
}

const DAMAGED: &str = ".damaged";

/// The state after the last whole checkpoint. Damaged ones at the end are set aside.
pub fn resume(run: &Run, backend: &Backend) -> anyhow::Result<Option<Trainer>> {
    loop {
        let error = match run.resume_with(|state| backend.engine(state)) {
            Ok(trainer) => return Ok(trainer),
            Err(error) => error,
        };
        let last = run.folder().join("checkpoints").join(format!("{:06}.npz", run.timesteps().saturating_sub(1)));
        match error {
            TrainError::File { path, problem } if path == last => {
                let mut aside = path.clone().into_os_string();
                aside.push(DAMAGED);
                fs::rename(&path, &aside).with_context(|| format!("renaming {}", path.display()))?;
                note(&format!("{}: {problem}; set aside, its timestep is trained again", path.display()));
            }
            other => return Err(other.into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_runs_and_empty_folders_are_written_to() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("run");
        assert!(matches!(look(&folder), Ok(Found::Nothing)));
        fs::create_dir_all(folder.join("checkpoints")).unwrap();
        fs::write(folder.join(".writing-abc"), b"").unwrap();
        assert!(matches!(look(&folder), Ok(Found::Nothing)));
        fs::write(folder.join("config.toml"), b"").unwrap();
        assert!(matches!(look(&folder), Ok(Found::Run)));
        fs::write(folder.join("config.toml"), b"baseURL = 'https://example.org'").unwrap();
        fs::remove_dir(folder.join("checkpoints")).unwrap();
        assert!(look(&folder).err().unwrap().to_string().contains("other things"));
        fs::rename(folder.join("config.toml"), folder.join("thesis.txt")).unwrap();
        assert!(look(&folder).err().unwrap().to_string().contains("other things"));
        assert!(look(&folder.join("thesis.txt")).err().unwrap().to_string().contains("is a file"));
    }

    #[test]
    fn clearing_spares_what_a_run_did_not_write() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("checkpoints")).unwrap();
        let ours = ["config.toml", "metrics.jsonl", "scene.tcgs", "checkpoints/000000.npz", ".writing-1"];
        let theirs = ["notes.txt", "checkpoints/best.npz.txt"];
        for name in ours.iter().chain(&theirs) {
            fs::write(path(name), b"x").unwrap();
        }
        clear(folder.path()).unwrap();
        assert!(ours.iter().all(|name| !path(name).exists()));
        assert!(theirs.iter().all(|name| path(name).exists()));
    }

    #[cfg(unix)]
    #[test]
    fn a_run_has_one_writer() {
        let folder = tempfile::tempdir().unwrap();
        let first = lock(folder.path()).unwrap();
        assert!(lock(folder.path()).err().unwrap().to_string().contains("another process"));
        drop(first);
        lock(folder.path()).unwrap();
    }
}
