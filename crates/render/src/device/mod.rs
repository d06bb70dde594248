//! The renderer on a device, as far as no device's interface is needed: how Gaussians lie in memory, how large buffers
//! are, what uniforms hold, how a dispatch is cut, the text of the shaders. Module `gpu` runs it through `wgpu`; another
//! device would start here.

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
