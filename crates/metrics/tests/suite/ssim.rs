//! SSIM and its gradient against a naive two-dimensional oracle in `f64`.

use std::ops::Range;

use tcgs_core::Image;
use tcgs_metrics::{ImagePair, ssim, ssim_grad};

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
        let found = ssim_grad(&x, &y, &[1.0; 2], &mut x.clone());
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
        ssim_grad(&x, &y, &v_ssim, &mut found);
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
fn a_part_of_the_gradient_has_the_bits_of_the_whole() {
    let (width, height) = (150, 90);
    let (x, y) = (pattern(width, height, 2, 7), pattern(width, height, 2, 8));
    let of = |[columns, rows]: [Range<usize>; 2]| {
        let mut v = vec![f32::NAN; 2 * columns.len() * rows.len()];
        let part = [columns, rows];
        let (means, rows) =
            ImagePair::new(&x, &y).ssim_grad(&[0.7, -1.3], part, &mut v, |channel, row, _| (channel, row));
        (means, rows, v)
    };
    let (means, _, whole) = of([0..width, 0..height]);
    // Within a strip of rows, across strips, a single row of one, both edges, and nothing.
    for part in [[3..141, 40..58], [0..1, 31..33], [20..30, 63..65], [149..150, 0..90], [5..150, 89..90], [9..20, 7..7]]
    {
        let (part_means, part_rows, found) = of(part.clone());
        let [columns, rows] = part;
        assert_eq!(part_means, means);
        let numbered = (0..2).flat_map(|channel| (0..rows.len()).map(move |row| (channel, row)));
        assert_eq!(part_rows, numbered.collect::<Vec<_>>());
        let planes = whole.chunks(width * height);
        let lines = planes.flat_map(|plane| plane.chunks(width).skip(rows.start).take(rows.len()));
        let expected: Vec<f32> = lines.flat_map(|line| &line[columns.clone()]).copied().collect();
        assert_eq!(found, expected, "columns {columns:?}, rows {rows:?}");
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let (x, y) = (pattern(70, 90, 5, 5), pattern(70, 90, 5, 6));
    let run = |num_threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(num_threads).build().unwrap();
        pool.install(|| {
            let mut v = Image::filled(70, 90, 5, 0.0);
            (ssim_grad(&x, &y, &[1.0; 5], &mut v), v)
        })
    };
    assert_eq!(run(1), run(5));
}
