//! Measures beyond `tcgs eval`: errors where several training cameras see the scene, errors after a fit of each
//! camera's exposure, and floaters and holes between cameras.

use std::sync::Arc;

use serde_json::{Value, json};
use tcgs_capture::{Capture, Split};
use tcgs_core::{Activated, Camera, Image, Pinhole, PointCloud, View, cameras_between};
use tcgs_metrics::psnr_masked;
use tcgs_pipeline::{Backend, OpenScene};
use tcgs_render::RenderSettings;

/// Share of the surface's depth in front of which space counts as free.
const FREE: f32 = 0.85;
/// Share of a point's depth up to which a nearer surface does not hide it.
const HIDDEN: f32 = 0.9;
/// Points of a cell of a depth map on average: enough that hardly a cell before a surface is empty.
const POINTS_A_CELL: f64 = 3.0;
/// Pictures from between the cameras.
const NUM_BETWEEN: usize = 24;
/// Fewest training cameras that must see the point of a pixel.
const WITNESSES: usize = 2;

/// Measures a scene.
///
/// - `seen_by`: the capture whose training cameras were trained with
/// - `judge`, `split`: the cameras that judge
/// - returns: `psnr_seen`, over pixels that at least two training cameras see; `unseen`, the share of the other pixels;
///   `psnr_fitted`, after a gain and an offset for each camera and channel. Two shares are of the first frame, seen
///   from between the training cameras: `free_space`, the mean share of a pixel's light from before
///   the surface of the initial points; `holes`, the share that meets no Gaussian.
pub fn measure(scene: &OpenScene, seen_by: &Capture, judge: &Capture, split: Split) -> anyhow::Result<Value> {
    let downscale = scene.downscale;
    let renderer = Backend::Cpu.renderer();
    let settings = RenderSettings::default();
    let training: Vec<Camera> = cameras(seen_by, scene)?;
    let surfaces = Surfaces::new(&seen_by.point_cloud()?, &training);
    let mut judged: Vec<(View, Image, Vec<bool>)> = Vec::new();
    for frame in scene.frames() {
        let drawn = scene.drawn(frame - scene.first_frame)?;
        for view in judge.views(split, frame, downscale)? {
            let (output, _) = renderer.draw(&drawn.seen_by(&view.camera), &view.camera, &settings)?;
            let seen = surfaces.seen(&view.camera);
            judged.push((view, output.image, seen));
        }
    }
    let mean = |values: Vec<f64>| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let seen_psnr = judged.iter().filter_map(|(view, image, seen)| psnr_masked(image, &view.image, seen));
    let unseen = judged.iter().map(|(_, _, seen)| share(seen, false));
    let drawn = scene.drawn(0)?;
    let (mut free_space, mut holes) = (Vec::new(), Vec::new());
    for camera in cameras_between(&training, 0..NUM_BETWEEN) {
        let gaussians = drawn.seen_by(&camera);
        let marked = Arc::new(surfaces.mark_free(&gaussians, &camera));
        let (output, _) = renderer.draw(&marked, &camera, &settings)?;
        free_space.push(mean(output.image.plane(0).iter().map(|&x| f64::from(x)).collect()));
        holes.push(mean(output.transmittance.iter().map(|&x| f64::from(x)).collect()));
    }
    Ok(json!({
        "psnr_seen": mean(seen_psnr.collect()),
        "unseen": mean(unseen.collect()),
        "psnr_fitted": mean(fitted_psnrs(&judged)),
        "free_space": mean(free_space),
        "holes": mean(holes),
    }))
}

fn cameras(capture: &Capture, scene: &OpenScene) -> anyhow::Result<Vec<Camera>> {
    let cameras = capture.cameras(Split::Train, scene.first_frame, scene.downscale)?;
    Ok(cameras.into_iter().map(|(_, camera)| camera).collect())
}

fn share(of: &[bool], value: bool) -> f64 {
    of.iter().filter(|&&found| found == value).count() as f64 / of.len().max(1) as f64
}

/// PSNR of each image after a least-squares fit of a gain and an offset for each camera and channel.
fn fitted_psnrs(judged: &[(View, Image, Vec<bool>)]) -> Vec<f64> {
    let mut psnrs = Vec::new();
    for (view, image, _) in judged {
        let of_camera = judged.iter().filter(|(other, ..)| other.camera_id == view.camera_id);
        let mut fitted = image.clone();
        for channel in 0..image.num_channels {
            // Sums of 1, x, y, x², xy over the camera's renderings x and images y.
            let mut sums = [0.0_f64; 5];
            for (other, rendered, _) in of_camera.clone() {
                for (&x, &y) in rendered.plane(channel).iter().zip(other.image.plane(channel)) {
                    let (x, y) = (f64::from(x), f64::from(y));
                    for (sum, term) in sums.iter_mut().zip([1.0, x, y, x * x, x * y]) {
                        *sum += term;
                    }
                }
            }
            let [n, x, y, xx, xy] = sums;
            let variance = n * xx - x * x;
            let gain = if variance > 0.0 { (n * xy - x * y) / variance } else { 1.0 };
            let offset = (y - gain * x) / n;
            let pixels = image.num_pixels();
            for value in &mut fitted.data[channel * pixels..(channel + 1) * pixels] {
                *value = (gain * f64::from(*value) + offset) as f32;
            }
        }
        psnrs.push(tcgs_metrics::psnr(&fitted, &view.image));
    }
    psnrs
}

