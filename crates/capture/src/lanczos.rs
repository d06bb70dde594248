//! Halving images as publications on Neural 3D Video do.
//!
//! These publications use Pillow's `LANCZOS`: a windowed sinc of radius 3, widened by the factor, first along rows,
//! then along columns, with 8 bits between. Pillow's weights are fixed-point numbers, and so are these: the results are
//! equal to the bit.

use image::RgbImage;

/// Radius of the kernel, pixels of the result.
const RADIUS: f64 = 3.0;
/// Number of pixels that become one, along each axis.
const SCALE: f64 = 2.0;
/// Fractional bits of a weight.
const PRECISION: u32 = 22;

/// An image of half the width and height.
///
/// - `image`: both sides even
pub(crate) fn halve(image: &RgbImage) -> RgbImage {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let (half_width, half_height) = (width / 2, height / 2);
    let row_bytes = 3 * half_width;

    let mut narrow = vec![0; row_bytes * height];
    let taps = taps(width, half_width);
    for (row, out) in image.as_raw().chunks_exact(3 * width).zip(narrow.chunks_exact_mut(row_bytes)) {
        for (taps, pixel) in taps.iter().zip(out.as_chunks_mut::<3>().0) {
            let source = row[3 * taps.first..].as_chunks::<3>().0;
            let mut sum = [HALF; 3];
            for (&weight, color) in taps.weights.iter().zip(source) {
                for c in 0..3 {
                    sum[c] += weight * i32::from(color[c]);
                }
            }
            *pixel = sum.map(round);
        }
    }

    let mut small = vec![0; row_bytes * half_height];
    let taps = self::taps(height, half_height);
    let mut sums = vec![0; row_bytes];
    for (taps, out) in taps.iter().zip(small.chunks_exact_mut(row_bytes)) {
        sums.fill(HALF);
        for (&weight, row) in taps.weights.iter().zip(narrow[taps.first * row_bytes..].chunks_exact(row_bytes)) {
            for (sum, &value) in sums.iter_mut().zip(row) {
                *sum += weight * i32::from(value);
            }
        }
        for (value, &sum) in out.iter_mut().zip(&sums) {
            *value = round(sum);
        }
    }
    RgbImage::from_raw(half_width as u32, half_height as u32, small).expect("as many bytes as pixels")
}

/// Weights of the source pixels of one pixel of the result.
struct Taps {
    first: usize,
    weights: Vec<i32>,
}

const HALF: i32 = 1 << (PRECISION - 1);

fn round(sum: i32) -> u8 {
    (sum >> PRECISION).clamp(0, 255) as u8
}

/// Weights along one axis. At the edges the kernel is cut off, and the remaining weights sum to one.
fn taps(size: usize, half_size: usize) -> Vec<Taps> {
    let support = RADIUS * SCALE;
    (0..half_size)
        .map(|i| {
            let center = (i as f64 + 0.5) * SCALE;
            let first = (center - support + 0.5).max(0.0) as usize;
            let end = ((center + support + 0.5) as usize).min(size);
            let weight = |j: usize| lanczos((j as f64 - center + 0.5) / SCALE);
            let sum: f64 = (first..end).map(weight).sum();
            let fixed = |j: usize| (weight(j) / sum * f64::from(1 << PRECISION)).round() as i32;
            Taps { first, weights: (first..end).map(fixed).collect() }
        })
        .collect()
}

fn lanczos(x: f64) -> f64 {
    let sinc = |x: f64| if x == 0.0 { 1.0 } else { (x * std::f64::consts::PI).sin() / (x * std::f64::consts::PI) };
    if (-RADIUS..RADIUS).contains(&x) { sinc(x) * sinc(x / RADIUS) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pillow_gives_the_same_bytes() {
        let picture = RgbImage::from_fn(18, 14, |x, y| {
            let checker = if (x / 3 + y / 4) % 2 == 1 { 255 } else { 0 };
            image::Rgb([0, 71, 142].map(|c| ((x * x * 7 + y * y * 13 + x * y * 29 + c + checker) % 256) as u8))
        });
        // numpy.array(PIL.Image.fromarray(picture).resize((9, 7), PIL.Image.LANCZOS)), Pillow 13.
        #[rustfmt::skip]
        let expected = [
            14, 96, 164, 92, 138, 163, 155, 168, 142, 141, 156, 138, 124, 117, 132, 146, 100, 140, 141, 131, 150, 158, 79, 156, 236, 39, 114,
            122, 114, 97, 132, 133, 135, 100, 134, 102, 92, 139, 112, 151, 78, 113, 83, 149, 90, 137, 118, 76, 196, 93, 58, 173, 63, 131,
            164, 80, 119, 120, 140, 154, 182, 60, 121, 155, 159, 72, 84, 153, 124, 109, 123, 111, 64, 140, 150, 147, 160, 82, 106, 108, 185,
            131, 148, 107, 50, 116, 178, 132, 81, 144, 160, 120, 133, 108, 133, 127, 130, 148, 110, 159, 118, 145, 142, 162, 129, 143, 122, 118,
            37, 118, 181, 65, 150, 198, 115, 161, 124, 140, 147, 132, 96, 142, 106, 77, 144, 87, 140, 148, 143, 159, 108, 129, 133, 137, 139,
            68, 119, 186, 125, 157, 96, 97, 140, 128, 134, 111, 143, 160, 121, 90, 99, 144, 126, 153, 130, 131, 158, 104, 159, 45, 126, 207,
            109, 177, 124, 104, 149, 132, 151, 126, 100, 91, 150, 143, 117, 70, 142, 76, 147, 110, 107, 185, 112, 189, 119, 87, 79, 110, 143,
        ];
        assert_eq!(halve(&picture).as_raw()[..], expected);
    }

    #[test]
    fn one_colour_stays() {
        let picture = RgbImage::from_pixel(20, 6, image::Rgb([3, 128, 255]));
        assert!(halve(&picture).pixels().all(|pixel| pixel.0 == [3, 128, 255]));
    }
}
