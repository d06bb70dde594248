//! Convolution with rectifier, and pooling: the only layers of the two networks.
//!
//! Features lie pixel by pixel, `[H, W, C]`, inside a margin of zeros. The window of a convolution over one row of an
//! image is then a run of `size * channels` values, and the windows of neighbouring pixels are overlapping runs. So one
//! row of the kernel is one matrix product over the features in place, without im2col. At the end of a row the runs
//! reach into the margin on both sides; their results are dropped.

use rayon::prelude::*;

use super::backbone::num_windows;
use super::gemm::gemm;

/// Pixels of a strip, at least: enough that packing the kernel costs little, few enough that strips feed many
/// cores and a strip's result stays in the cache. Strips do not depend on the number of threads.
const STRIP_PIXELS: usize = 1024;

/// Output of a layer.
#[derive(Clone, Debug)]
pub struct Features {
    pub height: usize,
    pub width: usize,
    pub channels: usize,
    /// Zeros around the image, as wide as the next layer's padding.
    pub margin: usize,
    /// `[H + 2 margin, W + 2 margin, C]`.
    pub data: Vec<f32>,
}

impl Features {
    /// Nothing but zeros.
    pub fn zeros(height: usize, width: usize, channels: usize, margin: usize) -> Self {
        let data = vec![0.0; (height + 2 * margin) * (width + 2 * margin) * channels];
        Self { height, width, channels, margin, data }
    }

    /// Values from one row to the next.
    fn row_len(&self) -> usize {
        (self.width + 2 * self.margin) * self.channels
    }

    /// One row without its margins, `[W, C]`.
    pub fn row(&self, row: usize) -> &[f32] {
        let start = (row + self.margin) * self.row_len() + self.margin * self.channels;
        &self.data[start..][..self.width * self.channels]
    }

    /// Rows without the margins above and below, to fill in place.
    fn rows_mut(&mut self) -> &mut [f32] {
        let row_len = self.row_len();
        &mut self.data[self.margin * row_len..][..self.height * row_len]
    }

    /// Fills every row without its margins: `fill(row, [W, C])`.
    pub fn fill(&mut self, fill: impl Fn(usize, &mut [f32]) + Sync) {
        let (start, len, row_len) = (self.margin * self.channels, self.width * self.channels, self.row_len());
        let rows = self.rows_mut().par_chunks_mut(row_len).enumerate();
        rows.for_each(|(row, values)| fill(row, &mut values[start..][..len]));
    }
}

/// A convolution.
#[derive(Clone, Debug)]
pub struct Convolution {
    /// Pixels on a side of the window.
    pub size: usize,
    pub stride: usize,
    pub padding: usize,
    pub in_channels: usize,
    pub out_channels: usize,
    /// `[size, size, in, out]`.
    pub kernel: Vec<f32>,
    /// `[out]`.
    pub bias: Vec<f32>,
}

impl Convolution {
    /// `max(0, kernel * input + bias)`.
    ///
    /// - `margin`: of the result
    ///
    /// # Panics
    /// If the input's channels or margin do not fit this convolution, or the input is smaller than the window.
    pub fn apply(&self, input: &Features, margin: usize) -> Features {
        let &Self { size, stride, padding, in_channels, out_channels, .. } = self;
        assert_eq!((input.channels, input.margin), (in_channels, padding), "channels and margin of the input");
        let side =
            |side: usize| num_windows(side + 2 * padding, size, stride).expect("an image as large as the window");
        let (height, width) = (side(input.height), side(input.width));
        let mut output = Features::zeros(height, width, out_channels, margin);
        // With a stride the rows of windows do not follow one another: each is a strip.
        let windows_per_row = input.row_len() / in_channels;
        let rows_per_strip = if stride == 1 { STRIP_PIXELS.div_ceil(windows_per_row) } else { 1 };
        let (start, row_len) = (margin * out_channels, output.row_len());
        output.rows_mut().par_chunks_mut(rows_per_strip * row_len).enumerate().for_each(|(strip, rows)| {
            let first_row = strip * rows_per_strip;
            // The last row ends with its last pixel: no window lies beyond the input.
            let num_windows = (rows.len() / row_len - 1) * windows_per_row + width;
            let mut sums = vec![0.0; num_windows * out_channels];
            let shape = [num_windows, size * in_channels, out_channels];
            for (dy, kernel) in self.kernel.chunks_exact(size * in_channels * out_channels).enumerate() {
                let windows = &input.data[(first_row * stride + dy) * input.row_len()..];
                gemm(shape, windows, stride * in_channels, kernel, &mut sums, dy > 0);
            }
            let sums = sums.chunks(windows_per_row * out_channels);
            for (row, sums) in rows.chunks_exact_mut(row_len).zip(sums) {
                let pixels = row[start..][..width * out_channels].chunks_exact_mut(out_channels);
                for (pixel, sums) in pixels.zip(sums.chunks_exact(out_channels)) {
                    for i in 0..out_channels {
                        pixel[i] = (sums[i] + self.bias[i]).max(0.0);
                    }
                }
            }
        });
        output
    }
}

