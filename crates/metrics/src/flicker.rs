//! Flicker: how much a video changes where its scene stands still.
//!
//! With `x_t` the rendered image at time `t` and `y_t` the camera's, a pixel is static at `t` if no channel of `y`
//! changes by more than [`STATIC_CHANGE`] from `t - 1` to `t`. Over the static pixels and their channels:
//!
//! ```text
//! flicker = mean |(x_t - x_{t-1}) - (y_t - y_{t-1})|
//! ```
//!
//! In units of the image (1 is white), clamped. 0 is the camera's own video. One that stands perfectly still scores
//! the camera's noise: compare figures of one capture. PSNR does not see flicker: an error that stands still and
//! one that jumps cost the same.

use tcgs_core::Image;

use crate::assert_same_shape;

/// Largest change of a static pixel. It lies above the noise of a camera and of JPEG: on Panoptic Sports nine pixels of
/// ten stay below it from frame to frame. It lies below the change of an edge that moves.
pub const STATIC_CHANGE: f32 = 8.0 / 255.0;

/// Flicker between two moments of one camera; `None` if nothing is static.
///
/// - `rendered`, `target`: the earlier and the later image each, `[C, H, W]`
///
/// ```
/// use tcgs_core::Image;
/// let (dark, bright) = (Image::filled(4, 4, 3, 0.5), Image::filled(4, 4, 3, 0.6));
/// let still = [&dark, &dark];
/// assert!((tcgs_metrics::flicker([&dark, &bright], still).unwrap() - 0.1).abs() < 1e-6);
/// assert_eq!(tcgs_metrics::flicker([&bright, &bright], still), Some(0.0), "an error that stands still");
/// ```
///
/// # Panics
/// If the images differ in shape.
pub fn flicker(rendered: [&Image; 2], target: [&Image; 2]) -> Option<f64> {
    assert_same_shape(rendered[0], target[0]);
    assert_same_shape(rendered[1], target[1]);
    assert_same_shape(target[0], target[1]);
    let change = |images: [&Image; 2], i: usize| {
        let [before, after] = images.map(|image| image.data[i].clamp(0.0, 1.0));
        after - before
    };
    let (num_pixels, num_channels) = (target[0].num_pixels(), target[0].num_channels);
    let (mut sum, mut count) = (0.0, 0usize);
    for pixel in 0..num_pixels {
        let values = (0..num_channels).map(|channel| channel * num_pixels + pixel);
        if values.clone().any(|i| change(target, i).abs() > STATIC_CHANGE) {
            continue;
        }
        sum += values.map(|i| f64::from((change(rendered, i) - change(target, i)).abs())).sum::<f64>();
        count += num_channels;
    }
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(data: [f32; 4]) -> Image {
        Image { width: 2, height: 1, num_channels: 2, data: data.to_vec() }
    }

    #[test]
    fn only_pixels_that_stand_still_in_every_channel_count() {
        // The first pixel moves in its second channel; the second drifts by 0.02, its render by 0.05 and -0.01.
        let target = [image([0.5, 0.5, 0.1, 0.3]), image([0.5, 0.52, 0.9, 0.32])];
        let rendered = [image([0.0, 0.6, 1.0, 0.4]), image([1.0, 0.65, 0.0, 0.39])];
        let found = flicker([&rendered[0], &rendered[1]], [&target[0], &target[1]]).unwrap();
        assert!((found - (0.03 + 0.03) / 2.0).abs() < 1e-6, "{found}");
        assert_eq!(flicker([&target[0], &target[1]], [&target[0], &target[1]]), Some(0.0));
    }

    #[test]
    fn nothing_static_gives_nothing() {
        let (dark, bright) = (Image::filled(3, 3, 3, 0.0), Image::filled(3, 3, 3, 1.0));
        assert_eq!(flicker([&dark, &dark], [&dark, &bright]), None);
        // Clamped alike, a render beyond white does not flicker.
        let beyond = Image::filled(3, 3, 3, 1.5);
        assert_eq!(flicker([&bright, &beyond], [&dark, &dark]), Some(0.0));
    }
}
