//! One camera that stands still: samples of its images over time, and the background behind everything that moves.

use tcgs_core::{Camera, Pinhole};

use super::{MARGIN_PX, outline};

/// An image as a list of colours, `[H, W]` of 8 bits a channel: samples of many frames are held at once.
pub(super) type Pixels = Vec<[u8; 3]>;

/// Minimum number of samples of a pixel that show the background, for the background to be known.
const MIN_SAMPLES: usize = 3;

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
        self.background = found;
    }
}
