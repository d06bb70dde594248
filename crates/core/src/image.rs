//! Images of any number of channels.

use std::ops::Range;

/// An image, one plane after another: `[C, H, W]`, rows from the top.
///
/// Planes rather than interleaved pixels, since every kernel here runs along pixels of one channel.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Planes.
    pub num_channels: usize,
    /// `[C, H, W]`.
    pub data: Vec<f32>,
}

impl Image {
    /// An image of one value.
    pub fn filled(width: usize, height: usize, num_channels: usize, value: f32) -> Self {
        Self { width, height, num_channels, data: vec![value; width * height * num_channels] }
    }

    /// `[C, H, W]`, the numbers of channels, rows and columns.
    pub fn shape(&self) -> [usize; 3] {
        [self.num_channels, self.height, self.width]
    }

    /// Makes this an image of zeros if it has another shape than `[C, H, W]`; otherwise keeps its values.
    pub fn ensure_shape(&mut self, shape: [usize; 3]) {
        if self.shape() != shape {
            let [num_channels, height, width] = shape;
            *self = Self::filled(width, height, num_channels, 0.0);
        }
    }

    /// `W * H`.
    pub fn num_pixels(&self) -> usize {
        self.width * self.height
    }

    /// A copy of some pixels, of all channels.
    ///
    /// # Panics
    /// If `columns` or `rows` reach beyond the image.
    pub fn crop(&self, columns: Range<usize>, rows: Range<usize>) -> Self {
        let mut data = Vec::with_capacity(columns.len() * rows.len() * self.num_channels);
        for channel in 0..self.num_channels {
            let plane = self.plane(channel);
            for row in rows.clone() {
                data.extend_from_slice(&plane[row * self.width..][..self.width][columns.clone()]);
            }
        }
        Self { width: columns.len(), height: rows.len(), num_channels: self.num_channels, data }
    }

    /// One channel, `[H, W]`.
    pub fn plane(&self, channel: usize) -> &[f32] {
        let n = self.num_pixels();
        &self.data[channel * n..(channel + 1) * n]
    }

    /// One channel, `[H, W]`, to change in place.
    pub fn plane_mut(&mut self, channel: usize) -> &mut [f32] {
        let n = self.num_pixels();
        &mut self.data[channel * n..(channel + 1) * n]
    }

    /// From interleaved 8-bit RGB, `[H, W, 3]`; 255 becomes 1.
    ///
    /// # Panics
    /// If `bytes` has another length than `3 * width * height`.
    pub fn from_rgb8(width: usize, height: usize, bytes: &[u8]) -> Self {
        assert_eq!(bytes.len(), 3 * width * height, "{} bytes for {width}x{height} RGB", bytes.len());
        let mut image = Self::filled(width, height, 3, 0.0);
        for channel in 0..3 {
            for (value, pixel) in image.plane_mut(channel).iter_mut().zip(bytes.chunks_exact(3)) {
                *value = f32::from(pixel[channel]) / 255.0;
            }
        }
        image
    }

    /// To interleaved 8-bit RGB, `[H, W, 3]`: clamped to `[0, 1]`, rounded. Uses the first three channels.
    ///
    /// ```
    /// let image = tcgs_core::Image::filled(2, 1, 3, 0.5);
    /// assert_eq!(image.to_rgb8(), [128; 6]);
    /// ```
    ///
    /// # Panics
    /// If there are fewer than three channels.
    pub fn to_rgb8(&self) -> Vec<u8> {
        let planes = [self.plane(0), self.plane(1), self.plane(2)];
        (0..self.num_pixels())
            .flat_map(|p| planes.map(|plane| (plane[p].clamp(0.0, 1.0) * 255.0).round() as u8))
            .collect()
    }

    /// Area average over `factor` x `factor` pixels; what does not fill a block at the right and
    /// lower edge is dropped, as [`crate::Camera::downscaled`] does.
    pub fn downscaled(&self, factor: usize) -> Self {
        let mut out = Self::filled(self.width / factor, self.height / factor, self.num_channels, 0.0);
        let weight = 1.0 / (factor * factor) as f32;
        for channel in 0..self.num_channels {
            let source = self.plane(channel);
            let width = out.width.max(1);
            for (y, values) in out.plane_mut(channel).chunks_exact_mut(width).enumerate() {
                for (x, value) in values.iter_mut().enumerate() {
                    let row = |row: usize| source[row * self.width + x * factor..][..factor].iter().sum::<f32>();
                    *value = (y * factor..(y + 1) * factor).map(row).sum::<f32>() * weight;
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_survive_the_round_trip() {
        let bytes: Vec<u8> = (0..3 * 4 * 2).map(|i| (i * 10) as u8).collect();
        assert_eq!(Image::from_rgb8(4, 2, &bytes).to_rgb8(), bytes);
    }

    #[test]
    fn an_image_of_the_wanted_shape_keeps_its_values() {
        let mut image = Image::filled(4, 3, 2, 0.5);
        image.ensure_shape([2, 3, 4]);
        assert_eq!(image, Image::filled(4, 3, 2, 0.5));
        image.ensure_shape([3, 2, 4]);
        assert_eq!(image, Image::filled(4, 2, 3, 0.0));
    }

    #[test]
    fn a_crop_holds_its_pixels_of_all_channels() {
        let mut image = Image::filled(4, 3, 2, 0.0);
        image.data.iter_mut().enumerate().for_each(|(i, value)| *value = i as f32);
        let crop = image.crop(1..3, 2..3);
        assert_eq!((crop.width, crop.height, &crop.data[..]), (2, 1, &[9.0, 10.0, 21.0, 22.0][..]));
    }

    #[test]
    fn downscaling_averages_blocks_and_drops_the_rest() {
        let mut image = Image::filled(5, 4, 1, 0.0);
        for (i, v) in image.data.iter_mut().enumerate() {
            *v = i as f32;
        }
        let small = image.downscaled(2);
        assert_eq!((small.width, small.height), (2, 2));
        assert_eq!(small.data[0], (0.0 + 1.0 + 5.0 + 6.0) / 4.0);
        assert_eq!(small.data[3], (12.0 + 13.0 + 17.0 + 18.0) / 4.0);
    }
}
