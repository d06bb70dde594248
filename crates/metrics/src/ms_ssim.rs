//! Multi-scale structural similarity (Wang, Simoncelli & Bovik 2003), and the dissimilarity derived from it.
//!
//! Five scales, each half the size of the one before. With `cs_j` the mean over a channel's pixels of
//! `(2 covariance + C2) / (variance_x + variance_y + C2)` at scale `j`, and `ssim_5` that of the whole map at the last:
//!
//! ```text
//! ms_ssim = mean over channels of ssim_5^w5 Π_{j<5} cs_j^wj      w = 0.0448 0.2856 0.3001 0.2363 0.1333
//! dssim   = (1 - ms_ssim) / 2
//! ```
//!
//! Negative means count as 0. Window and constants are those of [`crate::ssim`], but only pixels whose window lies
//! inside the image count. An odd side gets a row or column of zeros before it, which is then included in the 2x2
//! average. All of this agrees with `pytorch_msssim`, the source of published figures.

use tcgs_core::Image;

use crate::assert_same_shape;
use crate::ssim::{WINDOW_SIZE, inner_means};

/// By scale, from the finest.
const WEIGHTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];

/// Fewest pixels of a side for [`ms_ssim`]: the window fits inside the smallest scale.
pub const MIN_MS_SSIM_SIDE: usize = (WINDOW_SIZE - 1) * (1 << (WEIGHTS.len() - 1)) + 1;

/// MS-SSIM, averaged over channels; `None` where a side has fewer than [`MIN_MS_SSIM_SIDE`] = 161 pixels.
///
/// - `rendered`, `target`: `[C, H, W]`, not clamped
///
/// ```
/// let image = tcgs_core::Image::filled(161, 170, 3, 0.5);
/// assert!((tcgs_metrics::ms_ssim(&image, &image).unwrap() - 1.0).abs() < 1e-6);
/// assert_eq!(tcgs_metrics::ms_ssim(&image.downscaled(2), &image.downscaled(2)), None);
/// ```
///
/// # Panics
/// If the images differ in shape.
pub fn ms_ssim(rendered: &Image, target: &Image) -> Option<f64> {
    assert_same_shape(rendered, target);
    if rendered.width.min(rendered.height) < MIN_MS_SSIM_SIDE || rendered.num_channels == 0 {
        return None;
    }
    let mut pair = [rendered.clone(), target.clone()];
    let mut products = vec![1.0; rendered.num_channels];
    for (scale, weight) in WEIGHTS.into_iter().enumerate() {
        let last = scale + 1 == WEIGHTS.len();
        for (product, (whole, structure)) in products.iter_mut().zip(inner_means(&pair[0], &pair[1])) {
            let mean = if last { whole } else { structure };
            // `f64::max` would score a broken image 0.
            *product *= if mean < 0.0 { 0.0 } else { mean.powf(weight) };
        }
        if !last {
            pair = pair.map(|image| halved(&image));
        }
    }
    Some(products.iter().sum::<f64>() / products.len() as f64)
}

/// Structural dissimilarity `(1 - ms_ssim) / 2`, as 4D Gaussian Splatting reports it; 0 for the same image.
///
/// - `ms_ssim`: in `[0, 1]`
///
/// ```
/// assert_eq!(tcgs_metrics::dssim(0.5), 0.25);
/// ```
pub fn dssim(ms_ssim: f64) -> f64 {
    (1.0 - ms_ssim) / 2.0
}

/// Averages over 2x2 pixels; an odd side has zeros before its first row or column.
fn halved(image: &Image) -> Image {
    let (pad_x, pad_y) = (image.width % 2, image.height % 2);
    let mut half = Image::filled(image.width.div_ceil(2), image.height.div_ceil(2), image.num_channels, 0.0);
    let (width, height) = (half.width, half.height);
    for channel in 0..image.num_channels {
        let source = image.plane(channel);
        let at = |y: usize, x: usize| match (y.checked_sub(pad_y), x.checked_sub(pad_x)) {
            (Some(y), Some(x)) => source[y * image.width + x],
            _ => 0.0,
        };
        let plane = half.plane_mut(channel);
        for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
            let (two_y, two_x) = (2 * y, 2 * x);
            let sum = at(two_y, two_x) + at(two_y, two_x + 1) + at(two_y + 1, two_x) + at(two_y + 1, two_x + 1);
            plane[y * width + x] = sum / 4.0;
        }
    }
    half
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_keeps_even_sides_and_pads_odd_ones_before() {
        let image = Image { width: 3, height: 2, num_channels: 1, data: vec![4.0, 8.0, 12.0, 0.0, 4.0, 8.0] };
        let half = halved(&image);
        assert_eq!((half.width, half.height, half.data), (2, 1, vec![1.0, 8.0]));
    }

    #[test]
    fn dissimilarity_is_half_of_what_is_missing() {
        assert_eq!((dssim(1.0), dssim(0.5)), (0.0, 0.25));
    }
}
