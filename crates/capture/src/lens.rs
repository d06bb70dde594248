//! Lens distortion, and its removal from an image.

use std::ops::Range;

use image::RgbImage;
use tcgs_core::Image;

/// A lens as OpenCV and COLMAP describe it: the projection of a ray onto the image.
///
/// With `x, y` on the plane at depth 1 and `r² = x² + y²`, the ray falls on `focal * (x', y') + principal`, where
/// `x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶) + 2 p1 x y + p2 (r² + 2 x²)`, and `y'` likewise.
#[derive(Clone, Debug, PartialEq)]
pub struct Lens {
    /// Width of the image, pixels.
    pub width: usize,
    /// Height of the image, pixels.
    pub height: usize,
    /// Focal lengths `fx, fy`, pixels.
    pub focal: [f64; 2],
    /// Principal point `cx, cy`, pixels; pixel centres at +0.5.
    pub principal: [f64; 2],
    /// `k1` to `k6`
    pub radial: [f64; 6],
    /// `p1`, `p2`
    pub tangential: [f64; 2],
    /// The used part of the image plane, once [`Self::find_crop`] has found it.
    pub crop: Crop,
}

/// A rectangle of pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Crop {
    /// First column.
    pub left: usize,
    /// First row.
    pub top: usize,
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
}

impl Crop {
    /// The whole image.
    pub fn whole((width, height): (usize, usize)) -> Self {
        Self { left: 0, top: 0, width, height }
    }

    /// Whether it lies in an image of that size.
    pub fn is_within(self, (width, height): (usize, usize)) -> bool {
        let fits = |begin: usize, length: usize, size: usize| {
            length > 0 && begin.checked_add(length).is_some_and(|end| end <= size)
        };
        fits(self.left, self.width, width) && fits(self.top, self.height, height)
    }
}

/// Largest width and height of a lens, pixels.
pub(crate) const MAX_SIDE: usize = 1 << 14;
/// Largest width and height of images whose crop is searched from the whole image, pixels.
const WHOLE_SIDE: usize = 512;
/// Margin around twice the half-size crop from which the search begins, pixels at each side.
const HALF_MARGIN: usize = 4;
/// Least share of the width or height that must remain.
const MIN_SHARE: f64 = 0.25;

impl Lens {
    /// Whether the lens has no distortion.
    pub fn is_straight(&self) -> bool {
        self.radial == [0.0; 6] && self.tangential == [0.0; 2]
    }

