//! SSIM with a uniform window, as `skimage.metrics.structural_similarity` computes it by default.
//!
//! The window is 7x7 and uniform. Variances and the covariance are those of samples (`49 / 48` of the window's). Only
//! pixels whose window lies inside the image count. The constants are `C1 = (0.01 R)²`, `C2 = (0.03 R)²` for a data
//! range `R`. The formula is that of [`crate::ssim`]. For float images without a range, `skimage` once assumed `R = 2`,
//! which flatters. This metric exists only because published figures were computed that way.

use rayon::prelude::*;
use tcgs_core::Image;

use crate::assert_same_shape;

/// Pixels on a side of the window.
const SIZE: usize = 7;

/// SSIM over a uniform window, averaged over pixels, then channels; `None` where a side has fewer than 7 pixels.
///
/// - `rendered`, `target`: `[C, H, W]`, not clamped
/// - `data_range`: `R`
///
/// ```
/// let image = tcgs_core::Image::filled(20, 7, 3, 0.5);
/// assert!((tcgs_metrics::uniform_ssim(&image, &image, 2.0).unwrap() - 1.0).abs() < 1e-12);
/// ```
///
/// # Panics
/// If the images differ in shape.
pub fn uniform_ssim(rendered: &Image, target: &Image, data_range: f64) -> Option<f64> {
    assert_same_shape(rendered, target);
    if rendered.width.min(rendered.height) < SIZE || rendered.num_channels == 0 {
        return None;
    }
    let (c1, c2) = ((0.01 * data_range).powi(2), (0.03 * data_range).powi(2));
    let (width, inner_height) = (rendered.width, rendered.height - SIZE + 1);
    let rows = (0..rendered.num_channels).flat_map(|channel| (0..inner_height).map(move |row| (channel, row)));
    let sums: Vec<f64> = rows
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|(channel, row)| {
            let rows = |image: &Image| -> Vec<f64> {
                image.plane(channel)[row * width..][..SIZE * width].iter().map(|&v| f64::from(v)).collect()
            };
            row_sum(width, &rows(rendered), &rows(target), c1, c2)
        })
        .collect();
    let num_values = rendered.num_channels * inner_height * (width - SIZE + 1);
    Some(sums.iter().sum::<f64>() / num_values as f64)
}

/// Sum of the map over one row.
///
/// - `x`, `y`: `[7, W]`, the rows that its windows reach
fn row_sum(width: usize, x: &[f64], y: &[f64], c1: f64, c2: f64) -> f64 {
    // Down the columns first: x, y, x², y², xy.
    let columns: Vec<[f64; 5]> = (0..width)
        .map(|i| {
            let values = (0..SIZE).map(|row| (x[row * width + i], y[row * width + i]));
            values.fold([0.0; 5], |sums, (x, y)| add(sums, [x, y, x * x, y * y, x * y]))
        })
        .collect();
    let count = (SIZE * SIZE) as f64;
    let of_samples = count / (count - 1.0);
    let map = columns.windows(SIZE).map(|window| {
        let sums = window.iter().fold([0.0; 5], |sums, &column| add(sums, column));
        let [mx, my, xx, yy, xy] = sums.map(|sum| sum / count);
        let (variances, covariance) = (of_samples * (xx - mx * mx + yy - my * my), of_samples * (xy - mx * my));
        (2.0 * mx * my + c1) * (2.0 * covariance + c2) / ((mx * mx + my * my + c1) * (variances + c2))
    });
    map.sum()
}

fn add(a: [f64; 5], b: [f64; 5]) -> [f64; 5] {
    std::array::from_fn(|i| a[i] + b[i])
}
