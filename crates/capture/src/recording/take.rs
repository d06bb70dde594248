//! The part of a recording that a capture uses: its beginning and rate, its turn and crop, its gains and offsets.

use std::sync::Arc;

use image::{RgbImage, imageops};

use super::Recording;
use crate::CaptureError;
use crate::lens::Crop;

/// A recording on the clock of its capture.
#[derive(Clone, Debug)]
pub struct Take {
    /// The recording.
    pub recording: Arc<Recording>,
    /// Clockwise, applied to the stored image.
    pub quarter_turns: u8,
    /// The used part of the turned image.
    pub active: Crop,
    /// Change of the colours.
    pub colors: ColorChange,
    /// The time in the recording at which the capture begins.
    pub start_secs: f64,
    /// Frames per second of the capture.
    pub fps: f64,
}

/// Change of a camera's colours to those of the others: `gain * value + offset`, channel by channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColorChange {
    /// Factors of red, green and blue, above 0.
    pub gains: [f32; 3],
    /// Added to red, green and blue, of values in `[0, 1]`.
    pub offsets: [f32; 3],
}

impl ColorChange {
    /// Colours as recorded.
    pub const NONE: Self = Self { gains: [1.0; 3], offsets: [0.0; 3] };

    /// Changes an image, rounding to 8 bits.
    fn apply(self, image: &mut RgbImage) {
        if self == Self::NONE {
            return;
        }
        let changed: [[u8; 256]; 3] = std::array::from_fn(|channel| {
            let (gain, offset) = (self.gains[channel], 255.0 * self.offsets[channel]);
            std::array::from_fn(|value| (value as f32 * gain + offset).round().clamp(0.0, 255.0) as u8)
        });
        for pixel in image.pixels_mut() {
            for (value, changed) in pixel.0.iter_mut().zip(&changed) {
                *value = changed[usize::from(*value)];
            }
        }
    }
}

/// Width and height after quarter turns.
pub fn turned((width, height): (usize, usize), quarter_turns: u8) -> (usize, usize) {
    if quarter_turns % 2 == 1 { (height, width) } else { (width, height) }
}

impl Take {
    /// The stored frame for a frame of the capture.
    pub fn stored_frame(&self, frame: usize) -> usize {
        self.recording.times.nearest(self.start_secs + frame as f64 / self.fps)
    }

    /// Decodes a frame of the capture.
    ///
    /// # Errors
    /// [`CaptureError`] if the frame cannot be decoded.
    pub fn image(&self, frame: usize) -> Result<RgbImage, CaptureError> {
        let stored = self.recording.frame(self.stored_frame(frame))?;
        let mut image = match self.quarter_turns {
            1 => imageops::rotate90(&stored),
            2 => imageops::rotate180(&stored),
            3 => imageops::rotate270(&stored),
            _ => stored,
        };
        let Crop { left, top, width, height } = self.active;
        if (width, height) != (image.width() as usize, image.height() as usize) {
            image = imageops::crop_imm(&image, left as u32, top as u32, width as u32, height as u32).to_image();
        }
        self.colors.apply(&mut image);
        Ok(image)
    }
}
