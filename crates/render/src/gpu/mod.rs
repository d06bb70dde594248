//! The GPU renderer: what [`crate::device`] describes, run through `wgpu`.

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
