//! The GPU renderer: WGSL compute shaders through `wgpu`, each operation a `.rs` beside its `.wgsl`.

mod device;
mod kernel;
mod source;

pub use device::{Gpu, GpuChoice, GpuError, GpuInfo, Staged};
pub use kernel::{Bound, Kernel, MAX_GROUPS_X, WORKGROUP};
pub use source::{BUCKET, TILE, source};