    /// Size of the image before straightening.
    pub fn size(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    /// Intrinsics of a straightened image.
    pub fn straight_intrinsics(&self) -> [[f64; 3]; 3] {
        let ([fx, fy], [cx, cy]) = (self.focal, self.principal);
        [[fx, 0.0, cx - self.crop.left as f64], [0.0, fy, cy - self.crop.top as f64], [0.0, 0.0, 1.0]]
    }

    /// Place in the distorted image of what an undistorted image of equal focal length shows at `pixel`.
    pub fn bend(&self, pixel: [f64; 2]) -> [f64; 2] {
        let [x, y] = std::array::from_fn(|i| (pixel[i] - self.principal[i]) / self.focal[i]);
        let r2 = x * x + y * y;
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let [p1, p2] = self.tangential;
        let radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)));
        let bent = [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ];
        std::array::from_fn(|i| self.focal[i] * bent[i] + self.principal[i])
    }

    /// Whether the scene point at a pixel of the straight image lies outside of the distorted image.
    fn bends_outside(&self, x: usize, y: usize) -> bool {
        let [u, v] = self.bend([x as f64 + 0.5, y as f64 + 0.5]);
        // The colour of the edge extends half a pixel beyond the outermost centres.
        !((0.0..=self.width as f64).contains(&u) && (0.0..=self.height as f64).contains(&v))
    }

    /// Sets the crop: drops rows and columns at the edges until every pixel lies within the distorted image. No pixel
    /// of a straightened image is invented.
    ///
    /// - returns: the fault, if less than a quarter of a side remains
    pub fn find_crop(&mut self) -> Result<(), String> {
        self.crop = self.whole_crop().ok_or_else(|| {
            let (radial, tangential) = (self.radial, self.tangential);
            format!(
                "its distortion (k {radial:?}, p {tangential:?}) leaves less than a quarter of the image, expected a \
                 lens that sees straight lines nearly straight"
            )
        })?;
        Ok(())
    }

    /// The crop of the whole image. The search in a large image starts from the crop at half its size, so the work
    /// grows with the side of the image and not with its area.
    fn whole_crop(&self) -> Option<Crop> {
        let whole = Crop { left: 0, top: 0, width: self.width, height: self.height };
        if self.width.max(self.height) <= WHOLE_SIDE {
            return self.crop_within(whole);
        }
        let size = [self.width, self.height];
        let half = size.map(|side| (side / 2).max(1));
        let scale: [f64; 2] = std::array::from_fn(|i| half[i] as f64 / size[i] as f64);
        let halved = Self {
            width: half[0],
            height: half[1],
            focal: std::array::from_fn(|i| self.focal[i] * scale[i]),
            principal: std::array::from_fn(|i| self.principal[i] * scale[i]),
            ..self.clone()
        };
        let crop = halved.whole_crop()?;
        let doubled = |from: usize, length: usize, side: usize| {
            let start = (2 * from).saturating_sub(HALF_MARGIN);
            (start, (2 * (from + length) + HALF_MARGIN).min(side) - start)
        };
        let (left, width) = doubled(crop.left, crop.width, self.width);
        let (top, height) = doubled(crop.top, crop.height, self.height);
        self.crop_within(Crop { left, top, width, height })
    }

    /// Repeatedly drops the side of a rectangle with the largest share of pixels outside the image, until there are
    /// none. `None` if less than a quarter of a side of the image remains.
    fn crop_within(&self, Crop { mut left, mut top, width, height }: Crop) -> Option<Crop> {
        let (mut right, mut bottom) = (left + width, top + height);
        let min = |size: usize| (size as f64 * MIN_SHARE).ceil() as usize;
        let outside = |x: usize, y: usize| self.bends_outside(x, y);
        let in_column = |x: usize, rows: Range<usize>| rows.filter(|&y| outside(x, y)).count();
        let in_row = |y: usize, columns: Range<usize>| columns.filter(|&x| outside(x, y)).count();
        // Number of pixels of each side that lie outside. Dropping a side takes a pixel from each neighbouring side;
        // only the row or column behind the dropped side is counted in full.
        let mut counts = [
            in_column(left, top..bottom),
            in_row(top, left..right),
            in_column(right - 1, top..bottom),
            in_row(bottom - 1, left..right),
        ];
        loop {
            let lengths = [bottom - top, right - left, bottom - top, right - left];
            let shares: [f64; 4] = std::array::from_fn(|side| counts[side] as f64 / lengths[side] as f64);
            let worst = (0..4).max_by(|&a, &b| shares[a].total_cmp(&shares[b])).expect("four sides");
            if shares[worst] == 0.0 {
                return Some(Crop { left, top, width: right - left, height: bottom - top });
            }
            let take = |count: &mut usize, x: usize, y: usize| *count -= usize::from(outside(x, y));
            match worst {
                0 | 2 => {
                    let x = if worst == 0 { left } else { right - 1 };
                    take(&mut counts[1], x, top);
                    take(&mut counts[3], x, bottom - 1);
                    if worst == 0 { left += 1 } else { right -= 1 }
                }
                _ => {
                    let y = if worst == 1 { top } else { bottom - 1 };
                    take(&mut counts[0], left, y);
                    take(&mut counts[2], right - 1, y);
                    if worst == 1 { top += 1 } else { bottom -= 1 }
                }
            }
            if right - left < min(self.width) || bottom - top < min(self.height) {
                return None;
            }
            counts[worst] = match worst {
                0 => in_column(left, top..bottom),
                1 => in_row(top, left..right),
                2 => in_column(right - 1, top..bottom),
                _ => in_row(bottom - 1, left..right),
            };
        }
    }

    /// The image of a camera without distortion, by bilinear interpolation.
    ///
    /// - `image`: of [`Self::size`]
    pub fn straighten(&self, image: &RgbImage) -> Image {
        let Crop { left, top, width, height } = self.crop;
        let mut out = Image::filled(width, height, 3, 0.0);
        let columns: Vec<f64> = (left..left + width).map(|x| x as f64 + 0.5).collect();
        // Places in the distorted image of a row of pixels: a loop of its own, which vectorises.
        let mut places = [vec![0.0; width], vec![0.0; width]];
        let (pixels, num_pixels) = (Bilinear::of(image), out.num_pixels());
        let (red, others) = out.data.split_at_mut(num_pixels);
        let (green, blue) = others.split_at_mut(num_pixels);
        for y in 0..height {
            let [us, vs] = &mut places;
            let row = (top + y) as f64 + 0.5;
            for ((&column, u), v) in columns.iter().zip(&mut *us).zip(&mut *vs) {
                [*u, *v] = self.bend([column, row]);
            }
            let [red, green, blue] = [&mut *red, green, blue].map(|plane| &mut plane[y * width..][..width]);
            for ((((&u, &v), red), green), blue) in us.iter().zip(&*vs).zip(red).zip(green).zip(blue) {
                [*red, *green, *blue] = pixels.interpolated(u - 0.5, v - 0.5).map(|value| value / 255.0);
            }
        }
        out
    }
}

