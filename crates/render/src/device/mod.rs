//! The device renderer's parts that need no device interface: memory layout of Gaussians, buffer sizes, uniforms,
//! dispatch sizes, and shader sources. Module `gpu` runs it through `wgpu`; another device would start here.

mod activated;
mod dispatch;
mod gpu_error;
mod radix;
mod renderer;
mod wgsl;

pub use activated::{ACTIVATED_VALUES, activated_len, pack};
pub use dispatch::{MAX_GROUPS_X, MAX_THREADS, WORKGROUP, groups_in_rows, groups_over};
pub use gpu_error::{GpuError, GpuInfo};
pub use radix::{FEW_BLOCKS, MAX_KEYS, NUM_DIGITS, SORT_BLOCK, SortUniform, sort_passes, sort_source};
pub use renderer::{BUCKET, Capacity, Coverage, RenderSources, VISIBLE, ViewPart, ViewUniform, sources};
pub use wgsl::{Wgsl, WgslValue};
