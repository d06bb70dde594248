//! `params.npz` of Dynamic 3D Gaussians (Luiten et al. 2024): one archive with one array per attribute.
//!
//! | key | shape | here |
//! |---|---|---|
//! | `means3D` | `(T, N, 3)` | `means` |
//! | `rgb_colors` | `(T, N, 3)` | `colors` |
//! | `unnorm_rotations` | `(T, N, 4)`, `w, x, y, z` | `quats` |
//! | `logit_opacities` | `(N, 1)` | `logit_opacities` |
//! | `log_scales` | `(N, 3)` | `log_scales` |
//! | `seg_colors` | `(N, 3)`: foreground, 0, background | [`ParamsExtras::foreground`], written only |
//! | `cam_m`, `cam_c` | `(50, 3)`: image = exp(cam_m) * render + cam_c | [`ParamsExtras`], written only |
//! | `tcgs_first_frame`, `tcgs_downscale`, `tcgs_frame_rate` | `(1,)` each, ours alone, optional | [`ParamsOrigin`] |
//! | `tcgs_antialiased` | `(1,)`: 1, ours alone, of antialiased scenes | [`Layout::is_antialiased`](tcgs_core::Layout::is_antialiased) |
//! | `tcgs_background` | `(3,)`: red, green, blue of 255, ours alone, unless black | [`Layout::background`](tcgs_core::Layout) |
//!
//! The format has no field for the frame of the capture that its first timestep shows. Other programs number the
//! timesteps from 0 and ignore the arrays whose names begin with `tcgs_`: a scene of the frames 7 to 9 has the
//! timesteps 0 to 2 there. The writer does not pad the scene with empty timesteps, since other programs would draw them
//! and train on them. A reader that needs the frame's number reads `tcgs_first_frame`.

mod read;
#[cfg(test)]
mod tests;
mod write;

pub use self::read::{ParamsNpz, read_params_foreground, read_params_npz, read_params_origin};
pub use self::write::{ParamsExtras, write_params_npz, write_params_npz_from, write_params_npz_to};

/// Keys of [`ParamsOrigin`].
const FIRST_FRAME: &str = "tcgs_first_frame";
const DOWNSCALE: &str = "tcgs_downscale";
const FRAME_RATE: &str = "tcgs_frame_rate";
/// Key of an array that antialiased scenes have.
const ANTIALIASED: &str = "tcgs_antialiased";
/// Key of the colour behind all Gaussians, sRGB of 255, unless it is black.
const BACKGROUND: &str = "tcgs_background";

/// Which frames of a capture a scene shows, and at which resolution it was trained. The format of Dynamic 3D Gaussians
/// has no such fields; other programs ignore these arrays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParamsOrigin {
    /// Index of the capture's frame that timestep 0 shows, below 16,777,216, since the array is float32.
    pub first_frame: u32,
    /// Factor by which width and height of the capture's images were divided for training, 1 to 65536.
    pub downscale: u32,
    /// Frames per second; 0 if unknown.
    pub frame_rate: f32,
}
