//! `0.8 L1 + 0.2 (1 − SSIM)` on the colour image and on the segmentation image, with the camera's
//! gain and offset on the colours.

use rayon::prelude::*;
use tcgs_core::Image;
use tcgs_metrics::{ssim_bwd, ssim_fwd};

use crate::losses::{COUNTED_CHANNELS, L1_SHARE};

/// Values and gradients of the two image losses of one view.
#[derive(Clone, Debug)]
pub struct ImageLoss {
    /// Loss of the colour image, before its weight.
    pub image: f64,
    /// Loss of the segmentation image, before its weight; 0 without segmentation.
    pub segmentation: f64,
    /// `[C, H, W]`, gradient of the weighted sum with respect to the rendered image before the camera's gain and
    /// offset.
    pub v_image: Image,
    /// Gradient of the weighted sum with respect to the logarithm of the camera's gain.
    pub v_gain: [f32; 3],
    /// Gradient of the weighted sum with respect to the camera's offset.
    pub v_offset: [f32; 3],
}

/// Compares a rendered image with its target.
///
/// - `rendered`: `[C, H, W]`, of the target's shape, `C` 3 or 5
/// - `gain`, `offset`: the camera's; its image is `exp(gain) * rendered + offset`
/// - `image_weight`, `segmentation_weight`: of the two losses, in the gradients
pub fn image_loss(
    rendered: &Image,
    target: &Image,
    gain: [f32; 3],
    offset: [f32; 3],
    image_weight: f32,
    segmentation_weight: f32,
) -> ImageLoss {
    let pixels = rendered.num_pixels();
    let channels = rendered.num_channels;
    let factor = gain.map(f32::exp);
    let mut corrected = rendered.clone();
    for channel in 0..3 {
        for value in corrected.plane_mut(channel) {
            *value = factor[channel] * *value + offset[channel];
        }
    }

    let weight = |channel: usize| if channel < 3 { image_weight } else { segmentation_weight };
    let (ssim, saved) = ssim_fwd(&corrected, target);
    let mut v_image = Image::filled(rendered.width, rendered.height, channels, 0.0);
    let v_ssim: Vec<f32> = (0..channels).map(|c| -(1.0 - L1_SHARE) * weight(c) / COUNTED_CHANNELS).collect();
    ssim_bwd(&corrected, target, &saved, &v_ssim, &mut v_image);

    // L1, and the colours' correction taken back, channel by channel.
    let sums: Vec<(f64, f64, f64)> = v_image
        .data
        .par_chunks_mut(pixels)
        .enumerate()
        .map(|(channel, v_plane)| {
            let slope = L1_SHARE * weight(channel) / (COUNTED_CHANNELS * pixels as f32);
            let (mut l1, mut v_gain, mut v_offset) = (0.0_f64, 0.0_f64, 0.0_f64);
            let planes = corrected.plane(channel).iter().zip(target.plane(channel)).zip(rendered.plane(channel));
            for (v, ((&a, &b), &raw)) in v_plane.iter_mut().zip(planes) {
                let difference = a - b;
                l1 += f64::from(difference.abs());
                *v += if difference > 0.0 {
                    slope
                } else if difference < 0.0 {
                    -slope
                } else {
                    0.0
                };
                if channel < 3 {
                    v_offset += f64::from(*v);
                    *v *= factor[channel];
                    v_gain += f64::from(*v * raw);
                }
            }
            (l1, v_gain, v_offset)
        })
        .collect();

    let loss = |range: std::ops::Range<usize>| {
        let l1: f64 =
            sums[range.clone()].iter().map(|s| s.0).sum::<f64>() / (f64::from(COUNTED_CHANNELS) * pixels as f64);
        // A channel that is not rendered is zero in both images and has an SSIM of 1.
        let unseen = f64::from(COUNTED_CHANNELS) - range.len() as f64;
        let ssim = (ssim[range].iter().sum::<f64>() + unseen) / f64::from(COUNTED_CHANNELS);
        f64::from(L1_SHARE) * l1 + f64::from(1.0 - L1_SHARE) * (1.0 - ssim)
    };
    ImageLoss {
        image: loss(0..3),
        segmentation: if channels > 3 { loss(3..channels) } else { 0.0 },
        v_image,
        v_gain: std::array::from_fn(|c| sums[c].1 as f32),
        v_offset: std::array::from_fn(|c| sums[c].2 as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pattern(channels: usize, phase: f32) -> Image {
        let mut image = Image::filled(23, 17, channels, 0.0);
        for (i, v) in image.data.iter_mut().enumerate() {
            *v = 0.5 + 0.4 * (i as f32 * 0.13 + phase).sin() * (i as f32 * 0.031).cos();
        }
        image
    }

    #[test]
    fn gradients_match_central_differences() {
        let (rendered, target) = (pattern(5, 0.3), pattern(5, 0.0));
        let (gain, offset) = ([0.1, -0.2, 0.05], [0.02, 0.0, -0.03]);
        let at = |rendered: &Image, gain, offset| {
            let l = image_loss(rendered, &target, gain, offset, 1.0, 3.0);
            l.image + 3.0 * l.segmentation
        };
        let loss = image_loss(&rendered, &target, gain, offset, 1.0, 3.0);
        // Large steps, since the loss is summed from f32: SSIM is smooth and L1 is linear.
        let h = 2e-2;
        for i in (0..rendered.data.len()).step_by(97) {
            let moved = |d: f32| {
                let mut image = rendered.clone();
                image.data[i] += d;
                at(&image, gain, offset)
            };
            if (rendered.data[i] - target.data[i]).abs() < 3.0 * h {
                continue; // the kink of L1
            }
            let difference = (moved(h) - moved(-h)) / (2.0 * f64::from(h));
            let found = f64::from(loss.v_image.data[i]);
            assert!((difference - found).abs() < 0.02 * difference.abs() + 2e-5, "{i}: {difference} against {found}");
        }
        for c in 0..3 {
            let move_by = |d: f32, base: [f32; 3]| {
                let mut x = base;
                x[c] += d;
                x
            };
            let h = 1e-3;
            let along_gain = (at(&rendered, move_by(h, gain), offset) - at(&rendered, move_by(-h, gain), offset))
                / (2.0 * f64::from(h));
            let along_offset = (at(&rendered, gain, move_by(h, offset)) - at(&rendered, gain, move_by(-h, offset)))
                / (2.0 * f64::from(h));
            assert!((along_gain - f64::from(loss.v_gain[c])).abs() < 0.02 * along_gain.abs() + 1e-4);
            assert!((along_offset - f64::from(loss.v_offset[c])).abs() < 0.02 * along_offset.abs() + 1e-4);
        }
    }

    #[test]
    fn the_unrendered_channel_counts_in_the_means() {
        let (mut rendered, mut target) = (Image::filled(16, 16, 5, 0.0), Image::filled(16, 16, 5, 0.0));
        rendered.plane_mut(3).fill(0.5);
        target.plane_mut(3).fill(0.25);
        let loss = image_loss(&rendered, &target, [0.0; 3], [0.0; 3], 1.0, 3.0);
        let three = image_loss(
            &Image {
                num_channels: 3,
                data: [rendered.plane(3), rendered.plane(0), rendered.plane(4)].concat(),
                ..rendered
            },
            &Image { num_channels: 3, data: [target.plane(3), target.plane(0), target.plane(4)].concat(), ..target },
            [0.0; 3],
            [0.0; 3],
            1.0,
            3.0,
        );
        assert!((loss.segmentation - three.image).abs() < 1e-6 && loss.segmentation > 0.05);
    }
}
