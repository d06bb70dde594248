//! What a renderer on a device needs of no device's interface: how Gaussians lie in memory, the text of shaders.

mod activated;
mod wgsl;

pub use activated::{ACTIVATED_VALUES, activated_len, pack};
pub use wgsl::{Wgsl, WgslValue};
