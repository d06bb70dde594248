//! Peak signal-to-noise ratio, in the two conventions that publications use, and over a mask.
//!
//! By Jensen's inequality the mean of the channels' PSNRs is never below the PSNR of all channels
//! together, so the two must not be mixed in one table.

use tcgs_core::Image;

use crate::assert_same_shape;

/// PSNR of identical images: a finite number keeps means meaningful.
const MAX_PSNR: f64 = 100.0;

/// PSNR in dB over all channels together, both images clamped to `[0, 1]`; at most 100.
///
/// ```
/// use tcgs_core::Image;
/// let (a, b) = (Image::filled(4, 4, 3, 0.5), Image::filled(4, 4, 3, 0.6));
/// assert!((tcgs_metrics::psnr(&a, &b) - 20.0).abs() < 1e-5);
/// assert_eq!(tcgs_metrics::psnr(&a, &a), 100.0);
/// ```
///
/// # Panics
/// If the images differ in shape or have no values.
pub fn psnr(rendered: &Image, target: &Image) -> f64 {
    assert_same_shape(rendered, target);
    let errors = rendered.data.iter().zip(&target.data).map(|(&a, &b)| clamped_squared_error(a, b));
    psnr_from_mse(mean(errors))
}

/// PSNR in dB of each channel alone, averaged over the channels; nothing is clamped. Each channel
/// counts at most 100.
///
/// The convention of the evaluation behind the paper's numbers.
///
/// ```
/// use tcgs_core::Image;
/// // One channel is off by 0.1, which is 20 dB; the other is exact and counts 100.
/// let rendered = Image { width: 1, height: 1, num_channels: 2, data: vec![0.6, 0.5] };
/// let target = Image::filled(1, 1, 2, 0.5);
/// assert!((tcgs_metrics::psnr_per_channel(&rendered, &target) - 60.0).abs() < 1e-4);
/// ```
///
/// # Panics
/// If the images differ in shape or have no values.
pub fn psnr_per_channel(rendered: &Image, target: &Image) -> f64 {
    assert_same_shape(rendered, target);
    let channel_psnr = |channel| {
        let planes = rendered.plane(channel).iter().zip(target.plane(channel));
        psnr_from_mse(mean(planes.map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2))))
    };
    mean((0..rendered.num_channels).map(channel_psnr))
}

/// [`psnr`] over the pixels of a mask.
///
/// - `mask`: `[H, W]`, which pixels count
/// - returns: dB; `None` if no pixel counts
///
/// ```
/// use tcgs_core::Image;
/// let (a, b) = (Image::filled(2, 1, 3, 0.5), Image::filled(2, 1, 3, 0.6));
/// assert!((tcgs_metrics::psnr_masked(&a, &b, &[true, false]).unwrap() - 20.0).abs() < 1e-5);
/// assert_eq!(tcgs_metrics::psnr_masked(&a, &b, &[false, false]), None);
/// ```
///
/// # Panics
/// If the images differ in shape or the mask has another number of pixels.
pub fn psnr_masked(rendered: &Image, target: &Image, mask: &[bool]) -> Option<f64> {
    assert_same_shape(rendered, target);
    assert_eq!(mask.len(), rendered.num_pixels(), "mask [{}] against the image's [H * W]", mask.len());
    if rendered.num_channels == 0 || !mask.contains(&true) {
        return None;
    }
    let errors = (0..rendered.num_channels).flat_map(|channel| {
        let planes = rendered.plane(channel).iter().zip(target.plane(channel));
        planes.zip(mask).filter(|(_, inside)| **inside).map(|((&a, &b), _)| clamped_squared_error(a, b))
    });
    Some(psnr_from_mse(mean(errors)))
}

fn clamped_squared_error(a: f32, b: f32) -> f64 {
    (f64::from(a.clamp(0.0, 1.0)) - f64::from(b.clamp(0.0, 1.0))).powi(2)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for value in values {
        sum += value;
        count += 1;
    }
    assert!(count > 0, "metric of an image without values");
    sum / count as f64
}

/// NaN stays NaN: a broken image must not score the maximum, as `f64::min` would have it.
fn psnr_from_mse(mse: f64) -> f64 {
    let psnr = -10.0 * mse.log10();
    if psnr > MAX_PSNR { MAX_PSNR } else { psnr }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(num_channels: usize, data: &[f32]) -> Image {
        Image { width: data.len() / num_channels, height: 1, num_channels, data: data.to_vec() }
    }

    #[test]
    fn identical_images_give_a_hundred() {
        let a = image(3, &[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
        assert_eq!((psnr(&a, &a), psnr_per_channel(&a, &a)), (100.0, 100.0));
        assert_eq!(psnr_masked(&a, &a, &[false, true]), Some(100.0));
    }

    #[test]
    fn only_psnr_per_channel_sees_what_lies_outside_of_the_unit_range() {
        let (a, b) = (image(2, &[1.5, 0.5, 0.5, 0.5]), image(2, &[1.0, 0.5, 0.5, 0.25]));
        // All together: one error of 1/4 in four values.
        assert!((psnr(&a, &b) - 10.0 * 64f64.log10()).abs() < 1e-9);
        // Channel 0: 1/4 over two values; channel 1: 1/16 over two.
        let expected = (10.0 * 8f64.log10() + 10.0 * 32f64.log10()) / 2.0;
        assert!((psnr_per_channel(&a, &b) - expected).abs() < 1e-9);
    }

    #[test]
    fn a_mask_selects_pixels_in_every_channel() {
        let (a, b) = (image(2, &[0.0, 0.5, 0.0, 0.5]), image(2, &[1.0, 0.5, 0.0, 0.4]));
        let found = psnr_masked(&a, &b, &[false, true]).unwrap();
        assert!((found - 10.0 * 200f64.log10()).abs() < 1e-5);
        assert_eq!(psnr_masked(&a, &b, &[true, true]), Some(psnr(&a, &b)));
        assert_eq!(psnr_masked(&a, &b, &[false, false]), None);
    }

    #[test]
    fn a_broken_image_does_not_score_the_maximum() {
        let (a, b) = (image(1, &[f32::NAN, 0.5]), image(1, &[0.5, 0.5]));
        assert!(psnr(&a, &b).is_nan() && psnr_per_channel(&a, &b).is_nan());
        assert!(psnr_masked(&a, &b, &[true, true]).unwrap().is_nan());
    }

    #[test]
    #[should_panic(expected = "rendered image and of the target")]
    fn shapes_that_differ_panic() {
        psnr(&image(1, &[0.0; 4]), &image(2, &[0.0; 4]));
    }
}
