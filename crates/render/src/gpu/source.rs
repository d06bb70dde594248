//! WGSL is put together from text: constants that Rust owns, shared parts, and the operation's own file.

use super::{MAX_GROUPS_X, SORT_BLOCK, radix, renderer};
use crate::settings;

/// Pixels of a tile's side. A tile's pixels are one workgroup.
pub const TILE: usize = 16;

/// Splats of a bucket: backward gives each bucket of a tile a workgroup with one thread a splat, and
/// forward keeps what it has blended before each bucket.
pub const BUCKET: usize = 32;

/// The constants of [`settings`] and of this module, then `parts`, as one source.
///
/// - `num_channels`: of the colours, 1 to 8
pub fn source(num_channels: usize, parts: &[&str]) -> String {
    let mut text = format!(
        "const NEAR: f32 = {:?};
const BLUR_VARIANCE: f32 = {:?};
const MIN_ALPHA: f32 = {:?};
const MAX_ALPHA: f32 = {:?};
const MIN_TRANSMITTANCE: f32 = {:?};
const CHANNELS: u32 = {num_channels}u;
const TILE: u32 = {TILE}u;
const BUCKET: u32 = {BUCKET}u;
const MAX_GROUPS_X: u32 = {MAX_GROUPS_X}u;
const SORT_BLOCK: u32 = {SORT_BLOCK}u;
",
        settings::NEAR as f32,
        settings::BLUR_VARIANCE as f32,
        settings::MIN_ALPHA as f32,
        settings::MAX_ALPHA as f32,
        settings::MIN_TRANSMITTANCE as f32,
    );
    for part in parts {
        text.push_str(part);
        text.push('\n');
    }
    text
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
