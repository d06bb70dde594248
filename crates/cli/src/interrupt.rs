//! Signals: Ctrl-C (SIGINT), SIGTERM, which ends services and batch jobs, and SIGHUP of a terminal that closes.
//!
//! A signal ends the process at once and removes unfinished files. A command that has to finish its step first calls
//! [`politely`]; a second signal then ends the process at once.

use std::ops::ControlFlow;
use std::process::Child;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use anyhow::Context;
use tcgs_interchange::{moving, remove_held};

use crate::terminal::note;

/// The exit code that shells report for SIGINT: 128 + 2.
pub const EXIT_CODE: u8 = 130;

static ASKED: AtomicBool = AtomicBool::new(false);
/// Whether the command checks for signals between its steps.
static IS_POLITE: AtomicBool = AtomicBool::new(false);

/// Process id of the child that signals are passed on to; 0 if there is none.
static STEP: AtomicU32 = AtomicU32::new(0);

/// Catches signals from this call on.
pub fn catch() -> anyhow::Result<()> {
    #[cfg(unix)]
    let is_detached = unix::prepare();
    let handler = || {
        let is_again = ASKED.swap(true, Ordering::SeqCst);
        // The children end here: a thread that waits for a hanging child could not end.
        tcgs_capture::end_programs();
        #[cfg(unix)]
        unix::terminate(STEP.load(Ordering::SeqCst));
        if is_again || !IS_POLITE.load(Ordering::SeqCst) {
            end();
        }
        note("ending cleanly; Ctrl-C again ends at once");
    };
    ctrlc::set_handler(handler).context("catching Ctrl-C")?;
    #[cfg(unix)]
    if is_detached {
        unix::ignore_hangup();
    }
    Ok(())
}

/// Removes unfinished files and ends the process.
fn end() -> ! {
    let _moved = moving();
    remove_held();
    note("tcgs: stopped");
    std::process::exit(i32::from(EXIT_CODE))
}

/// Runs work that calls [`asked`] between its steps: the first signal does not end the process.
pub fn politely<T>(work: impl FnOnce() -> T) -> T {
    be_polite(true);
    let done = work();
    be_polite(false);
    done
}

/// Sets whether the command calls [`asked`] between its steps, so that the first signal does not end the process.
pub fn be_polite(is_polite: bool) {
    IS_POLITE.store(is_polite, Ordering::SeqCst);
}

/// Sets the child that signals are passed on to, until the next call. A signal that came before ends it at once.
pub fn pass_on_to(child: Option<&Child>) {
    STEP.store(child.map_or(0, Child::id), Ordering::SeqCst);
    #[cfg(unix)]
    if ASKED.load(Ordering::SeqCst) {
        unix::terminate(STEP.load(Ordering::SeqCst));
    }
}

/// Whether to continue: `Break` after a signal.
pub fn asked() -> ControlFlow<()> {
    if ASKED.load(Ordering::SeqCst) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
}

#[cfg(unix)]
#[allow(unsafe_code)]
mod unix {
    /// Ignores SIGXFSZ, so that a write beyond `ulimit -f` fails like one on a full disk.
    ///
    /// - returns: whether SIGHUP is ignored, as by `nohup`
    pub fn prepare() -> bool {
        // SAFETY: neither action is a function.
        unsafe {
            libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
            libc::signal(libc::SIGHUP, libc::SIG_IGN) == libc::SIG_IGN
        }
    }

    /// Asks a process, if there is one, to end.
    pub fn terminate(process: u32) {
        if let Some(process) = i32::try_from(process).ok().filter(|&process| process > 0) {
            // SAFETY: the call takes only numbers.
            unsafe { libc::kill(process, libc::SIGTERM) };
        }
    }

    pub fn ignore_hangup() {
        // SAFETY: the action is not a function.
        unsafe { libc::signal(libc::SIGHUP, libc::SIG_IGN) };
    }
}
