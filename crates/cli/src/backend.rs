//! The choice of backend, CPU or GPU, by `--backend` and `--device`.

use std::ffi::OsString;

use anyhow::anyhow;
use clap::{Args, ValueEnum};
use tcgs_pipeline::{Backend, PipelineError};
use tcgs_render::device::GpuError;

use crate::error::wrong_input;
use crate::terminal::note;

/// Options of every command that trains or renders.
#[derive(Args, Debug)]
pub struct BackendOptions {
    /// Compute on the CPU or a GPU [default: auto; with --device: gpu]
    #[arg(long)]
    backend: Option<BackendName>,
    /// GPU to compute on, by a part of its name; the only way to use a software GPU
    #[arg(long, value_name = "NAME")]
    device: Option<String>,
}

/// Values of `--backend`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BackendName {
    /// The GPU if there is one, else the CPU
    Auto,
    /// A GPU
    Gpu,
    /// The CPU
    Cpu,
}

impl BackendOptions {
    /// These options as words of a command line.
    pub fn words(&self) -> Vec<OsString> {
        let backend = self.backend.and_then(|name| Some(name.to_possible_value()?.get_name().to_owned()));
        let options = [("--backend", backend), ("--device", self.device.clone())];
        options.into_iter().filter_map(|(name, value)| Some([name.into(), value?.into()])).flatten().collect()
    }

    /// Opens the requested backend and prints its name on standard error. Call it after setting the number of threads.
    ///
    /// - `default`: used where the command line names no backend
    pub fn open(&self, default: BackendName) -> anyhow::Result<Backend> {
        if let Some(device) = &self.device {
            if self.backend == Some(BackendName::Cpu) {
                let problem = "is a GPU's name, found --backend cpu, expected one without the other";
                return Err(wrong_input(format!("--device {device}: {problem}")));
            }
            return Backend::open_gpu(Some(device)).map(on_gpu).map_err(|error| {
                let message = format!("--device {device}: {error}");
                match error {
                    PipelineError::Gpu(GpuError::NotFound { .. }) | PipelineError::NotBuilt { .. } => {
                        wrong_input(message)
                    }
                    _ => anyhow!(message),
                }
            });
        }
        match self.backend.unwrap_or(default) {
            BackendName::Cpu => Ok(on_cpu("")),
            BackendName::Gpu => Backend::open_gpu(None).map(on_gpu).map_err(|error| match error {
                PipelineError::NotBuilt { .. } => wrong_input(format!("--backend gpu: {error}, or --backend cpu")),
                _ => anyhow!("--backend gpu: {error}, expected --device NAME or --backend cpu"),
            }),
            BackendName::Auto => Ok(Backend::open_gpu(None).map_or_else(|error| on_cpu(&format!(": {error}")), on_gpu)),
        }
    }
}

fn on_cpu(why: &str) -> Backend {
    keep_freed_memory();
    note(&format!("computing on the CPU, {} threads{why}", rayon::current_num_threads()));
    Backend::Cpu
}

/// Lets the C library keep up to 1 GiB of freed memory for the next allocation. Every iteration on the CPU allocates
/// and frees about 100 MB. Returning them to the system each time costs 30,000 page faults, a fifth of an iteration.
/// Only glibc returns memory so soon.
fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        use std::ffi::c_int;
        // From malloc.h.
        const M_TRIM_THRESHOLD: c_int = -1;
        const M_MMAP_THRESHOLD: c_int = -3;
        unsafe extern "C" {
            fn mallopt(parameter: c_int, value: c_int) -> c_int;
        }
        // SAFETY: mallopt takes the allocator's lock, and both values are legal. If it refuses one, glibc keeps its
        // default.
        #[allow(unsafe_code)]
        unsafe {
            mallopt(M_TRIM_THRESHOLD, 1 << 30);
            mallopt(M_MMAP_THRESHOLD, 1 << 29);
        }
    }
}

fn on_gpu(backend: Backend) -> Backend {
    if let Some(info) = backend.gpu_info() {
        note(&format!("computing on {} ({})", info.name, info.backend));
    }
    backend
}
