//! The GPU renderer: what [`crate::device`] describes, run through `wgpu`.
//!
//! Programs need [`Gpu`], [`GpuChoice`] and [`GpuRasterizer`]. The other items are for crates that run shaders of their
//! own between the renderer's, on the same buffers (training, the player); their signatures have types of `wgpu`, so a new
//! version of `wgpu` is a breaking change of these items.

mod device;
mod kernel;
mod open;
mod profiler;
mod radix;
mod rasterizer;
mod renderer;
mod timing;

pub use crate::device::{GpuError, GpuInfo};
pub use device::{Gpu, Staged};
pub use kernel::{Bound, Kernel};
pub use open::GpuChoice;
pub use profiler::RenderProfiler;
pub use rasterizer::{GpuRasterizer, GpuSaved};
pub use renderer::{GpuRenderer, RenderBuffers};
pub use timing::StageTimer;
