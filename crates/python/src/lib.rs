//! The Python package `tcgs`: scenes as arrays of numpy, a differentiable rasterizer, and the functions of the command
//! line.
//!
//! What lives here: arguments, arrays and exceptions of Python. What does not: any method, which is in `tcgs-pipeline`
//! and below. Every call that computes releases the lock of the interpreter (GIL).

mod arrays;
mod backend;
mod camera;
mod capture;
mod compress;
mod detached;
mod errors;
mod evaluate;
mod floats;
mod gaussians;
mod memory;
mod numbers;
mod prepare;
mod rasterize;
mod save;
mod scene;
mod show;
mod train;
mod views;
mod watch;

use pyo3::pymodule;

/// The compiled part of the package `tcgs`, which re-exports it.
#[pymodule(name = "_tcgs")]
mod module {
    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::camera::PyCamera;
    #[pymodule_export]
    use crate::capture::{PyCapture, make_demo_capture};
    #[pymodule_export]
    use crate::compress::compress;
    #[pymodule_export]
    use crate::evaluate::{evaluate, render};
    #[pymodule_export]
    use crate::gaussians::PyGaussians;
    #[pymodule_export]
    use crate::prepare::prepare;
    #[pymodule_export]
    use crate::rasterize::{PyRasterizeGrads, PyRasterized, rasterize};
    #[pymodule_export]
    use crate::scene::{PyScene, open};
    #[pymodule_export]
    use crate::show::serve;
    #[pymodule_export]
    use crate::train::train;
    #[pymodule_export]
    use crate::watch::PyProgress;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        crate::detached::remember_process();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
