//! MS-SSIM and SSIM with a uniform window against oracles in `f64`, straight from the definitions.

use tcgs_core::Image;
use tcgs_metrics::{MIN_MS_SSIM_SIDE, ms_ssim, uniform_ssim};

/// One channel of an image.
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f64>,
}

impl Plane {
    fn of(image: &Image, channel: usize) -> Self {
        let values = image.plane(channel).iter().map(|&v| f64::from(v)).collect();
        Self { width: image.width, height: image.height, values }
    }

    /// Averages of 2x2; an odd side begins with zeros.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let at = |y: i64, x: i64| if y < 0 || x < 0 { 0.0 } else { self.values[y as usize * self.width + x as usize] };
        let (odd_y, odd_x) = ((self.height % 2) as i64, (self.width % 2) as i64);
        let mut values = Vec::new();
        for (y, x) in (0..height as i64).flat_map(|y| (0..width as i64).map(move |x| (2 * y, 2 * x))) {
            let four = [(0, 0), (0, 1), (1, 0), (1, 1)].map(|(dy, dx)| at(y + dy - odd_y, x + dx - odd_x));
            values.push(four.iter().sum::<f64>() / 4.0);
        }
        Self { width, height, values }
    }
}

/// Means of the map and of its second factor, over windows inside of the planes.
///
/// - `weight`: of an offset into the window, summing up to 1
/// - `scale`: of variances and covariance
fn similarity(
    x: &Plane,
    y: &Plane,
    size: usize,
    weight: &dyn Fn(usize, usize) -> f64,
    c: [f64; 2],
    scale: f64,
) -> [f64; 2] {
    let (mut whole, mut structure, mut count) = (0.0, 0.0, 0.0);
    for (top, left) in (0..=x.height - size).flat_map(|y| (0..=x.width - size).map(move |x| (y, x))) {
        let mut sums = [0.0; 5];
        for (dy, dx) in (0..size).flat_map(|dy| (0..size).map(move |dx| (dy, dx))) {
            let i = (top + dy) * x.width + left + dx;
            let (a, b) = (x.values[i], y.values[i]);
            for (sum, value) in sums.iter_mut().zip([a, b, a * a, b * b, a * b]) {
                *sum += weight(dy, dx) * value;
            }
        }
        let [mx, my, xx, yy, xy] = sums;
        let (vx, vy, vxy) = (scale * (xx - mx * mx), scale * (yy - my * my), scale * (xy - mx * my));
        let second = (2.0 * vxy + c[1]) / (vx + vy + c[1]);
        whole += (2.0 * mx * my + c[0]) / (mx * mx + my * my + c[0]) * second;
        structure += second;
        count += 1.0;
    }
    [whole / count, structure / count]
}

fn ms_ssim_oracle(x: &Image, y: &Image) -> f64 {
    let gauss = |d: usize| (-(d as f64 - 5.0).powi(2) / 4.5).exp();
    let total: f64 = (0..11).map(gauss).sum();
    let weight = |dy: usize, dx: usize| gauss(dy) * gauss(dx) / (total * total);
    let of_channel = |channel: usize| {
        let (mut x, mut y) = (Plane::of(x, channel), Plane::of(y, channel));
        let mut product = 1.0;
        for (scale, power) in [0.0448, 0.2856, 0.3001, 0.2363, 0.1333].into_iter().enumerate() {
            let [whole, structure] = similarity(&x, &y, 11, &weight, [1e-4, 9e-4], 1.0);
            product *= f64::max(if scale == 4 { whole } else { structure }, 0.0).powf(power);
            (x, y) = (x.halved(), y.halved());
        }
        product
    };
    (0..x.num_channels).map(of_channel).sum::<f64>() / x.num_channels as f64
}

/// A smooth pattern with noise; some values outside of `[0, 1]`, as unclamped renders have.
fn pattern(width: usize, height: usize, num_channels: usize, seed: u64) -> Image {
    let mut image = Image::filled(width, height, num_channels, 0.0);
    let mut state = seed;
    for (i, value) in image.data.iter_mut().enumerate() {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let noise = (state >> 40) as f32 / (1u64 << 24) as f32;
        let (x, y) = (i % width, i / width);
        *value = 0.5 + 0.4 * (x as f32 * 0.11 + y as f32 * 0.07).sin() + 0.3 * (noise - 0.5);
    }
    image
}

#[test]
fn ms_ssim_matches_the_oracle() {
    // Sides that are even, odd, and odd at some scales only.
    for (width, height) in [(161, 176), (190, 163)] {
        let (x, y) = (pattern(width, height, 2, 1), pattern(width, height, 2, 2));
        let (found, expected) = (ms_ssim(&x, &y).unwrap(), ms_ssim_oracle(&x, &y));
        assert!((found - expected).abs() < 2e-6, "{width}x{height}: {found} against {expected}");
        assert!((0.5..0.99).contains(&found), "a pair that says something: {found}");
    }
}

#[test]
fn ms_ssim_needs_161_pixels_and_counts_negative_means_as_nothing() {
    assert_eq!(MIN_MS_SSIM_SIDE, 161);
    let image = pattern(161, 160, 1, 3);
    assert_eq!(ms_ssim(&image, &image), None);
    let image = pattern(161, 161, 1, 3);
    let inverted = Image { data: image.data.iter().map(|v| 1.0 - v).collect(), ..image };
    assert_eq!(ms_ssim(&image, &inverted), Some(0.0));
    let broken = Image { data: image.data.iter().map(|_| f32::NAN).collect(), ..image };
    assert!(ms_ssim(&image, &broken).unwrap().is_nan(), "a broken image must not score");
}

#[test]
fn ssim_with_a_uniform_window_matches_the_oracle() {
    for (width, height, range) in [(7, 7, 1.0), (20, 13, 2.0)] {
        let (x, y) = (pattern(width, height, 3, 4), pattern(width, height, 3, 5));
        let c = [(0.01 * range) * (0.01 * range), (0.03 * range) * (0.03 * range)];
        let of = |channel| {
            similarity(&Plane::of(&x, channel), &Plane::of(&y, channel), 7, &|_, _| 1.0 / 49.0, c, 49.0 / 48.0)[0]
        };
        let expected = (0..3).map(of).sum::<f64>() / 3.0;
        let found = uniform_ssim(&x, &y, range).unwrap();
        assert!((found - expected).abs() < 1e-12, "{width}x{height}: {found} against {expected}");
    }
    let small = pattern(6, 30, 1, 6);
    assert_eq!(uniform_ssim(&small, &small, 1.0), None);
}
