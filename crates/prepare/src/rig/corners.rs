//! Image pyramids, and corners that can be found again.

use image::RgbImage;

/// Pictures are reduced to at most this many pixels a side before the search for corners.
const MAX_SIDE: usize = 1400;
const NUM_LEVELS: usize = 4;
/// Number of levels with corners: coarse corners are found again from farther away.
const CORNER_LEVELS: usize = 3;
/// Cells along the longer side of the finest level. Each cell gives some corners, so that they are spread.
const CELLS: usize = 28;
const PER_CELL: usize = 2;
/// The smaller eigenvalue of a corner's structure, per pixel of its window, grey values of 255 squared.
const MIN_CORNER: f32 = 6.0;
/// The smallest cell, pixels of the level: about a patch, or neighbouring cells would show the same.
const MIN_CELL: usize = 16;
/// Half of the window in which corners are judged, pixels of the level.
const WINDOW: usize = 3;
/// Distance of corners from the edge, pixels of the level.
const MARGIN: usize = 10;

/// Grey values in `[0, 255]`.
#[derive(Clone, Debug)]
pub(super) struct Gray {
    pub width: usize,
    pub height: usize,
    pub data: Vec<f32>,
}

/// A picture at full size, half, a quarter and so on.
#[derive(Clone, Debug)]
pub(super) struct Pyramid {
    pub levels: Vec<Gray>,
    /// Pixels of the camera's image for one of level 0.
    pub unit: f64,
}

/// A corner in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Corner {
    /// Pixels of the camera's image; centres at +0.5.
    pub pixel: [f64; 2],
    pub level: usize,
}

impl Gray {
    /// Bilinear interpolation; the edge's value extends beyond it.
    ///
    /// - `x`, `y`: pixels; centres at +0.5
    pub fn at(&self, x: f32, y: f32) -> f32 {
        let x = (x - 0.5).clamp(0.0, (self.width - 1) as f32);
        let y = (y - 0.5).clamp(0.0, (self.height - 1) as f32);
        let (left, top) = (x as usize, y as usize);
        let right = usize::from(left + 1 < self.width);
        let below = usize::from(top + 1 < self.height) * self.width;
        let (fx, fy) = (x - left as f32, y - top as f32);
        let data = &self.data[top * self.width + left..];
        let ([a, b], [c, d]) = ([data[0], data[right]], [data[below], data[below + right]]);
        let (upper, lower) = (a + fx * (b - a), c + fx * (d - c));
        upper + fy * (lower - upper)
    }

    /// Box filter: averages square blocks of pixels. Remainders at the right and at the bottom are dropped.
    fn reduced(&self, by: usize) -> Self {
        let (width, height) = ((self.width / by).max(1), (self.height / by).max(1));
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            for x in 0..width {
                let mut sum = 0.0;
                for dy in 0..by.min(self.height) {
                    let row = &self.data[(y * by + dy) * self.width..];
                    sum += row[x * by..(x * by + by).min(self.width)].iter().sum::<f32>();
                }
                data.push(sum / (by * by) as f32);
            }
        }
        Self { width, height, data }
    }
}

impl Pyramid {
    pub fn new(image: &RgbImage) -> Self {
        let gray = |p: &image::Rgb<u8>| {
            let [r, g, b] = p.0.map(f32::from);
            0.299 * r + 0.587 * g + 0.114 * b
        };
        let (width, height) = (image.width() as usize, image.height() as usize);
        let full = Gray { width, height, data: image.pixels().map(gray).collect() };
        let by = width.max(height).div_ceil(MAX_SIDE);
        let mut levels = vec![if by > 1 { full.reduced(by) } else { full }];
        while levels.len() < NUM_LEVELS && levels[levels.len() - 1].width.min(levels[levels.len() - 1].height) > 64 {
            levels.push(levels[levels.len() - 1].reduced(2));
        }
        Self { levels, unit: by as f64 }
    }

    /// Pixels of the camera's image for one of a level.
    pub fn unit_of(&self, level: usize) -> f64 {
        self.unit * (1 << level) as f64
    }

    /// Corners, spread over the picture; in the order of levels and cells.
    pub fn corners(&self) -> Vec<Corner> {
        let cells = |level: usize| {
            let Gray { width, height, .. } = self.levels[level];
            (CELLS >> level).min(width.max(height) / MIN_CELL)
        };
        (0..CORNER_LEVELS.min(self.levels.len())).flat_map(|level| self.corners_of_level(level, cells(level))).collect()
    }

