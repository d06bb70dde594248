//! The input of training: a camera and its image.

use crate::{Camera, Image};

/// Which pixels show the foreground (what moves).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Segmentation {
    /// Pixels in a row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[H, W]`.
    pub foreground: Vec<bool>,
}

impl Segmentation {
    /// Majority over `factor` x `factor` pixels; a tie is foreground.
    pub fn downscaled(&self, factor: usize) -> Self {
        let (width, height) = (self.width / factor, self.height / factor);
        let foreground = (0..width * height)
            .map(|i| {
                let (x, y) = (i % width * factor, i / width * factor);
                let count: usize = (y..y + factor)
                    .map(|row| self.foreground[row * self.width + x..][..factor].iter().filter(|&&f| f).count())
                    .sum();
                2 * count >= factor * factor
            })
            .collect();
        Self { width, height, foreground }
    }
}

/// One image of a capture: camera, pixels, mask, time.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Where it was taken from. Its size equals the image's.
    pub camera: Camera,
    /// Three channels in `[0, 1]`.
    pub image: Image,
    /// The foreground, where the capture has masks.
    pub segmentation: Option<Segmentation>,
    /// Frame number in the capture.
    pub frame: usize,
    /// The capture's name of the camera.
    pub camera_id: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_shrinks_by_majority() {
        let mask =
            Segmentation { width: 4, height: 2, foreground: vec![true, false, true, false, false, true, false, false] };
        assert_eq!(mask.downscaled(2).foreground, [true, false]);
    }
}
