//! Processes of `ffmpeg` and `ffprobe`, which decode videos.
//!
//! What lives here: starting them, and ending them when [`Program`] is dropped or by [`end_programs`]. What does not:
//! their arguments.

use std::io::{self, Read};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::Duration;

/// The running processes.
static RUNNING: Mutex<Running> = Mutex::new(Running { children: Vec::new(), is_ended: false });

/// Maximum size of a program's error output that is kept, bytes.
const MAX_COMPLAINT_BYTES: u64 = 1 << 16;

struct Running {
    children: Vec<Arc<Mutex<Child>>>,
    /// Whether no further program may start.
    is_ended: bool,
}

/// Ends every `ffmpeg` and `ffprobe` of this process, and refuses to start more. Reading a video through them then
/// returns an error. Call it when the process is asked to end: a hanging program blocks its reader.
pub fn end_programs() {
    let mut running = lock(&RUNNING);
    running.is_ended = true;
    for child in &running.children {
        // The process may have ended by itself.
        let _ = lock(child).kill();
    }
}

fn lock<T>(of: &Mutex<T>) -> MutexGuard<'_, T> {
    of.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A running process; dropping it ends the process. Its lock is never held for long.
#[derive(Debug)]
pub(super) struct Program(Arc<Mutex<Child>>);

impl Program {
    /// - returns: the process, and the pipe of its output
    pub fn start(command: &mut Command) -> io::Result<(Self, ChildStdout)> {
        let mut running = lock(&RUNNING);
        if running.is_ended {
            return Err(io::Error::other("stopped"));
        }
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn()?;
        let stdout = child.stdout.take().ok_or_else(|| io::Error::other("has no output"))?;
        let child = Arc::new(Mutex::new(child));
        running.children.push(Arc::clone(&child));
        Ok((Self(child), stdout))
    }

    /// Runs a program to its end.
    ///
    /// - `max_bytes`: most bytes that it may write
    /// - returns: whether it succeeded, its output, and its error output
    pub fn output(command: &mut Command, max_bytes: u64) -> io::Result<(bool, Vec<u8>, Vec<u8>)> {
        let (program, stdout) = Self::start(command.stderr(Stdio::piped()))?;
        let stderr = lock(&program.0).stderr.take();
        let complaints = thread::spawn(move || {
            let mut said = Vec::new();
            if let Some(mut stderr) = stderr {
                // A full pipe would stop the program: the rest is read and dropped.
                let _ = (&mut stderr).take(MAX_COMPLAINT_BYTES).read_to_end(&mut said);
                let _ = io::copy(&mut stderr, &mut io::sink());
            }
            said
        });
        let mut written = Vec::new();
        stdout.take(max_bytes + 1).read_to_end(&mut written)?;
        if written.len() as u64 > max_bytes {
            return Err(io::Error::other(format!("wrote more than {max_bytes} bytes")));
        }
        let status = loop {
            if let Some(status) = lock(&program.0).try_wait()? {
                break status;
            }
            thread::sleep(Duration::from_millis(2));
        };
        Ok((status.success(), written, complaints.join().unwrap_or_default()))
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        lock(&RUNNING).children.retain(|child| !Arc::ptr_eq(child, &self.0));
        let mut child = lock(&self.0);
        let _ = child.kill();
        let _ = child.wait();
    }
}
