//! Serves scenes to the player's page.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::thread;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use tcgs_serve::{FrameAncestors, NO_PAGE, PAGE, Server};

use crate::detached::detached;
use crate::errors::of_system;

/// Addresses of the scenes that are served, until this process ends.
static SERVED: Mutex<BTreeMap<PathBuf, String>> = Mutex::new(BTreeMap::new());

/// The address on this machine at which the player shows a .tcgs file. It is served until this process ends.
///
/// Raises RuntimeError if this package was built without the player.
#[pyfunction]
pub fn serve(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    if PAGE.is_empty() {
        return Err(PyRuntimeError::new_err(NO_PAGE));
    }
    detached(py, || address(&path))
}

fn address(path: &Path) -> PyResult<String> {
    let failed = |error: std::io::Error| of_system(error.kind(), format!("{}: {error}", path.display()));
    let path = path.canonicalize().map_err(failed)?;
    let mut served = SERVED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(address) = served.get(&path) {
        return Ok(address.clone());
    }
    let server = Server::bind(0, path.as_path(), PAGE).map_err(failed)?.framed_by(FrameAncestors::ThisMachine);
    let address = server.address().map_err(failed)?;
    thread::Builder::new().spawn(move || server.run(|_| {})).map_err(failed)?;
    served.insert(path, address.clone());
    Ok(address)
}