    /// Corners of one level.
    ///
    /// - `cells`: number along the longer side; each gives some corners
    pub fn corners_of_level(&self, level: usize, cells: usize) -> Vec<Corner> {
        let unit = self.unit_of(level);
        let places = corners_of(&self.levels[level], cells.max(4)).into_iter();
        places.map(|[x, y]| Corner { pixel: [x * unit, y * unit], level }).collect()
    }
}

/// - `cells`: along the longer side
fn corners_of(gray: &Gray, cells: usize) -> Vec<[f64; 2]> {
    let (width, height) = (gray.width, gray.height);
    if width.min(height) <= 2 * MARGIN {
        return Vec::new();
    }
    let strength = strengths(gray);
    let cell = width.max(height).div_ceil(cells).max(4);
    let mut corners = Vec::new();
    for top in (0..height).step_by(cell) {
        for left in (0..width).step_by(cell) {
            let mut found: Vec<(f32, usize, usize)> = Vec::new();
            for y in top.max(MARGIN)..(top + cell).min(height - MARGIN) {
                for x in left.max(MARGIN)..(left + cell).min(width - MARGIN) {
                    let value = strength[y * width + x];
                    let is_peak = || (y - 2..=y + 2).all(|v| (x - 2..=x + 2).all(|u| strength[v * width + u] <= value));
                    if value > MIN_CORNER && is_peak() {
                        found.push((value, x, y));
                    }
                }
            }
            found.sort_by(|a, b| b.0.total_cmp(&a.0).then((a.2, a.1).cmp(&(b.2, b.1))));
            corners.extend(found.iter().take(PER_CELL).map(|&(_, x, y)| [x as f64 + 0.5, y as f64 + 0.5]));
        }
    }
    corners
}

/// The smaller eigenvalue of the structure tensor around each pixel (Shi and Tomasi 1994).
fn strengths(gray: &Gray) -> Vec<f32> {
    let (width, height) = (gray.width, gray.height);
    let mut products = vec![[0.0_f32; 3]; width * height];
    for y in 1..height - 1 {
        for x in 1..width - 1 {
            let at = |x: usize, y: usize| gray.data[y * width + x];
            let (dx, dy) = (0.5 * (at(x + 1, y) - at(x - 1, y)), 0.5 * (at(x, y + 1) - at(x, y - 1)));
            products[y * width + x] = [dx * dx, dx * dy, dy * dy];
        }
    }
    let summed = |from: &[[f32; 3]], step: usize, is_inside: &dyn Fn(usize) -> bool| -> Vec<[f32; 3]> {
        let sum = |i: usize| {
            let mut sum = [0.0; 3];
            for k in 0..=2 * WINDOW {
                let product = from[i + k * step - WINDOW * step];
                for (a, b) in sum.iter_mut().zip(product) {
                    *a += b;
                }
            }
            sum
        };
        (0..from.len()).map(|i| if is_inside(i) { sum(i) } else { [0.0; 3] }).collect()
    };
    let rows = summed(&products, 1, &|i| (WINDOW..width - WINDOW).contains(&(i % width)));
    let all = summed(&rows, width, &|i| (WINDOW..height - WINDOW).contains(&(i / width)));
    let area = ((2 * WINDOW + 1) * (2 * WINDOW + 1)) as f32;
    let smaller = |[xx, xy, yy]: [f32; 3]| (0.5 * (xx + yy) - (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt()) / area;
    all.into_iter().map(smaller).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_of_a_square_are_found_and_nothing_along_its_edges() {
        let image = RgbImage::from_fn(120, 90, |x, y| {
            image::Rgb([if (40..70).contains(&x) && (30..60).contains(&y) { 200 } else { 30 }; 3])
        });
        let pyramid = Pyramid::new(&image);
        let corners = corners_of(&pyramid.levels[0], 4);
        assert!(!corners.is_empty());
        for expected in [[40.0, 30.0], [70.0, 30.0], [40.0, 60.0], [70.0, 60.0]] {
            let near = |c: &&[f64; 2]| (c[0] - expected[0]).hypot(c[1] - expected[1]) < 4.0;
            assert!(corners.iter().any(|c| near(&c)), "{expected:?} of {corners:?}");
        }
        for c in corners {
            let at_corner = |v: f64, [a, b]: [f64; 2]| (v - a).abs().min((v - b).abs()) < 6.0;
            assert!(at_corner(c[0], [40.0, 70.0]) && at_corner(c[1], [30.0, 60.0]), "{c:?} is on an edge");
        }
    }
}
