//! Backends (GPU or CPU), each opened once in a process.

use std::sync::{Arc, Mutex, PoisonError};

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tcgs_pipeline::{Backend, PipelineError};

use crate::detached::detached;
use crate::errors::exception;

type Name = (String, Option<String>);

/// The open backends, by name.
static OPEN: Mutex<Vec<(Name, Arc<Backend>)>> = Mutex::new(Vec::new());

/// The backend of a name.
///
/// - `name`: `auto` is the GPU if there is one, else the CPU; `gpu`, `cpu`
/// - `device`: a part of a GPU's name
///
/// # Errors
/// `ValueError` for another name, `RuntimeError` if there is no such GPU.
pub fn backend(py: Python<'_>, name: &str, device: Option<&str>) -> PyResult<Arc<Backend>> {
    if !["auto", "gpu", "cpu"].contains(&name) {
        return Err(PyValueError::new_err(format!("backend: is {name}, expected auto, gpu or cpu")));
    }
    if name == "cpu" && device.is_some() {
        return Err(PyValueError::new_err(
            "device: is a GPU's name, found backend cpu, expected one without the other",
        ));
    }
    detached(py, || {
        let mut open = OPEN.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (name.to_owned(), device.map(str::to_owned));
        if let Some((_, backend)) = open.iter().find(|(known, _)| *known == key) {
            return Ok(Arc::clone(backend));
        }
        let backend = Arc::new(open_new(name, device)?);
        open.push((key, Arc::clone(&backend)));
        Ok(backend)
    })
    .map_err(|error: PipelineError| exception(error))
}

fn open_new(name: &str, device: Option<&str>) -> Result<Backend, PipelineError> {
    match (name, device) {
        ("cpu", _) => Ok(Backend::Cpu),
        ("auto", None) => Ok(Backend::open_gpu(None).unwrap_or(Backend::Cpu)),
        _ => Backend::open_gpu(device),
    }
}
