//! What computes: the CPU or a GPU, as `--backend` and `--device` say.

use anyhow::{Context, anyhow};
use clap::{Args, ValueEnum};
use tcgs_render::gpu::{Gpu, GpuChoice, GpuError};
use tcgs_render::{CpuRasterizer, Draw};
use tcgs_train::engine::Engine;
use tcgs_train::engine::cpu::CpuEngine;
use tcgs_train::{State, TrainError};

use crate::error::wrong_input;
use crate::output::note;

/// What every command takes that trains or renders.
#[derive(Args, Debug)]
pub struct BackendOptions {
    /// What computes [default: auto; with --device: gpu]
    #[arg(long)]
    backend: Option<BackendName>,
    /// GPU to compute on, by a part of its name; software that acts as one is used only so
    #[arg(long, value_name = "NAME")]
    device: Option<String>,
}

/// As on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BackendName {
    /// The GPU if there is one, else the CPU
    Auto,
    /// A GPU
    Gpu,
    /// The CPU
    Cpu,
}

/// What computes.
#[derive(Debug)]
pub enum Backend {
    /// All threads of the pool.
    Cpu,
    /// An open GPU.
    Gpu(Gpu),
}

impl BackendOptions {
    /// Finds what is asked for, and says on standard error what it is. To be called once the number of
    /// threads is set.
    ///
    /// - `default`: where the command line says nothing
    pub fn open(&self, default: BackendName) -> anyhow::Result<Backend> {
        let found = match (&self.device, self.backend.unwrap_or(default)) {
            (Some(device), _) if self.backend == Some(BackendName::Cpu) => {
                let problem = "is a GPU's name, found --backend cpu, expected one without the other";
                return Err(wrong_input(format!("--device {device}: {problem}")));
            }
            (Some(device), _) => match Gpu::open(GpuChoice::Named(device)) {
                Err(error @ GpuError::NotFound { .. }) => {
                    return Err(wrong_input(format!("--device {device}: {error}")));
                }
                other => Ok(other.with_context(|| format!("--device {device}"))?),
            },
            (None, BackendName::Cpu) => Err(None),
            (None, BackendName::Gpu) => Ok(Gpu::open(GpuChoice::Hardware)
                .map_err(|error| anyhow!("--backend gpu: {error}, expected --device NAME or --backend cpu"))?),
            (None, BackendName::Auto) => Gpu::open(GpuChoice::Hardware).map_err(Some),
        };
        Ok(match found {
            Ok(gpu) => {
                note(&format!("computing on {} ({})", gpu.info().name, gpu.info().backend));
                Backend::Gpu(gpu)
            }
            Err(why) => {
                let why = why.map(|error| format!(": {error}")).unwrap_or_default();
                note(&format!("computing on the CPU, {} threads{why}", rayon::current_num_threads()));
                Backend::Cpu
            }
        })
    }
}

impl Backend {
    /// What trains from `state` on.
    pub fn engine(&self, state: State) -> Result<Box<dyn Engine>, TrainError> {
        match self {
            Self::Cpu => Ok(Box::new(CpuEngine::new(state))),
            Self::Gpu(gpu) => Err(no_engine(gpu).into()),
        }
    }

    /// What draws pictures.
    pub fn renderer(&self) -> Result<Box<dyn Draw>, GpuError> {
        match self {
            Self::Cpu => Ok(Box::new(CpuRasterizer)),
            Self::Gpu(gpu) => Err(no_engine(gpu)),
        }
    }
}

fn no_engine(gpu: &Gpu) -> GpuError {
    let problem = "cannot be used: this build has no GPU engine yet, expected --backend cpu";
    GpuError::Unfit { name: gpu.info().name.clone(), problem: problem.into() }
}
