//! Parts of captures and pages that several commands show.

use std::ops::Range;
use std::path::Path;

use anyhow::Context;
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::{ExtendedColorType, RgbImage, codecs::jpeg::JpegEncoder};
use tcgs_capture::{Capture, CaptureDescription, CaptureKind, DESCRIPTION_FILE};
use tcgs_core::Image;
use tcgs_pipeline::{Evaluation, ImageScore};
use tcgs_report::Series;

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

/// Mean of a metric at each timestep.
pub fn series(name: &str, evaluation: &Evaluation, metric: impl Fn(&ImageScore) -> Option<f64>) -> Series {
    let timesteps = evaluation.images.iter().map(|i| i.timestep + 1).max().unwrap_or(0);
    let at = |t| ImageScore::mean(evaluation.images.iter().filter(|i| i.timestep == t), &metric);
    Series { name: name.into(), values: (0..timesteps).map(|t| at(t).unwrap_or(f64::NAN)).collect() }
}

/// Frames spread evenly, the first and the last among them.
///
/// - `count`: 2 or more
pub fn spread(frames: &Range<usize>, count: usize) -> Vec<usize> {
    let last = frames.len().saturating_sub(1);
    (0..count).map(|i| frames.start + i * last / (count - 1)).collect()
}

/// An image for encoders.
pub fn rgb(image: &Image) -> RgbImage {
    RgbImage::from_raw(image.width as u32, image.height as u32, image.to_rgb8()).expect("three bytes a pixel")
}
