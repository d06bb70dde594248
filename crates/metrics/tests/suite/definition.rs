//! SSIM and MS-SSIM against their definitions: windows summed pixel by pixel in `f64`, gradients by central
//! differences.

use tcgs_core::Image;
use tcgs_metrics::{SSIM_C1, SSIM_C2, SSIM_RADIUS, ms_ssim, ssim, ssim_grad};

/// One channel of a picture.
#[derive(Clone)]
struct Plane {
    width: usize,
    height: usize,
    data: Vec<f64>,
}

impl Plane {
    /// Zero beyond the edge.
    fn at(&self, x: isize, y: isize) -> f64 {
        let is_inside = (0..self.width as isize).contains(&x) && (0..self.height as isize).contains(&y);
        if is_inside { self.data[y as usize * self.width + x as usize] } else { 0.0 }
    }
}

/// Waves of three lengths and a step, others for each seed.
fn picture(width: usize, height: usize, num_channels: usize, seed: f32) -> Image {
    let mut image = Image::filled(width, height, num_channels, 0.0);
    for channel in 0..num_channels {
        for (i, value) in image.plane_mut(channel).iter_mut().enumerate() {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            let waves = (0.9 * x + seed).sin() + (0.31 * y - seed * channel as f32).cos() + (0.05 * x * y).sin();
            let step = if x > seed * 7.0 + channel as f32 { 0.25 } else { 0.0 };
            *value = 0.4 + 0.1 * waves + step;
        }
    }
    image
}

fn planes(image: &Image) -> Vec<Plane> {
    let plane = |channel| image.plane(channel).iter().map(|&v| f64::from(v)).collect();
    let (width, height) = (image.width, image.height);
    (0..image.num_channels).map(|channel| Plane { width, height, data: plane(channel) }).collect()
}

/// Wang, Bovik, Sheikh & Simoncelli 2004, equations 12 to 15, with a Gaussian window of standard deviation 1.5.
///
/// - returns: `[ssim, contrast and structure]` at a pixel
fn at_pixel(a: &Plane, b: &Plane, x: usize, y: usize) -> [f64; 2] {
    let reach = SSIM_RADIUS as isize;
    let [mut weights, mut mean_a, mut mean_b, mut aa, mut bb, mut ab] = [0.0; 6];
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            let weight = (-((dx * dx + dy * dy) as f64) / (2.0 * 1.5 * 1.5)).exp();
            let (u, v) = (a.at(x as isize + dx, y as isize + dy), b.at(x as isize + dx, y as isize + dy));
            weights += weight;
            mean_a += weight * u;
            mean_b += weight * v;
            aa += weight * u * u;
            bb += weight * v * v;
            ab += weight * u * v;
        }
    }
    let [mean_a, mean_b, aa, bb, ab] = [mean_a, mean_b, aa, bb, ab].map(|sum| sum / weights);
    let (var_a, var_b, cov) = (aa - mean_a * mean_a, bb - mean_b * mean_b, ab - mean_a * mean_b);
    let (c1, c2) = (f64::from(SSIM_C1), f64::from(SSIM_C2));
    let structure = (2.0 * cov + c2) / (var_a + var_b + c2);
    [(2.0 * mean_a * mean_b + c1) / (mean_a * mean_a + mean_b * mean_b + c1) * structure, structure]
}

/// Mean over the pixels that are at least `margin` from the edge.
fn mean(a: &Plane, b: &Plane, margin: usize, which: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for y in margin..a.height - margin {
        for x in margin..a.width - margin {
            sum += at_pixel(a, b, x, y)[which];
            count += 1;
        }
    }
    sum / f64::from(count)
}

#[test]
fn ssim_is_the_mean_over_pixels_then_channels() {
    for (width, height) in [(37, 23), (11, 40), (5, 4)] {
        let (rendered, target) = (picture(width, height, 3, 0.3), picture(width, height, 3, 2.2));
        let pairs = planes(&rendered).into_iter().zip(planes(&target));
        let expected = pairs.map(|(a, b)| mean(&a, &b, 0, 0)).sum::<f64>() / 3.0;
        let found = ssim(&rendered, &target);
        assert!((found - expected).abs() < 1e-6, "{width}x{height}: {found}, expected {expected}");
        assert!(expected < 0.9, "the pictures have to differ");
    }
}

#[test]
fn the_gradient_of_ssim_is_that_of_its_definition() {
    let (rendered, target) = (picture(19, 14, 2, 0.3), picture(19, 14, 2, 1.1));
    let v_ssim = [0.7, -1.3];
    let mut v_rendered = Image::filled(19, 14, 2, 0.0);
    ssim_grad(&rendered, &target, &v_ssim, &mut v_rendered);
    let (rendered, target) = (planes(&rendered), planes(&target));
    let (mut off, mut size) = (0.0, 0.0);
    for (channel, weight) in v_ssim.into_iter().enumerate() {
        for pixel in 0..19 * 14 {
            let moved = |by: f64| {
                let mut plane = rendered[channel].clone();
                plane.data[pixel] += by;
                mean(&plane, &target[channel], 0, 0)
            };
            let expected = f64::from(weight) * (moved(1e-5) - moved(-1e-5)) / 2e-5;
            off += (f64::from(v_rendered.plane(channel)[pixel]) - expected).powi(2);
            size += expected * expected;
        }
    }
    assert!((off / size).sqrt() < 1e-4, "relative L2 {}", (off / size).sqrt());
}

#[test]
fn ms_ssim_multiplies_five_scales() {
    let (rendered, target) = (picture(163, 176, 2, 0.3), picture(163, 176, 2, 0.9));
    let halved = |plane: Plane| {
        // A row or column of zeros before an odd side.
        let (pad_x, pad_y) = (plane.width % 2, plane.height % 2);
        let (width, height) = (plane.width.div_ceil(2), plane.height.div_ceil(2));
        let value = |i: usize| {
            let (x, y) = ((2 * (i % width)) as isize - pad_x as isize, (2 * (i / width)) as isize - pad_y as isize);
            (plane.at(x, y) + plane.at(x + 1, y) + plane.at(x, y + 1) + plane.at(x + 1, y + 1)) / 4.0
        };
        Plane { width, height, data: (0..width * height).map(value).collect() }
    };
    let of_channel = |(mut a, mut b): (Plane, Plane)| {
        let mut product = 1.0;
        for (scale, weight) in [0.0448, 0.2856, 0.3001, 0.2363, 0.1333].into_iter().enumerate() {
            product *= mean(&a, &b, 5, usize::from(scale < 4)).max(0.0).powf(weight);
            (a, b) = (halved(a), halved(b));
        }
        product
    };
    let expected = planes(&rendered).into_iter().zip(planes(&target)).map(of_channel).sum::<f64>() / 2.0;
    let found = ms_ssim(&rendered, &target).unwrap();
    assert!((found - expected).abs() < 1e-5, "{found}, expected {expected}");
    assert!(expected < 0.99, "the pictures have to differ");
}
