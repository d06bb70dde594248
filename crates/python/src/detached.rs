//! Computing without the lock of the interpreter, also in a process that was forked.

use std::process;
use std::sync::{Arc, Mutex, PoisonError};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// The process that imported the package.
static IMPORTER: Mutex<Option<u32>> = Mutex::new(None);
/// Threads of a forked process, and its process id. A fork has none of its parent's threads, so waiting for them would
/// never end.
static FORKED: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);

/// To be called when the package is imported.
pub fn remember_process() {
    IMPORTER.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert_with(process::id);
}

/// Whether this process was forked after the package was imported.
fn is_forked() -> bool {
    IMPORTER.lock().unwrap_or_else(PoisonError::into_inner).is_some_and(|importer| importer != process::id())
}

/// Calls `compute` without the lock of the interpreter, with threads that this process has.
pub fn detached<T: Send>(py: Python<'_>, compute: impl FnOnce() -> T + Send) -> T {
    py.detach(|| if is_forked() { own_threads().install(compute) } else { compute() })
}

fn own_threads() -> Arc<ThreadPool> {
    let mut forked = FORKED.lock().unwrap_or_else(PoisonError::into_inner);
    match &*forked {
        Some((process, threads)) if *process == process::id() => Arc::clone(threads),
        _ => {
            let threads = Arc::new(ThreadPoolBuilder::new().build().expect("a process that may start threads"));
            // The parent's threads are not dropped, because that would wait for them.
            std::mem::forget(forked.replace((process::id(), Arc::clone(&threads))));
            threads
        }
    }
}

/// Refuses calls whose loaders have threads of their own in a process that was forked.
///
/// # Errors
/// `RuntimeError` in such a process.
pub fn refuse_fork() -> PyResult<()> {
    if !is_forked() {
        return Ok(());
    }
    let expected = "expected a process of multiprocessing's start method spawn or forkserver";
    Err(PyRuntimeError::new_err(format!("found a process that was forked, {expected}")))
}
