//! The doctor's overview: every camera's image with the points that fall on it, and below it the points as seen from
//! the camera. Where cameras are right the two look alike.

use tcgs_core::{Image, Pinhole, View};

use super::{
    Finding,
    splat::{Drawing, Splats},
};

/// Tiles beside each other.
const COLUMNS: usize = 6;
/// Width of a tile's frame, pixels.
const FRAME: usize = 3;
/// Every so many drawn pixels along both axes become a dot.
const DOT_SPACING: usize = 6;
const HEALTHY: [f32; 3] = [0.2, 0.7, 0.3];
const SUSPECT: [f32; 3] = [0.9, 0.15, 0.1];
const DOT_FOREGROUND: [f32; 3] = [1.0, 0.45, 0.0];
const DOT_BACKGROUND: [f32; 3] = [0.0, 0.9, 1.0];
/// Rows of three dots for the digits, from the top; the highest of three bits is left.
const DIGITS: [[u8; 5]; 10] = [
    [7, 5, 5, 5, 7],
    [2, 6, 2, 2, 7],
    [7, 1, 7, 4, 7],
    [7, 1, 7, 1, 7],
    [5, 5, 7, 1, 1],
    [7, 4, 7, 1, 7],
    [7, 4, 7, 5, 7],
    [7, 1, 1, 1, 1],
    [7, 5, 7, 5, 7],
    [7, 5, 7, 1, 7],
];
/// Pixels of a digit's dot.
const DIGIT_DOT: usize = 3;

pub(super) fn draw(views: &[View], splats: &Splats, findings: &[Finding]) -> Image {
    let widest = views.iter().map(|view| view.camera.width).max().unwrap_or(1);
    let highest = views.iter().map(|view| view.camera.height).max().unwrap_or(1);
    let (tile_width, tile_height) = (widest + 2 * FRAME, 2 * highest + 3 * FRAME);
    let columns = COLUMNS.min(views.len()).max(1);
    let rows = views.len().div_ceil(columns);
    let mut sheet = Image::filled(columns * tile_width, rows * tile_height, 3, 0.0);
    for (i, view) in views.iter().enumerate() {
        let (left, top) = (i % columns * tile_width, i / columns * tile_height);
        let suspect = findings.iter().any(|finding| finding.cameras.contains(&view.camera_id));
        let frame = if suspect { SUSPECT } else { HEALTHY };
        rectangle(&mut sheet, [left, top], [tile_width, tile_height], frame);
        let drawing = splats.draw(&Pinhole::new(&view.camera));
        let (width, below) = (view.camera.width, top + 2 * FRAME + highest);
        for pixel in 0..view.image.num_pixels() {
            let (x, y) = (left + FRAME + pixel % width, pixel / width);
            let color = std::array::from_fn(|channel| view.image.plane(channel)[pixel]);
            put(&mut sheet, [x, top + FRAME + y], dot(&drawing, pixel, [DOT_SPACING, 1]).unwrap_or(color));
            put(&mut sheet, [x, below + y], drawing.colors[pixel]);
        }
        label(&mut sheet, [left + 2 * FRAME, top + 2 * FRAME], view.camera_id, frame);
    }
    sheet
}

/// Colour of the dot at a pixel, if there is one.
///
/// - `[spacing, side]`: pixels from one dot to the next, and along a side of it
pub(super) fn dot(drawing: &Drawing, pixel: usize, [spacing, side]: [usize; 2]) -> Option<[f32; 3]> {
    let (x, y) = (pixel % drawing.width, pixel / drawing.width);
    let on_grid = x % spacing < side && y % spacing < side;
    let color = || if drawing.foreground[pixel] { DOT_FOREGROUND } else { DOT_BACKGROUND };
    (on_grid && drawing.is_drawn(pixel)).then(color)
}

/// A number on a black ground.
fn label(sheet: &mut Image, [left, top]: [usize; 2], number: usize, color: [f32; 3]) {
    let digits: Vec<usize> = number.to_string().bytes().map(|byte| usize::from(byte - b'0')).collect();
    rectangle(sheet, [left, top], [(4 * digits.len() + 1) * DIGIT_DOT, 7 * DIGIT_DOT], [0.0; 3]);
    for (i, digit) in digits.into_iter().enumerate() {
        for (row, bits) in DIGITS[digit].into_iter().enumerate() {
            for column in (0..3).filter(|column| bits >> (2 - column) & 1 == 1) {
                let at = [left + (4 * i + 1 + column) * DIGIT_DOT, top + (row + 1) * DIGIT_DOT];
                rectangle(sheet, at, [DIGIT_DOT; 2], color.map(|c| (c + 0.3).min(1.0)));
            }
        }
    }
}

fn rectangle(sheet: &mut Image, [left, top]: [usize; 2], [width, height]: [usize; 2], color: [f32; 3]) {
    for y in top..(top + height).min(sheet.height) {
        for x in left..(left + width).min(sheet.width) {
            put(sheet, [x, y], color);
        }
    }
}

fn put(sheet: &mut Image, [x, y]: [usize; 2], color: [f32; 3]) {
    let pixel = y * sheet.width + x;
    for (channel, value) in color.into_iter().enumerate() {
        sheet.plane_mut(channel)[pixel] = value;
    }
}
