//! Image metrics: PSNR and SSIM, with the gradient of SSIM.
//!
//! A judge that knows no model: images in, numbers out. Both metrics take images of any number of
//! channels whose values nominally lie in `[0, 1]`.

mod psnr;
mod ssim;

pub use psnr::{psnr, psnr_masked, psnr_per_channel};
pub use ssim::{SsimSaved, ssim, ssim_bwd, ssim_fwd};

/// Both images must have one shape.
fn assert_same_shape(rendered: &tcgs_core::Image, target: &tcgs_core::Image) {
    let shape = |image: &tcgs_core::Image| [image.num_channels, image.height, image.width];
    assert_eq!(shape(rendered), shape(target), "[C, H, W] of the rendered image and of the target");
    assert_eq!(rendered.data.len(), target.data.len(), "number of values of the rendered image and of the target");
}
