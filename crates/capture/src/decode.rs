//! Image files to pixels.

use std::io::{BufReader, Cursor};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, RgbImage};
use tcgs_core::{Segmentation, open_file};

use crate::{CaptureError, files};

/// Decodes an image of the size that the capture says. Transparent pixels are blended onto black.
pub(crate) fn image(path: &Path, size: (usize, usize)) -> Result<RgbImage, CaptureError> {
    let decoded = decode(path, size)?;
    if !decoded.color().has_alpha() {
        return Ok(decoded.into_rgb8());
    }
    let rgba = decoded.into_rgba8();
    Ok(RgbImage::from_fn(rgba.width(), rgba.height(), |x, y| {
        let [r, g, b, alpha] = rgba.get_pixel(x, y).0;
        image::Rgb([r, g, b].map(|c| ((u16::from(c) * u16::from(alpha) + 127) / 255) as u8))
    }))
}

/// Decodes an image whose PNG file may be cut short. Missing rows come from the frame before.
///
/// - `before`: the same camera a frame earlier
pub(crate) fn cut_image(path: &Path, before: &Path, size: (usize, usize)) -> Result<RgbImage, CaptureError> {
    if let Ok(whole) = image(path, size) {
        return Ok(whole);
    }
    let mut mended = image(before, size)?;
    let damaged = |error: png::DecodingError| CaptureError::invalid(path, format!("cannot be decoded: {error}"));
    let file = open_file(path).map_err(|error| CaptureError::Io { path: path.into(), error })?;
    let mut decoder = png::Decoder::new(BufReader::new(file));
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(damaged)?;
    let (found, color) = ((reader.info().width as usize, reader.info().height as usize), reader.output_color_type());
    let channels = color.0.samples();
    if found != size || channels < 3 || reader.info().interlaced {
        let problem =
            format!("is {}x{} pixels, {:?}, expected {}x{} in RGB", found.0, found.1, color.0, size.0, size.1);
        return Err(CaptureError::invalid(path, problem));
    }
    for out in mended.rows_mut() {
        let Ok(Some(row)) = reader.next_row() else { break };
        for (out, pixel) in out.zip(row.data().chunks_exact(channels)) {
            out.0.copy_from_slice(&pixel[..3]);
        }
    }
    Ok(mended)
}

/// Width and height, without decoding more.
pub(crate) fn size(path: &Path) -> Result<(usize, usize), CaptureError> {
    let io = |error| CaptureError::Io { path: path.into(), error };
    let reader = ImageReader::new(BufReader::new(open_file(path).map_err(io)?)).with_guessed_format().map_err(io)?;
    let (width, height) = reader.into_dimensions().map_err(|error| match error {
        image::ImageError::IoError(error) => io(error),
        other => damaged(path, &other),
    })?;
    Ok((width as usize, height as usize))
}

fn damaged(path: &Path, error: &image::ImageError) -> CaptureError {
    // Decoders' messages may have several lines.
    let reason = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    CaptureError::invalid(path, format!("cannot be decoded: {reason}"))
}

/// Decodes a mask: every pixel that is not black is foreground, whether 1 or 255.
pub(crate) fn mask(path: &Path, size: (usize, usize)) -> Result<Segmentation, CaptureError> {
    let foreground = match decode(path, size)? {
        DynamicImage::ImageLuma8(gray) => gray.as_raw().iter().map(|&v| v != 0).collect(),
        // Palettes are decoded to colours. Opacity has no meaning in masks. Eight bits would lose the smallest 16-bit
        // values.
        other => other.into_rgb16().pixels().map(|pixel| pixel.0 != [0; 3]).collect(),
    };
    Ok(Segmentation { width: size.0, height: size.1, foreground })
}

fn decode(path: &Path, (width, height): (usize, usize)) -> Result<DynamicImage, CaptureError> {
    let io = |error| CaptureError::Io { path: path.into(), error };
    let damaged = |error: image::ImageError| damaged(path, &error);
    let bytes = files::bytes(path)?;
    let reader = ImageReader::new(Cursor::new(&bytes)).with_guessed_format().map_err(io)?;
    let format = reader.format();
    let decoder = reader.into_decoder().map_err(damaged)?;
    let (found_width, found_height) = decoder.dimensions();
    if (found_width as usize, found_height as usize) != (width, height) {
        let problem = format!("is {found_width}x{found_height} pixels, expected {width}x{height} as its camera has");
        return Err(CaptureError::invalid(path, problem));
    }
    if format == Some(ImageFormat::Jpeg) && !jpeg_is_whole(&bytes) {
        return Err(CaptureError::invalid(path, "ends before its end-of-image marker, expected a whole JPEG file"));
    }
    DynamicImage::from_decoder(decoder).map_err(damaged)
}

/// Whether a JPEG file reaches its end-of-image marker. The decoder fills missing parts with grey, without an error.
///
/// ITU-T T.81, B.1.1: segments with a length, and after a start of scan coded data in which 0xFF is
/// followed by 0 or a restart marker only.
fn jpeg_is_whole(bytes: &[u8]) -> bool {
    const END_OF_IMAGE: u8 = 0xd9;
    const START_OF_SCAN: u8 = 0xda;
    let mut rest = bytes.get(2..).unwrap_or_default();
    let mut in_scan = false;
    loop {
        match rest {
            [0xff, 0xff, ..] => rest = &rest[1..], // fill byte
            [0xff, 0x00 | 0xd0..=0xd7, ..] if in_scan => rest = &rest[2..],
            [0xff, END_OF_IMAGE, ..] => return true,
            [0xff, marker, high, low, ..] => {
                in_scan = *marker == START_OF_SCAN;
                let length = usize::from(u16::from_be_bytes([*high, *low]));
                rest = rest.get(2 + length..).unwrap_or_default();
            }
            [_, after @ ..] => rest = after, // coded data, or bytes between segments
            [] => return false,
        }
    }
}
