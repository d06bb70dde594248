//! Ctrl-C: the first asks the work to end cleanly, the second ends the process at once.

use std::io::ErrorKind;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use anyhow::Context;

use crate::terminal::note;

/// As a shell reports a process that SIGINT ended: 128 + 2.
pub const EXIT_CODE: u8 = 130;

/// Tries to remove a folder; each fails only if a file appears meanwhile; a disk without room or rights fails at once.
const REMOVALS: usize = 100;

static ASKED: AtomicBool = AtomicBool::new(false);
/// What the first Ctrl-C removes.
static UNFINISHED: Mutex<Option<PathBuf>> = Mutex::new(None);

/// Catches Ctrl-C (SIGINT) from now on, for commands that ask [`asked`] between steps. Without this Ctrl-C ends the process
/// at once.
pub fn catch() -> anyhow::Result<()> {
    let handler = || {
        // Whoever waits for a program that hangs could not end.
        tcgs_capture::end_programs();
        if let Some(unfinished) = &*UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner) {
            remove(unfinished);
            std::process::exit(i32::from(EXIT_CODE));
        }
        if ASKED.swap(true, Ordering::SeqCst) {
            std::process::exit(i32::from(EXIT_CODE));
        }
        note("ending cleanly; Ctrl-C again ends at once");
    };
    ctrlc::set_handler(handler).context("catching Ctrl-C")
}

/// Removes a folder into which the work, which has not been told to stop, may still write: what appears while the folder is
/// being emptied is removed by another try. What cannot be removed has a mark by which a later command removes it.
fn remove(folder: &Path) {
    for _ in 0..REMOVALS {
        match std::fs::remove_dir_all(folder) {
            Err(error) if error.kind() == ErrorKind::DirectoryNotEmpty => {}
            _ => return,
        }
    }
}

/// After [`catch`], for commands with one long step: from now on the first Ctrl-C removes a folder and ends the process.
///
/// - `unfinished`: holds nothing yet, or what nobody needs
///
/// # Errors
/// If Ctrl-C came before; the folder is then the caller's to remove.
pub fn remove_at_end(unfinished: &Path) -> anyhow::Result<()> {
    *UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner) = Some(unfinished.into());
    check()
}

/// Takes back [`remove_at_end`], before what is finished is moved to its place. Where Ctrl-C is removing it already, this waits for
/// the end of the process.
pub fn keep() {
    *UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner) = None;
}

/// An error after Ctrl-C.
pub fn check() -> anyhow::Result<()> {
    if asked().is_break() { Err(tcgs_pipeline::PipelineError::Stopped.into()) } else { Ok(()) }
}

/// Whether to go on.
pub fn asked() -> ControlFlow<()> {
    if ASKED.load(Ordering::SeqCst) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}
