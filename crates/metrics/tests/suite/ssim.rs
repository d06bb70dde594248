//! SSIM and its gradient against a naive two-dimensional oracle in `f64`.

use tcgs_core::Image;
use tcgs_metrics::{ssim, ssim_bwd, ssim_fwd};

/// A channel's mean, straight from the definition. Shares nothing with the crate.
fn oracle(width: i64, height: i64, x: &[f64], y: &[f64]) -> f64 {
    let gauss = |dx: i64, dy: i64| (-((dx * dx + dy * dy) as f64) / 4.5).exp();
    let window: Vec<(i64, i64)> = (-5..=5).flat_map(|dy| (-5..=5).map(move |dx| (dx, dy))).collect();
    let total: f64 = window.iter().map(|&(dx, dy)| gauss(dx, dy)).sum();
    let mut sum = 0.0;
    for row in 0..height {
        for column in 0..width {
            let mean = |f: &dyn Fn(usize) -> f64| -> f64 {
                let inside = window
                    .iter()
                    .filter(|(dx, dy)| (0..width).contains(&(column + dx)) && (0..height).contains(&(row + dy)));
                inside.map(|&(dx, dy)| gauss(dx, dy) / total * f(((row + dy) * width + column + dx) as usize)).sum()
            };
            let (mx, my) = (mean(&|i| x[i]), mean(&|i| y[i]));
            let (vx, vy) = (mean(&|i| x[i] * x[i]) - mx * mx, mean(&|i| y[i] * y[i]) - my * my);
            let covariance = mean(&|i| x[i] * y[i]) - mx * my;
            sum += (2.0 * mx * my + 1e-4) * (2.0 * covariance + 9e-4) / ((mx * mx + my * my + 1e-4) * (vx + vy + 9e-4));
        }
    }
    sum / (width * height) as f64
}

/// A smooth pattern with noise; some values outside of `[0, 1]`, as unclamped renders have.
fn pattern(width: usize, height: usize, num_channels: usize, seed: u64) -> Image {
    let mut image = Image::filled(width, height, num_channels, 0.0);
    let mut state = seed;
    for (i, value) in image.data.iter_mut().enumerate() {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let noise = (state >> 40) as f32 / (1u64 << 24) as f32;
        let (x, y) = (i % width, i / width);
        *value = 0.5 + 0.4 * (x as f32 * 0.4 + y as f32 * 0.3).sin() + 0.3 * (noise - 0.5);
    }
    image
}

fn as_f64(plane: &[f32]) -> Vec<f64> {
    plane.iter().map(|&v| f64::from(v)).collect()
}

#[test]
fn ssim_matches_the_oracle_at_every_size() {
    // Smaller than the window, wider than a vector, and taller than a strip of rows.
    for (width, height) in [(1, 1), (3, 2), (10, 4), (11, 11), (17, 33), (40, 70)] {
        let (x, y) = (pattern(width, height, 2, 1), pattern(width, height, 2, 2));
        let found = ssim_fwd(&x, &y).0;
        for (channel, found) in found.iter().enumerate() {
            let (px, py) = (as_f64(x.plane(channel)), as_f64(y.plane(channel)));
            let expected = oracle(width as i64, height as i64, &px, &py);
            assert!((found - expected).abs() < 2e-6, "{width}x{height} channel {channel}: {found} against {expected}");
        }
        assert!((ssim(&x, &y) - found.iter().sum::<f64>() / 2.0).abs() < 1e-15);
    }
}

#[test]
fn the_gradient_matches_central_differences_of_the_oracle() {
    for (width, height) in [(13, 12), (6, 3), (2, 37)] {
        let (x, y) = (pattern(width, height, 2, 3), pattern(width, height, 2, 4));
        let v_ssim = [0.7, -1.3];
        let mut found = Image::filled(width, height, 2, 0.0);
        ssim_bwd(&x, &y, &ssim_fwd(&x, &y).1, &v_ssim, &mut found);
        let (mut error, mut norm) = (0.0, 0.0);
        for (channel, v_channel) in v_ssim.into_iter().enumerate() {
            let (px, py) = (as_f64(x.plane(channel)), as_f64(y.plane(channel)));
            for (i, &gradient) in found.plane(channel).iter().enumerate() {
                let at = |d: f64| {
                    let mut moved = px.clone();
                    moved[i] += d;
                    oracle(width as i64, height as i64, &moved, &py)
                };
                let h = 1e-5;
                let difference = f64::from(v_channel) * (at(h) - at(-h)) / (2.0 * h);
                error += (f64::from(gradient) - difference).powi(2);
                norm += difference * difference;
            }
        }
        let relative = (error / norm).sqrt();
        assert!(relative < 2e-5, "{width}x{height}: relative error {relative}");
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let (x, y) = (pattern(70, 90, 5, 5), pattern(70, 90, 5, 6));
    let run = |num_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().unwrap();
        pool.install(|| {
            let (means, saved) = ssim_fwd(&x, &y);
            let mut v = Image::filled(70, 90, 5, 0.0);
            ssim_bwd(&x, &y, &saved, &[1.0; 5], &mut v);
            (means, v)
        })
    };
    assert_eq!(run(1), run(5));
}