/// Depth maps of the initial points from the cameras.
struct Surfaces {
    points: Vec<[f32; 3]>,
    training: Vec<(Pinhole<f32>, DepthMap)>,
}

impl Surfaces {
    fn new(cloud: &PointCloud, training: &[Camera]) -> Self {
        let points = cloud.points.clone();
        let of = |camera: &Camera| {
            let pinhole = Pinhole::new(camera);
            let depths = DepthMap::new(&points, &pinhole);
            (pinhole, depths)
        };
        let training = training.iter().map(of).collect();
        Self { points, training }
    }

    /// Whether enough training cameras see the point that each pixel shows.
    fn seen(&self, camera: &Camera) -> Vec<bool> {
        let pinhole = Pinhole::<f32>::new(camera);
        let depths = DepthMap::new(&self.points, &pinhole);
        let is_seen = |pixel: usize| {
            let place = pinhole.pixel_center(pixel);
            let Some(depth) = depths.at(place) else { return false };
            let point = pinhole.unproject(place, depth);
            let witnesses = self.training.iter().filter(|(other, map)| {
                other.pixel(point).is_some_and(|(_, z)| {
                    let place = other.project(point).map(|(place, _)| place);
                    place.and_then(|place| map.at(place)).is_none_or(|nearest| nearest > HIDDEN * z)
                })
            });
            witnesses.count() >= WITNESSES
        };
        (0..camera.width * camera.height).map(is_seen).collect()
    }

    /// The Gaussians with one channel: 1 for a Gaussian before the surface, else 0.
    fn mark_free(&self, gaussians: &Activated, camera: &Camera) -> Activated {
        let pinhole = Pinhole::<f32>::new(camera);
        let depths = DepthMap::new(&self.points, &pinhole);
        let is_free = |mean: &[f32; 3]| {
            pinhole.project(*mean).is_some_and(|(place, z)| depths.at(place).is_some_and(|surface| z < FREE * surface))
        };
        let colors = gaussians.means.iter().map(|mean| f32::from(u8::from(is_free(mean)))).collect();
        Activated { colors, num_channels: 1, background: Vec::new(), ..gaussians.clone() }
    }
}

/// Depth of the nearest point in each cell of an image.
struct DepthMap {
    /// Side of a cell, pixels.
    cell: f32,
    columns: usize,
    rows: usize,
    /// Infinite where there is no point.
    depths: Vec<f32>,
}

impl DepthMap {
    fn new(points: &[[f32; 3]], pinhole: &Pinhole<f32>) -> Self {
        let seen: Vec<([f32; 2], f32)> = points
            .iter()
            .filter(|point| pinhole.pixel(**point).is_some())
            .filter_map(|point| pinhole.project(*point))
            .collect();
        let pixels = (pinhole.width * pinhole.height) as f64;
        let cell = (POINTS_A_CELL * pixels / seen.len().max(1) as f64).sqrt().max(1.0) as f32;
        let cells = |side: usize| (side as f32 / cell).ceil().max(1.0) as usize;
        let (columns, rows) = (cells(pinhole.width), cells(pinhole.height));
        let mut map = Self { cell, columns, rows, depths: vec![f32::INFINITY; columns * rows] };
        for (place, depth) in seen {
            if let Some(i) = map.index(place) {
                map.depths[i] = map.depths[i].min(depth);
            }
        }
        map
    }

    fn index(&self, [x, y]: [f32; 2]) -> Option<usize> {
        let of = |at: f32, count: usize| {
            let cell = (at / self.cell).floor();
            (cell >= 0.0 && cell < count as f32).then_some(cell as usize)
        };
        Some(of(y, self.rows)? * self.columns + of(x, self.columns)?)
    }

    /// Depth at a place of the image; none where no point is near.
    fn at(&self, place: [f32; 2]) -> Option<f32> {
        let depth = self.depths[self.index(place)?];
        depth.is_finite().then_some(depth)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(x: f64) -> Camera {
        Camera::look_at([x, 0.0, -2.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 40, 30)
    }

    /// A wall at z = 0.
    fn wall() -> PointCloud {
        let points = (0..8100).map(|i| [0.05 * (i % 90) as f32 - 2.25, 0.05 * (i / 90) as f32 - 2.25, 0.0]).collect();
        PointCloud { points, colors: vec![[0.5; 3]; 8100], foreground: vec![false; 8100] }
    }

    #[test]
    fn two_cameras_are_witnesses_of_what_both_see() {
        let all = |count: usize| {
            let training: Vec<Camera> = (0..count).map(|i| camera(0.2 * i as f64)).collect();
            share(&Surfaces::new(&wall(), &training).seen(&camera(0.1)), true)
        };
        assert!(all(2) > 0.9, "{}", all(2));
        assert_eq!(all(1), 0.0);
    }

    #[test]
    fn what_hangs_before_the_wall_is_marked() {
        let surfaces = Surfaces::new(&wall(), &[camera(0.0)]);
        let gaussians = Activated {
            means: vec![[0.0, 0.0, -1.0], [0.0, 0.0, 0.01], [0.0, 0.0, 1.0]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 3],
            scales: vec![[0.1; 3]; 3],
            opacities: vec![0.5; 3],
            colors: vec![0.0; 9],
            num_channels: 3,
            is_antialiased: false,
            background: Vec::new(),
        };
        let marked = surfaces.mark_free(&gaussians, &camera(0.0));
        assert_eq!((marked.colors, marked.num_channels), (vec![1.0, 0.0, 0.0], 1));
    }
}
