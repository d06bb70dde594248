//! The program `tcgs`, which runs every step of an experiment, and signals, which a running step gets first.
//!
//! The first signal (Ctrl-C, SIGTERM, SIGHUP) ends the running step, then this process; a second one ends this process
//! at once.

use std::env::consts::EXE_SUFFIX;
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus};
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use anyhow::Context;

use crate::error::{Stopped, wrong_input};

/// Exit code of a step, and of this process, that a signal ended.
pub const STOPPED: i32 = 130;

static ASKED: AtomicBool = AtomicBool::new(false);
/// Process id of the running step; 0 if there is none.
static STEP: AtomicU32 = AtomicU32::new(0);

/// The program.
#[derive(Clone, Debug)]
pub struct Program {
    /// Its file.
    pub path: PathBuf,
    /// Commit of its build; results name it.
    pub commit: String,
}

impl Program {
    /// Finds the program.
    ///
    /// - `path`: `None` for `tcgs` beside this program
    pub fn find(path: Option<PathBuf>) -> anyhow::Result<Self> {
        let beside = || Ok::<_, std::io::Error>(std::env::current_exe()?.with_file_name(format!("tcgs{EXE_SUFFIX}")));
        let path = path.map_or_else(beside, Ok)?;
        let output = Command::new(&path).arg("--version").output().map_err(|error| {
            wrong_input(format!("{}: {error}, expected tcgs, which `cargo build --release` makes", path.display()))
        })?;
        // Such as `tcgs 0.1.0 (0123456789)`.
        let version = String::from_utf8_lossy(&output.stdout);
        let commit = version.trim_end().strip_suffix(')').and_then(|version| version.rsplit_once('('));
        let commit = commit.map_or("unknown", |(_, commit)| commit).to_owned();
        Ok(Self { path, commit })
    }
}

/// Catches signals from this call on.
pub fn catch_signals() -> anyhow::Result<()> {
    // SAFETY: the action is not a function.
    #[cfg(unix)]
    #[allow(unsafe_code)]
    let is_detached = unsafe { libc::signal(libc::SIGHUP, libc::SIG_IGN) == libc::SIG_IGN };
    let handler = || {
        let step = STEP.load(Ordering::SeqCst);
        terminate(step);
        if ASKED.swap(true, Ordering::SeqCst) || step == 0 {
            tcgs_interchange::remove_held();
            eprintln!("lab: {Stopped}");
            std::process::exit(STOPPED);
        }
        eprintln!("ending cleanly; Ctrl-C again ends at once");
    };
    ctrlc::set_handler(handler).context("catching Ctrl-C")?;
    // Under `nohup` SIGHUP stays ignored.
    #[cfg(unix)]
    if is_detached {
        // SAFETY: as above.
        #[allow(unsafe_code)]
        unsafe {
            libc::signal(libc::SIGHUP, libc::SIG_IGN);
        }
    }
    Ok(())
}

/// Asks a process, if there is one, to end. Where this is not Unix, Ctrl-C reaches it by itself.
fn terminate(process: u32) {
    #[cfg(unix)]
    if let Some(process) = i32::try_from(process).ok().filter(|&process| process > 0) {
        // SAFETY: the call takes only numbers.
        #[allow(unsafe_code)]
        unsafe {
            libc::kill(process, libc::SIGTERM)
        };
    }
    #[cfg(not(unix))]
    let _ = process;
}

/// Runs a step to its end and passes signals on to it.
///
/// # Errors
/// [`Stopped`] after a signal; the errors of starting a process.
pub fn run(step: &mut Command) -> anyhow::Result<ExitStatus> {
    run_measured(step).map(|(status, _)| status)
}

/// The same, with the most memory that the process held, bytes; 0 where this is not Linux. Linux counts the most that
/// this process held before the start, too: the number is at least that.
pub fn run_measured(step: &mut Command) -> anyhow::Result<(ExitStatus, u64)> {
    if ASKED.load(Ordering::SeqCst) {
        return Err(Stopped.into());
    }
    // A process group of its own: Ctrl-C in a terminal then reaches only this process, which passes it on once.
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(step, 0);
    let mut child = step.spawn().with_context(|| format!("starting {}", step.get_program().display()))?;
    STEP.store(child.id(), Ordering::SeqCst);
    let status = wait(&mut child);
    STEP.store(0, Ordering::SeqCst);
    let (status, memory) = status?;
    let was_stopped = status.code() == Some(STOPPED) || !status.success() && ASKED.load(Ordering::SeqCst);
    if was_stopped { Err(Stopped.into()) } else { Ok((status, memory)) }
}

/// Waits for the end of a process, and gives the most memory that it held, bytes.
#[cfg(target_os = "linux")]
fn wait(child: &mut Child) -> std::io::Result<(ExitStatus, u64)> {
    let mut status = 0;
    // SAFETY: all zeros are such numbers.
    #[allow(unsafe_code)]
    let mut usage: libc::rusage = unsafe { std::mem::zeroed() };
    loop {
        // SAFETY: both places live on.
        #[allow(unsafe_code)]
        let ended = unsafe { libc::wait4(child.id().cast_signed(), &raw mut status, 0, &raw mut usage) };
        if ended > 0 {
            let status = std::os::unix::process::ExitStatusExt::from_raw(status);
            return Ok((status, 1024 * usage.ru_maxrss.unsigned_abs()));
        }
        let error = std::io::Error::last_os_error();
        if error.kind() != std::io::ErrorKind::Interrupted {
            return Err(error);
        }
    }
}

#[cfg(not(target_os = "linux"))]
fn wait(child: &mut Child) -> std::io::Result<(ExitStatus, u64)> {
    Ok((child.wait()?, 0))
}
