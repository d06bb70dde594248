//! The renderer's shaders: the constants that Rust owns, shared parts, and the operation's own file.

use super::{MAX_GROUPS_X, SORT_BLOCK, WORKGROUP, radix, renderer};
use crate::device::Wgsl;
use crate::settings;
use crate::tiling::{EXTENT_FACTOR, EXTENT_MARGIN_PX, PAIR_GRADS, TILE};

/// Splats of a bucket: backward gives each bucket of a tile a workgroup with one thread a splat, and
/// forward keeps what it has blended before each bucket.
pub const BUCKET: usize = 32;

/// Marks a tile count of a splat whose bounds hold a pixel, whether or not a tile is reached.
pub(super) const VISIBLE: u32 = 0x8000_0000;

/// What every shader of the renderer starts with: the constants of [`settings`], of the tiling and of this module.
///
/// - `num_channels`: of the colours, 1 to 8
pub(super) fn source(num_channels: usize) -> Wgsl {
    Wgsl::new()
        .constant("NEAR", settings::NEAR as f32)
        .constant("BLUR_VARIANCE", settings::BLUR_VARIANCE as f32)
        .constant("MIN_ALPHA", settings::MIN_ALPHA as f32)
        .constant("MAX_ALPHA", settings::MAX_ALPHA as f32)
        .constant("MIN_TRANSMITTANCE", settings::MIN_TRANSMITTANCE as f32)
        .constant("EXTENT_FACTOR", EXTENT_FACTOR)
        .constant("EXTENT_MARGIN_PX", EXTENT_MARGIN_PX)
        .constant("CHANNELS", num_channels)
        .constant("TILE", TILE)
        .constant("PIXELS", TILE * TILE)
        .constant("PAIR_GRADS", PAIR_GRADS)
        .constant("BUCKET", BUCKET)
        .constant("VISIBLE", VISIBLE)
        .constant("WORKGROUP", WORKGROUP)
        .constant("MAX_GROUPS_X", MAX_GROUPS_X)
        .constant("SORT_BLOCK", SORT_BLOCK)
        .activated_columns()
}

/// Every shader of this module with its name, as the GPU gets it; where the channels count, once for colour (3) and
/// once for colour with segmentation (5).
pub fn sources() -> Vec<(String, String)> {
    let mut sources = vec![("radix".into(), radix::composed())];
    for num_channels in [3, 5] {
        for (name, source) in renderer::sources(num_channels, num_channels == 5) {
            sources.push((format!("{name}_{num_channels}"), source));
        }
    }
    sources
}
