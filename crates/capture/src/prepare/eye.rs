//! A view as stereo needs it: single precision, grey, small.

use tcgs_core::{Camera, View};

/// A camera in single precision.
#[derive(Clone, Debug)]
pub(crate) struct Eye {
    pub width: usize,
    pub height: usize,
    pub focal: [f32; 2],
    pub principal: [f32; 2],
    /// `camera_from_world`, `[3][3]` row-major.
    pub rotation: [[f32; 3]; 3],
    pub translation: [f32; 3],
    /// In the world.
    pub center: [f32; 3],
}

impl Eye {
    pub fn new(camera: &Camera) -> Self {
        let m = &camera.camera_from_world;
        Self {
            width: camera.width,
            height: camera.height,
            focal: camera.focal.map(|x| x as f32),
            principal: camera.principal.map(|x| x as f32),
            rotation: std::array::from_fn(|i| std::array::from_fn(|j| m[i][j] as f32)),
            translation: std::array::from_fn(|i| m[i][3] as f32),
            center: camera.center().map(|x| x as f32),
        }
    }

    /// Unit direction in the world in which the camera looks.
    pub fn forward(&self) -> [f32; 3] {
        self.rotation[2]
    }

    /// A point of the world in camera space.
    pub fn camera_point(&self, point: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|i| tcgs_core::dot(self.rotation[i], point) + self.translation[i])
    }

    /// Where in the image a point of the world falls, and its depth; nothing behind the camera.
    /// The place may lie outside the image.
    pub fn project(&self, point: [f32; 3]) -> Option<([f32; 2], f32)> {
        let [x, y, z] = self.camera_point(point);
        let at = |value: f32, i: usize| self.focal[i] * value / z + self.principal[i];
        (z > 0.0).then(|| ([at(x, 0), at(y, 1)], z))
    }

    /// The pixel on which a point of the world falls, and its depth.
    pub fn pixel(&self, point: [f32; 3]) -> Option<(usize, f32)> {
        let ([x, y], z) = self.project(point)?;
        // NaN compares false.
        let inside = x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32;
        inside.then(|| (y as usize * self.width + x as usize, z))
    }

    /// The direction in the world of the ray through a place in the image; its depth is 1.
    pub fn ray(&self, [x, y]: [f32; 2]) -> [f32; 3] {
        let [x, y] = [(x - self.principal[0]) / self.focal[0], (y - self.principal[1]) / self.focal[1]];
        let r = &self.rotation;
        std::array::from_fn(|j| r[0][j] * x + r[1][j] * y + r[2][j])
    }

    /// The point of the world at a place in the image and a depth.
    pub fn world(&self, place: [f32; 2], depth: f32) -> [f32; 3] {
        let ray = self.ray(place);
        std::array::from_fn(|i| self.center[i] + depth * ray[i])
    }

    /// The centre of a pixel.
    pub fn place(&self, pixel: usize) -> [f32; 2] {
        [(pixel % self.width) as f32 + 0.5, (pixel / self.width) as f32 + 0.5]
    }
}

/// An image and where it was taken from.
#[derive(Clone, Debug)]
pub(crate) struct Vantage {
    pub eye: Eye,
    /// Mean of the channels, `[H, W]`.
    pub gray: Vec<f32>,
    /// `[H, W]`
    pub colors: Vec<[f32; 3]>,
    /// Foreground, `[H, W]`.
    pub mask: Option<Vec<bool>>,
}

impl Vantage {
    /// - `factor`: pixels squared that become one
    pub fn new(view: &View, factor: usize) -> Self {
        let small;
        let image = if factor == 1 {
            &view.image
        } else {
            small = view.image.downscaled(factor);
            &small
        };
        let planes = [image.plane(0), image.plane(1), image.plane(2)];
        let colors: Vec<[f32; 3]> = (0..image.num_pixels()).map(|i| planes.map(|plane| plane[i])).collect();
        Self {
            eye: Eye::new(&view.camera.downscaled(factor)),
            gray: colors.iter().map(|c| c.iter().sum::<f32>() / 3.0).collect(),
            colors,
            mask: view.segmentation.as_ref().map(|mask| mask.downscaled(factor).foreground),
        }
    }

    /// Whether a pixel is known to be foreground.
    pub fn is_foreground(&self, pixel: usize) -> bool {
        self.mask.as_ref().is_some_and(|mask| mask[pixel])
    }
}

pub(crate) fn sub(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

pub(crate) fn length(a: [f32; 3]) -> f32 {
    tcgs_core::dot(a, a).sqrt()
}
