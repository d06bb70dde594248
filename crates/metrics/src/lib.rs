//! Image metrics: PSNR, SSIM with its gradient, MS-SSIM, LPIPS, flicker, and the named protocols of publications.
//!
//! A judge that knows no model: images in, numbers out. Values nominally lie in `[0, 1]`; LPIPS needs three channels,
//! the others take any number.

mod error;
mod flicker;
mod lpips;
mod ms_ssim;
mod protocol;
mod psnr;
mod ssim;
mod uniform_ssim;

pub use error::MetricsError;
pub use flicker::{STATIC_CHANGE, flicker};
pub use lpips::{Backbone, InputRange, Lpips};
pub use ms_ssim::{MIN_MS_SSIM_SIDE, dssim, ms_ssim};
pub use protocol::{Measure, PixelRange, Protocol, ProtocolMetric, Rules};
pub use psnr::{psnr, psnr_masked, psnr_per_channel};
pub use ssim::{ImagePair, SSIM_C1, SSIM_C2, SSIM_RADIUS, SSIM_WINDOW, ssim, ssim_grad};
pub use uniform_ssim::uniform_ssim;

/// Both images must have one shape.
fn assert_same_shape(rendered: &tcgs_core::Image, target: &tcgs_core::Image) {
    assert_eq!(rendered.shape(), target.shape(), "[C, H, W] of the rendered image and of the target");
    assert_eq!(rendered.data.len(), target.data.len(), "number of values of the rendered image and of the target");
}
