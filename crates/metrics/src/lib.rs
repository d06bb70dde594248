//! Image metrics: PSNR and SSIM, with the gradient of SSIM