/// The bytes of an image, for colours between its pixels.
struct Bilinear<'a> {
    width: usize,
    height: usize,
    /// `[H, W, 3]`
    bytes: &'a [u8],
}

impl<'a> Bilinear<'a> {
    fn of(image: &'a RgbImage) -> Self {
        Self { width: image.width() as usize, height: image.height() as usize, bytes: image.as_raw() }
    }

    /// The colour at a place, 0 to 255, by bilinear interpolation.
    ///
    /// - `x`, `y`: pixels from the centre of the first pixel; the outermost pixels' colour extends beyond their centres
    fn interpolated(&self, x: f64, y: f64) -> [f32; 3] {
        let (last_x, last_y) = (self.width - 1, self.height - 1);
        let (x, y) = (x.clamp(0.0, last_x as f64), y.clamp(0.0, last_y as f64));
        // By way of u32, which takes fewer instructions than usize. Both are from 0 to the last pixel; NaN becomes 0.
        let (x0, y0) = (x as u32 as usize, y as u32 as usize);
        let (fx, fy) = ((x - x0 as f64) as f32, (y - y0 as f64) as f32);
        let (right, below) = (3 * usize::from(x0 < last_x), 3 * self.width * usize::from(y0 < last_y));
        let at = 3 * (y0 * self.width + x0);
        let [top, bottom] = [at, at + below].map(|at| &self.bytes[at..at + right + 3]);
        std::array::from_fn(|i| {
            let [a, b, c, d] = [top[i], top[right + i], bottom[i], bottom[right + i]].map(f32::from);
            let (top, bottom) = (a + fx * (b - a), c + fx * (d - c));
            top + fy * (bottom - top)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(radial: [f64; 6], tangential: [f64; 2]) -> Lens {
        let (focal, principal) = ([60.0, 62.0], [41.0, 29.0]);
        Lens { width: 80, height: 60, focal, principal, radial, tangential, crop: Crop::default() }
    }

    #[test]
    fn rays_fall_where_opencv_says() {
        // cv2.projectPoints([[0.3, -0.2, 1]], 0, 0, K, [k1, k2, p1, p2, k3, k4, k5, k6]), OpenCV 4.
        let lens = lens([0.1, -0.05, 0.02, 0.03, 0.01, -0.004], [0.002, -0.003]);
        let [x, y] = lens.bend([41.0 + 60.0 * 0.3, 29.0 - 62.0 * 0.2]);
        let [expected_x, expected_y] = [59.07570469998626, 16.547847873342803];
        assert!((x - expected_x).abs() < 1e-9 && (y - expected_y).abs() < 1e-9, "{x} {y}");
    }

    #[test]
    fn a_straightened_grid_is_straight_and_whole() {
        for (k1, p1) in [(0.2, 0.0), (-0.2, 0.0), (-0.1, 0.01)] {
            let mut lens = lens([k1, 0.01, 0.0, 0.0, 0.0, 0.0], [p1, -p1]);
            lens.find_crop().unwrap();
            let crop = lens.crop;
            assert!(crop.width > 60 && crop.height > 45, "{crop:?}");
            // A smooth picture whose values are a function of the ray. The distorted camera's picture is found by
            // undoing the distortion of each of its pixels.
            let value = |x: f64, y: f64| 120.0 + 60.0 * (2.0 * x).sin() + 50.0 * (3.0 * y).cos();
            let picture = RgbImage::from_fn(80, 60, |x, y| {
                let pixel = [f64::from(x) + 0.5, f64::from(y) + 0.5];
                let mut straight = pixel;
                for _ in 0..100 {
                    let bent = lens.bend(straight);
                    straight = [straight[0] + pixel[0] - bent[0], straight[1] + pixel[1] - bent[1]];
                }
                let v = value((straight[0] - 41.0) / 60.0, (straight[1] - 29.0) / 62.0).round();
                image::Rgb([v as u8; 3])
            });
            let image = lens.straighten(&picture);
            let [[fx, _, cx], [_, fy, cy], _] = lens.straight_intrinsics();
            let mut worst: f64 = 0.0;
            for (i, &found) in image.plane(1).iter().enumerate() {
                let (x, y) = ((i % crop.width) as f64 + 0.5, (i / crop.width) as f64 + 0.5);
                worst = worst.max((f64::from(found) * 255.0 - value((x - cx) / fx, (y - cy) / fy)).abs());
            }
            assert!(worst < 1.2, "off by {worst} of 255 with k1 {k1}");
        }
    }

    /// [`Lens::straighten`] as it is defined, a value at a time.
    fn slow_straighten(lens: &Lens, image: &RgbImage) -> Vec<f32> {
        let (last_x, last_y) = (f64::from(image.width() - 1), f64::from(image.height() - 1));
        let Crop { left, top, width, height } = lens.crop;
        let value = |channel: usize, x: usize, y: usize| {
            let [u, v] = lens.bend([(left + x) as f64 + 0.5, (top + y) as f64 + 0.5]);
            let (u, v) = ((u - 0.5).clamp(0.0, last_x), (v - 0.5).clamp(0.0, last_y));
            let (du, dv) = (u.fract() as f32, v.fract() as f32);
            let at = |u: f64, v: f64| f32::from(image.get_pixel(u.min(last_x) as u32, v.min(last_y) as u32).0[channel]);
            let between = |v: f64| at(u, v) + du * (at(u + 1.0, v) - at(u, v));
            (between(v) + dv * (between(v + 1.0) - between(v))) / 255.0
        };
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        (0..3).flat_map(|channel| pixels.clone().map(move |(x, y)| value(channel, x, y))).collect()
    }

    #[test]
    fn an_image_is_straightened_as_pixel_by_pixel() {
        let noise = |seed: u32| {
            RgbImage::from_fn(80, 60, |x, y| {
                image::Rgb([1, 2, 3].map(|c| (x.wrapping_mul(2_654_435_761) ^ y.wrapping_mul(40_503 * c + seed)) as u8))
            })
        };
        for (k1, p1) in [(0.2, 0.0), (-0.2, 0.01), (0.0, 0.0)] {
            let mut lens = lens([k1, 0.01, 0.0, -0.03, 0.0, 0.002], [p1, -p1]);
            lens.find_crop().unwrap();
            assert_eq!(lens.straighten(&noise(7)).data, slow_straighten(&lens, &noise(7)), "{k1} {p1}");
            // Where the lens shows what is beyond the edges, too.
            lens.crop = Crop::whole(lens.size());
            assert_eq!(lens.straighten(&noise(9)).data, slow_straighten(&lens, &noise(9)), "{k1} {p1}");
        }
        // Without a second row or column.
        for (width, height) in [(1, 1), (1, 5), (5, 1)] {
            let thin = Lens { width, height, crop: Crop::whole((width, height)), ..lens([0.1; 6], [0.0; 2]) };
            let thin_noise = image::imageops::crop_imm(&noise(7), 0, 0, width as u32, height as u32).to_image();
            assert_eq!(thin.straighten(&thin_noise).data, slow_straighten(&thin, &thin_noise), "{width}x{height}");
        }
    }

    /// The crop as it is defined: all four sides are counted at every step.
    fn slow_crop(lens: &Lens) -> Option<[usize; 4]> {
        let [mut left, mut top, mut right, mut bottom] = [0, 0, lens.width, lens.height];
        loop {
            let (columns, rows) = (left..right, top..bottom);
            let column =
                |x: usize| rows.clone().filter(|&y| lens.bends_outside(x, y)).count() as f64 / rows.len() as f64;
            let row =
                |y: usize| columns.clone().filter(|&x| lens.bends_outside(x, y)).count() as f64 / columns.len() as f64;
            let shares = [column(left), row(top), column(right - 1), row(bottom - 1)];
            let worst = (0..4).max_by(|&a, &b| shares[a].total_cmp(&shares[b])).unwrap();
            if shares[worst] == 0.0 {
                return Some([left, top, right - left, bottom - top]);
            }
            match worst {
                0 => left += 1,
                1 => top += 1,
                2 => right -= 1,
                _ => bottom -= 1,
            }
            if 4 * (right - left) < lens.width || 4 * (bottom - top) < lens.height {
                return None;
            }
        }
    }

    #[test]
    fn a_crop_is_as_its_definition_says() {
        let mut num_refused = 0;
        for k1 in [300.0, -0.4, -0.2, 0.0, 0.1, 0.3, 2.0] {
            for p1 in [-0.05, 0.0, 0.02] {
                let mut lens = lens([k1, -0.1, 0.02, 0.0, 0.1, 0.0], [p1, 0.01 - p1]);
                let found = lens.find_crop().ok().map(|()| lens.crop);
                let found = found.map(|crop| [crop.left, crop.top, crop.width, crop.height]);
                assert_eq!(found, slow_crop(&lens), "{k1} {p1}");
                num_refused += usize::from(found.is_none());
            }
        }
        assert!((1..18).contains(&num_refused), "{num_refused}");
    }

    #[test]
    fn a_crop_of_a_large_image_is_that_of_its_definition_within_a_pixel() {
        for (k1, p1) in [(-0.2, 0.0), (-0.1, 0.02), (0.1, 0.0), (0.3, -0.02)] {
            let mut lens = Lens {
                width: 1291,
                height: 763,
                focal: [905.0, 911.0],
                principal: [651.5, 374.0],
                ..lens([k1, -0.03, 0.01, 0.0, 0.0, 0.0], [p1, 0.01 - p1])
            };
            lens.find_crop().unwrap();
            let crop = lens.crop;
            let found = [crop.left, crop.top, crop.left + crop.width, crop.top + crop.height];
            let [left, top, width, height] = slow_crop(&lens).unwrap();
            let expected = [left, top, left + width, top + height];
            assert!(found.iter().zip(expected).all(|(a, b)| a.abs_diff(b) <= 1), "{found:?}, not {expected:?}");
            let [columns, rows] = [found[0]..found[2], found[1]..found[3]];
            assert!(rows.into_iter().all(|y| columns.clone().all(|x| !lens.bends_outside(x, y))));
        }
    }

    #[test]
    fn a_lens_that_bends_too_much_is_refused() {
        let problem = lens([300.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.0; 2]).find_crop().unwrap_err();
        assert!(problem.contains("leaves less than a quarter"), "{problem}");
    }
}
