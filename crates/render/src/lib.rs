//! Differentiable Gaussian rasterization.
//!
//! What lives here: everything between activated Gaussians and pixels, forward and backward. What
//! does not: activation, losses, files. The constants that decide what is visible stand once, in
//! [`settings`]; every implementation and the oracle in the tests read them there.

mod cpu;
pub mod device;
pub mod gpu;
mod rasterizer;
pub mod settings;
mod stage_times;
mod tiling;

pub use cpu::project::{Pinhole, Projection, project, project_vjp};
pub use cpu::{CpuRasterizer, CpuSaved};
pub use rasterizer::{Draw, Rasterizer, RenderGrads, RenderOutput, RenderSettings};
pub use stage_times::{Laps, PairCounts, RENDER_STAGES, StageTimes};
pub use tiling::{TILE, tile_grid};
