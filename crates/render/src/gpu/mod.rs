//! The GPU renderer: WGSL compute shaders through `wgpu`, each operation a `.rs` beside its `.wgsl`.

mod device;
mod kernel;
mod open;
mod profiler;
mod radix;
mod rasterizer;
mod renderer;
mod source;
mod timing;

pub use device::{Gpu, GpuError, GpuInfo, Staged};
pub use kernel::{Bound, Kernel, MAX_GROUPS_X, MAX_THREADS, WORKGROUP};
pub use open::GpuChoice;
pub use profiler::RenderProfiler;
pub use radix::{Dispatch, Radix, SORT_BLOCK};
pub use rasterizer::{GpuRasterizer, GpuSaved};
pub use renderer::{Capacity, GpuRenderer, RenderBuffers};
pub use source::{BUCKET, sources};
pub use timing::StageTimer;
