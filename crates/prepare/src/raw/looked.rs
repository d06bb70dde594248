//! A first look at a recording: whether it shows anything, and whether black bars frame the picture.

use image::RgbImage;
use tcgs_capture::{Crop, Recording};

use crate::PrepareError;

/// Number of frames that are decoded, spread over the recording.
const NUM_FRAMES: usize = 3;
/// Mean of the channels up to which a row or column is black. Codecs leave some noise in bars.
const BLACK: f64 = 24.0;

/// The result of the first look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Looked {
    /// The stored picture without rows and columns at its edges that are black in all frames.
    pub within_bars: Crop,
}

/// Decodes some frames and measures their borders.
///
/// # Errors
/// [`PrepareError`] if a frame cannot be decoded, or if all are black.
pub(super) fn look(recording: &Recording) -> Result<Looked, PrepareError> {
    let last = recording.num_frames() - 1;
    let (width, height) = recording.size;
    let (mut columns, mut rows) = (vec![0.0_f64; width], vec![0.0_f64; height]);
    for i in 0..NUM_FRAMES.min(last + 1) {
        let image = recording.frame(i * last / (NUM_FRAMES - 1))?;
        if (image.width() as usize, image.height() as usize) != recording.size {
            let problem =
                format!("has frames of {}x{} pixels, expected {width}x{height}", image.width(), image.height());
            return Err(PrepareError::invalid(&recording.path, problem));
        }
        brightest(&image, &mut columns, &mut rows);
    }
    match (lit(&columns), lit(&rows)) {
        (Some((left, width)), Some((top, height))) => Ok(Looked { within_bars: Crop { left, top, width, height } }),
        _ => {
            Err(PrepareError::invalid(&recording.path, "is black in all frames that were looked at, expected pictures"))
        }
    }
}

/// Raises the brightness of each column and row to its mean in an image.
fn brightest(image: &RgbImage, columns: &mut [f64], rows: &mut [f64]) {
    let (mut by_column, mut by_row) = (vec![0_u64; columns.len()], vec![0_u64; rows.len()]);
    for (x, y, pixel) in image.enumerate_pixels() {
        let sum: u64 = pixel.0.iter().map(|&value| u64::from(value)).sum();
        by_column[x as usize] += sum;
        by_row[y as usize] += sum;
    }
    let (width, height) = (columns.len() as f64, rows.len() as f64);
    for (mean, sum) in columns.iter_mut().zip(by_column) {
        *mean = mean.max(sum as f64 / (3.0 * height));
    }
    for (mean, sum) in rows.iter_mut().zip(by_row) {
        *mean = mean.max(sum as f64 / (3.0 * width));
    }
}

/// Begin and length of the part that is not black.
fn lit(means: &[f64]) -> Option<(usize, usize)> {
    let begin = means.iter().position(|&mean| mean > BLACK)?;
    let end = means.iter().rposition(|&mean| mean > BLACK)?;
    Some((begin, end + 1 - begin))
}
