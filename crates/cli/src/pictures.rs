//! What several commands show of a capture: its description, and images inside a page.

use std::path::Path;

use anyhow::Context;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::{ExtendedColorType, codecs::jpeg::JpegEncoder};
use tcgs_capture::{Capture, CaptureDescription, CaptureKind, DESCRIPTION_FILE};
use tcgs_core::Image;

const JPEG_QUALITY: u8 = 85;

/// What `capture.toml` says, of a capture that has one.
pub fn description(path: &Path, capture: &Capture) -> anyhow::Result<Option<CaptureDescription>> {
    let is_described = capture.kind() == CaptureKind::DESCRIBED;
    Ok(is_described.then(|| CaptureDescription::read(&path.join(DESCRIPTION_FILE))).transpose()?)
}

/// An image as a JPEG inside an address.
pub fn jpeg_uri(image: &Image) -> anyhow::Result<String> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY)
        .encode(&image.to_rgb8(), image.width as u32, image.height as u32, ExtendedColorType::Rgb8)
        .context("encoding an image")?;
    Ok(format!("data:image/jpeg;base64,{}", BASE64_STANDARD.encode(bytes)))
}
