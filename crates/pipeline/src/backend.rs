//! The device that computes: the CPU or a GPU.

use tcgs_render::device::GpuInfo;
use tcgs_render::{CpuRasterizer, DrawAny, draw_any};
use tcgs_train::State;
use tcgs_train::engine::Engine;
use tcgs_train::engine::cpu::CpuEngine;

use crate::PipelineError;

/// The device that trains and draws.
///
/// ```
/// use tcgs_pipeline::Backend;
/// let renderer = Backend::Cpu.renderer();
/// assert!(renderer.name().starts_with("cpu"));
/// ```
#[derive(Debug)]
#[non_exhaustive]
pub enum Backend {
    /// All threads of rayon's global pool.
    Cpu,
    /// An open GPU.
    #[cfg(feature = "gpu")]
    Gpu(tcgs_render::gpu::Gpu),
}

impl Backend {
    /// Opens a GPU.
    ///
    /// - `name`: a part of its name, in any case, which also finds software that acts as a GPU; `None` for the first
    ///   GPU in hardware
    ///
    /// # Errors
    /// [`PipelineError::Gpu`] if there is none, or none that can compute; [`PipelineError::NotBuilt`] without feature
    /// `gpu`.
    pub fn open_gpu(name: Option<&str>) -> Result<Self, PipelineError> {
        #[cfg(feature = "gpu")]
        {
            use tcgs_render::gpu::{Gpu, GpuChoice};
            Ok(Self::Gpu(Gpu::open(name.map_or(GpuChoice::Hardware, GpuChoice::Named))?))
        }
        #[cfg(not(feature = "gpu"))]
        {
            let _ = name;
            Err(PipelineError::NotBuilt { what: "GPUs", feature: "gpu" })
        }
    }

    /// The GPU's description of itself; `None` on the CPU.
    pub fn gpu_info(&self) -> Option<&GpuInfo> {
        match self {
            Self::Cpu => None,
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) => Some(gpu.info()),
        }
    }

    /// An engine that trains from `state` on.
    pub fn engine(&self, state: State) -> Box<dyn Engine> {
        match self {
            Self::Cpu => Box::new(CpuEngine::new(state)),
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) => Box::new(tcgs_train::engine::gpu::GpuEngine::new(gpu, state)),
        }
    }

    /// A renderer of images without gradients.
    pub fn renderer(&self) -> Box<DrawAny> {
        match self {
            Self::Cpu => draw_any(CpuRasterizer),
            #[cfg(feature = "gpu")]
            Self::Gpu(gpu) => draw_any(tcgs_render::gpu::GpuRasterizer::new(gpu)),
        }
    }
}