/// The largest value of each channel in windows of `size`, every `stride` pixels; a partial window is dropped.
///
/// - `margin`: of the result
///
/// # Panics
/// If the input is smaller than a window.
pub fn max_pool(input: &Features, size: usize, stride: usize, margin: usize) -> Features {
    let side = |side: usize| num_windows(side, size, stride).expect("an image as large as the window");
    let channels = input.channels;
    let mut output = Features::zeros(side(input.height), side(input.width), channels, margin);
    output.fill(|row, values| {
        values.fill(f32::NEG_INFINITY);
        for dy in 0..size {
            let source = input.row(row * stride + dy);
            for (x, pixel) in values.chunks_exact_mut(channels).enumerate() {
                for source in source[x * stride * channels..][..size * channels].chunks_exact(channels) {
                    for i in 0..channels {
                        pixel[i] = pixel[i].max(source[i]);
                    }
                }
            }
        }
    });
    output
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values in -1 to 1 without a pattern.
    fn noise(len: usize, seed: u64) -> Vec<f32> {
        let mut state = seed;
        (0..len)
            .map(|_| {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
            })
            .collect()
    }

    fn features(height: usize, width: usize, channels: usize, margin: usize) -> Features {
        let values = noise(height * width * channels, 1);
        let mut features = Features::zeros(height, width, channels, margin);
        features.fill(|row, out| out.copy_from_slice(&values[row * width * channels..][..width * channels]));
        features
    }

    /// A value of the input; zero beyond it.
    fn at(input: &Features, y: isize, x: isize, channel: usize) -> f64 {
        let inside = (0..input.height as isize).contains(&y) && (0..input.width as isize).contains(&x);
        if inside { f64::from(input.row(y as usize)[x as usize * input.channels + channel]) } else { 0.0 }
    }

    #[test]
    fn convolutions_match_their_definition() {
        // Window, stride and padding of every layer of the two networks, at sizes around a strip's.
        let cases = [(3, 1, 1, 5, 7), (3, 1, 1, 70, 40), (5, 1, 2, 9, 6), (11, 4, 2, 33, 46), (11, 4, 2, 31, 31)];
        for (size, stride, padding, height, width) in cases {
            let (in_channels, out_channels) = (3, 4);
            let input = features(height, width, in_channels, padding);
            let kernel = noise(size * size * in_channels * out_channels, 2);
            let layer = Convolution {
                size,
                stride,
                padding,
                in_channels,
                out_channels,
                kernel: kernel.clone(),
                bias: noise(out_channels, 3),
            };
            let output = layer.apply(&input, 1);
            assert_eq!(output.height, (height + 2 * padding - size) / stride + 1);
            assert_eq!(output.width, (width + 2 * padding - size) / stride + 1);
            for (y, x) in (0..output.height).flat_map(|y| (0..output.width).map(move |x| (y, x))) {
                for channel in 0..out_channels {
                    let mut sum = f64::from(layer.bias[channel]);
                    for (i, &weight) in kernel.iter().skip(channel).step_by(out_channels).enumerate() {
                        let (dy, dx) = (i / in_channels / size, i / in_channels % size);
                        let (y, x) = ((y * stride + dy) as isize, (x * stride + dx) as isize);
                        let (y, x) = (y - padding as isize, x - padding as isize);
                        sum += f64::from(weight) * at(&input, y, x, i % in_channels);
                    }
                    let found = output.row(y)[x * out_channels + channel];
                    assert!(
                        (f64::from(found) - sum.max(0.0)).abs() < 1e-5,
                        "window {size} at {y}, {x}: {found}, {sum}"
                    );
                }
            }
            let inside: f64 = (0..output.height).flat_map(|y| output.row(y)).map(|&v| f64::from(v)).sum();
            let all: f64 = output.data.iter().map(|&v| f64::from(v)).sum();
            assert!((all - inside).abs() < 1e-9, "the margin holds zeros");
        }
    }

    #[test]
    fn pooling_takes_the_largest_and_drops_what_is_left_over() {
        let input = features(8, 7, 2, 1);
        for (size, stride, height, width) in [(2, 2, 4, 3), (3, 2, 3, 3)] {
            let output = max_pool(&input, size, stride, 1);
            assert_eq!((output.height, output.width), (height, width));
            for (y, x, channel) in (0..height).flat_map(|y| (0..width).flat_map(move |x| [(y, x, 0), (y, x, 1)])) {
                let window = (0..size).flat_map(|dy| (0..size).map(move |dx| (y * stride + dy, x * stride + dx)));
                let values = window.map(|(y, x)| at(&input, y as isize, x as isize, channel));
                assert_eq!(f64::from(output.row(y)[x * 2 + channel]), values.fold(f64::MIN, f64::max));
            }
        }
    }
}
