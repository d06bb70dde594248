//! Differentiable Gaussian rasterization.
//!
//! What lives here: everything between activated Gaussians and pixels, forward and backward. What does not: activation,
//! losses, files. The constants that decide visibility are defined once, in [`settings`]; every implementation and the
//! tests' oracle read them there.
//!
//! Features, both on by default: `cpu` is the renderer on the CPU, with its threads; `gpu` is the renderer on GPUs,
//! with `wgpu`.

#[cfg(feature = "cpu")]
mod cpu;
pub mod device;
#[cfg(feature = "gpu")]
pub mod gpu;
mod project;
mod rasterizer;
pub mod settings;
mod stage_times;
mod tile_mask;
mod tiling;
mod weights;

#[cfg(feature = "cpu")]
pub use cpu::{CpuLocked, CpuRasterizer, CpuSaved, CpuTiles, Scope, count_pairs, gaussians_reaching, tiles_reached};
pub use project::{Projection, SplatCamera, kept_opacity_vjp, project, project_vjp};
pub use rasterizer::{Draw, DrawAny, Rasterizer, RenderGrads, RenderOutput, draw_any};
pub use settings::RenderSettings;
pub use stage_times::{Laps, PairCounts, RENDER_STAGES, StageTimes};
pub use tile_mask::TileMask;
pub use tiling::{TILE, tile_grid};
pub use weights::weights_step;
