//! The GPU renderer: runs [`crate::device`] through `wgpu`.
//!
//! Programs need [`Gpu`], [`GpuChoice`] and [`GpuRasterizer`]; none of them has a type of `wgpu` in its documented
//! interface.

mod device;
mod kernel;
mod open;
mod profiler;
mod radix;
mod rasterizer;
#[doc(hidden)]
pub mod raw;
mod renderer;
mod timing;

pub use crate::device::{GpuError, GpuInfo};
pub use device::Gpu;
pub use open::GpuChoice;
pub use profiler::RenderProfiler;
pub use rasterizer::{GpuRasterizer, GpuSaved};
