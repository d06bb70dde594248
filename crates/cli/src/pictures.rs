//! Parts of a capture that several commands show: its description, and images inside a page.

use std::path::Path;

use anyhow::Context;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::{ExtendedColorType, RgbImage, codecs::jpeg::JpegEncoder};
use tcgs_capture::{Capture, CaptureDescription, CaptureKind, DESCRIPTION_FILE};
use tcgs_core::Image;

const JPEG_QUALITY: u8 = 85;

/// Reads `capture.toml` if the capture has one.
pub fn description(path: &Path, capture: &Capture) -> anyhow::Result<Option<CaptureDescription>> {
    let is_described = capture.kind() == CaptureKind::DESCRIBED;
    Ok(is_described.then(|| CaptureDescription::read(&path.join(DESCRIPTION_FILE))).transpose()?)
}

/// Encodes an image as a JPEG data URI.
pub fn jpeg_uri(image: &Image) -> anyhow::Result<String> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
        .encode(&image.to_rgb8(), image.width as u32, image.height as u32, ExtendedColorType::Rgb8)
        .context("encoding an image")?;
    Ok(format!("data:image/jpeg;base64,{}", BASE64_STANDARD.encode(bytes)))
}

/// Both images side by side with a white line between them.
pub fn side_by_side(left: &Image, right: &Image) -> RgbImage {
    let (width, height) = (left.width, left.height);
    let (left, right) = (left.to_rgb8(), right.to_rgb8());
    RgbImage::from_fn(2 * width as u32 + 2, height as u32, |x, y| {
        let (x, y) = (x as usize, y as usize);
        let (source, x) = match x {
            x if x < width => (&left, x),
            x if x < width + 2 => return image::Rgb([255; 3]),
            x => (&right, x - width - 2),
        };
        let at = 3 * (y * width + x);
        image::Rgb([source[at], source[at + 1], source[at + 2]])
    })
}
