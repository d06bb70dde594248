//! One camera that stands still: samples of its images over time, and the background behind everything that moves.

use rayon::prelude::*;
use tcgs_core::{Camera, Pinhole, distance, upper_median};

use super::{MARGIN_PX, outline};

/// An image as a list of colours, `[H, W]` of 8 bits a channel: samples of many frames are held at once.
pub(super) type Pixels = Vec<[u8; 3]>;

/// Minimum number of samples of a pixel that show the background, for the background to be known.
const MIN_SAMPLES: usize = 3;
/// Half of the side of the square of pixels whose backgrounds a pixel's is likened to, as a share of the image's width.
const SURROUNDINGS: f32 = 0.15;
/// Number of pixels of a surrounding that are looked at, along each side.
const NUM_ACROSS: usize = 16;
/// Distance of two colours, in `[0, 1]`, below which they show the same thing.
const SAME_COLOR: f32 = 0.06;
/// The same from which they show different things.
const OTHER_COLOR: f32 = 0.09;

/// A static camera with its samples and background.
pub(super) struct Station {
    pub camera_id: usize,
    /// Camera of the reduced images.
    pub pinhole: Pinhole<f32>,
    /// Factor by which the images are reduced.
    pub factor: usize,
    /// Width and height of the images as the capture gives them.
    pub full_size: (usize, usize),
    /// `[S]`
    pub samples: Vec<Pixels>,
    pub background: Background,
}

/// The background of a camera, behind everything that moves.
#[derive(Default)]
pub(super) struct Background {
    /// `[H, W]`, in `[0, 1]`: medians over the samples that show it.
    pub colors: Vec<[f32; 3]>,
    /// `[H, W]`, whether enough samples show the background. An unknown pixel has the median of all samples.
    pub known: Vec<bool>,
}

impl Station {
    /// - `camera`: as the capture gives it
    /// - `factor`: by which its images are reduced
    pub fn new(camera_id: usize, camera: &Camera, factor: usize) -> Self {
        Self {
            camera_id,
            pinhole: Pinhole::new(&camera.downscaled(factor)),
            factor,
            full_size: (camera.width, camera.height),
            samples: Vec::new(),
            background: Background::default(),
        }
    }

    /// Takes the background from the samples.
    ///
    /// - `covered`: `[S, H, W]`, pixels where something stands before the background; `None` if unknown
    pub fn find_background(&mut self, covered: Option<&[Vec<bool>]>) {
        let (width, height) = (self.pinhole.width, self.pinhole.height);
        let near: Vec<Vec<bool>> = match covered {
            Some(covered) => covered.iter().map(|cover| outline::grown(width, cover, MARGIN_PX)).collect(),
            None => vec![vec![false; width * height]; self.samples.len()],
        };
        let mut found = Background::default();
        let mut values: [Vec<u8>; 3] = Default::default();
        for pixel in 0..width * height {
            let free = || (0..self.samples.len()).filter(|&s| !near[s][pixel]);
            let known = free().count() >= MIN_SAMPLES;
            let shown: Vec<usize> = if known { free().collect() } else { (0..self.samples.len()).collect() };
            found.colors.push(std::array::from_fn(|channel| {
                let values = &mut values[channel];
                values.clear();
                values.extend(shown.iter().map(|&s| self.samples[s][pixel][channel]));
                let middle = values.len() / 2;
                f32::from(*values.select_nth_unstable(middle).1) / 255.0
            }));
            found.known.push(known);
        }
        // Without a hull the median may be what stands there for most of the time.
        let is_sure =
            |pixel: usize| found.known[pixel] && (covered.is_some() || !self.varies(pixel, found.colors[pixel]));
        let is_sure: Vec<bool> = (0..width * height).into_par_iter().map(is_sure).collect();
        let likened = |pixel: usize| if is_sure[pixel] { None } else { self.likened(&found, &is_sure, pixel) };
        let likened: Vec<Option<[f32; 3]>> = (0..width * height).into_par_iter().map(likened).collect();
        for (pixel, color) in likened.into_iter().enumerate() {
            if let Some(color) = color {
                (found.colors[pixel], found.known[pixel]) = (color, true);
            }
        }
        self.background = found;
    }

    /// Colour of a sample's pixel, in `[0, 1]`.
    fn color(&self, sample: usize, pixel: usize) -> [f32; 3] {
        self.samples[sample][pixel].map(|value| f32::from(value) / 255.0)
    }

    /// Whether enough samples of a pixel to be a background have another colour.
    fn varies(&self, pixel: usize, color: [f32; 3]) -> bool {
        let differs = |&sample: &usize| distance(self.color(sample, pixel), color) >= OTHER_COLOR;
        (0..self.samples.len()).filter(differs).count() >= MIN_SAMPLES
    }

    /// The background of a pixel whose samples leave it open: the one of their colours that is most frequent around it.
    /// Where a person stands for most of the time, the median shows this person. Samples without the person differ
    /// from it.
    ///
    /// - `found`: the background so far
    /// - `is_sure`: `[H, W]`, where it counts
    /// - returns: `None` if the surroundings do not tell
    fn likened(&self, found: &Background, is_sure: &[bool], pixel: usize) -> Option<[f32; 3]> {
        let (width, height) = (self.pinhole.width, self.pinhole.height);
        let reach = (SURROUNDINGS * width as f32).max(1.0);
        let step = 2.0 * reach / NUM_ACROSS as f32;
        let (x, y) = ((pixel % width) as f32, (pixel / width) as f32);
        let mut around: Vec<[f32; 3]> = Vec::new();
        for i in 0..NUM_ACROSS * NUM_ACROSS {
            let offset = |k: usize| (k as f32 + 0.5) * step - reach;
            let (x, y) = ((x + offset(i % NUM_ACROSS)).round(), (y + offset(i / NUM_ACROSS)).round());
            if x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32 {
                let other = y as usize * width + x as usize;
                if is_sure[other] {
                    around.push(found.colors[other]);
                }
            }
        }
        let colors: Vec<[f32; 3]> = (0..self.samples.len()).map(|sample| self.color(sample, pixel)).collect();
        let is_same = |a: &[f32; 3], b: &[f32; 3]| distance(*a, *b) < SAME_COLOR;
        let counts: Vec<usize> =
            colors.iter().map(|color| around.iter().filter(|other| is_same(color, other)).count()).collect();
        let best = (0..colors.len()).max_by_key(|&i| counts[i])?;
        let (same, others): (Vec<usize>, Vec<usize>) =
            (0..colors.len()).partition(|&i| distance(colors[i], colors[best]) < OTHER_COLOR);
        let second = others.iter().map(|&i| counts[i]).max()?;
        (same.len() >= MIN_SAMPLES && counts[best] > second).then(|| {
            [0, 1, 2].map(|channel| upper_median(same.iter().map(|&i| colors[i][channel])).unwrap_or_default())
        })
    }
}
