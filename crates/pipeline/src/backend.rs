//! What computes: the CPU or a GPU.

use tcgs_render::gpu::{Gpu, GpuRasterizer};
use tcgs_render::{CpuRasterizer, Draw};
use tcgs_train::State;
use tcgs_train::engine::Engine;
use tcgs_train::engine::cpu::CpuEngine;
use tcgs_train::engine::gpu::GpuEngine;

/// What trains and draws.
///
/// ```
/// use tcgs_pipeline::Backend;
/// let renderer = Backend::Cpu.renderer();
/// assert!(renderer.name().starts_with("cpu"));
/// ```
#[derive(Debug)]
pub enum Backend {
    /// All threads of rayon's global pool.
    Cpu,
    /// An open GPU.
    Gpu(Gpu),
}

impl Backend {
    /// An engine that trains from `state` on.
    pub fn engine(&self, state: State) -> Box<dyn Engine> {
        match self {
            Self::Cpu => Box::new(CpuEngine::new(state)),
            Self::Gpu(gpu) => Box::new(GpuEngine::new(gpu, state)),
        }
    }

    /// A renderer of images without gradients.
    pub fn renderer(&self) -> Box<dyn Draw> {
        match self {
            Self::Cpu => Box::new(CpuRasterizer),
            Self::Gpu(gpu) => Box::new(GpuRasterizer::new(gpu)),
        }
    }
}
