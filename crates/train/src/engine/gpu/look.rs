//! The gate's look on a GPU.

use std::sync::{Arc, Mutex, PoisonError};

use tcgs_core::{Activated, Camera, Image, Pinhole, dot};
use tcgs_render::gpu::{Gpu, GpuRasterizer};
use tcgs_render::{Draw, RenderSettings, TileMask};

use crate::TrainError;
use crate::engine::LookRenderer;

/// Channels that [`GpuLook::weights`] draws: the position of a Gaussian's centre, and 1. For any camera a pixel's depth
/// follows from them, so that all views draw the same Gaussians.
const CHANNELS: usize = 4;

/// Draws on a GPU. Weights and pictures have buffers of their own, which fit all views.
#[derive(Debug)]
pub(crate) struct GpuLook {
    weights: GpuRasterizer,
    pictures: GpuRasterizer,
    placed: Mutex<Option<Placed>>,
}

/// The Gaussians of a look.
#[derive(Debug)]
struct Placed {
    given: Arc<Activated>,
    /// The same with their positions as colours.
    drawn: Arc<Activated>,
}

impl GpuLook {
    pub fn new(gpu: &Gpu) -> Self {
        Self { weights: GpuRasterizer::new(gpu), pictures: GpuRasterizer::new(gpu), placed: Mutex::default() }
    }

    fn placed(&self, gaussians: &Arc<Activated>) -> Arc<Activated> {
        let mut placed = self.placed.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(placed) = placed.as_ref().filter(|placed| Arc::ptr_eq(&placed.given, gaussians)) {
            return Arc::clone(&placed.drawn);
        }
        let drawn = Arc::new(Activated {
            colors: gaussians.means.iter().flat_map(|&[x, y, z]| [x, y, z, 1.0]).collect(),
            num_channels: CHANNELS,
            background: Vec::new(),
            ..Activated::clone(gaussians)
        });
        *placed = Some(Placed { given: Arc::clone(gaussians), drawn: Arc::clone(&drawn) });
        drawn
    }
}

impl LookRenderer for GpuLook {
    fn weights(
        &self,
        gaussians: &Arc<Activated>,
        camera: &Camera,
        shares: &Image,
        with_depths: bool,
    ) -> Result<(Vec<[f32; 2]>, Image), TrainError> {
        let (width, height) = (camera.width, camera.height);
        let mut all_shares = Image::filled(width, height, CHANNELS, 0.0);
        all_shares.data[..shares.data.len()].copy_from_slice(&shares.data);
        let (places, weights) = self.weights.picture_and_weights(&self.placed(gaussians), camera, &all_shares)?;
        let weights = weights.as_chunks::<CHANNELS>().0.iter().map(|&[first, second, ..]| [first, second]).collect();
        if !with_depths {
            return Ok((weights, Image::default()));
        }
        let pinhole = Pinhole::<f32>::new(camera);
        let (forward, offset) = (pinhole.rotation[2], pinhole.translation[2]);
        let mut depths = Image::filled(width, height, 2, 0.0);
        for pixel in 0..width * height {
            let [x, y, z, weight] = std::array::from_fn(|channel| places.plane(channel)[pixel]);
            depths.plane_mut(0)[pixel] = dot(forward, [x, y, z]) + offset * weight;
            depths.plane_mut(1)[pixel] = weight;
        }
        Ok((weights, depths))
    }

    fn picture(&self, gaussians: &Arc<Activated>, camera: &Camera, tiles: &TileMask) -> Result<Image, TrainError> {
        if tiles.is_empty() {
            return Ok(Image::filled(camera.width, camera.height, 1, 0.0));
        }
        Ok(self.pictures.draw(gaussians, camera, &RenderSettings::default())?.0.image)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::cpu::CpuLook;
    use crate::engine::gpu::test_support::gpu;

    #[test]
    fn both_devices_find_the_same_weights_and_pictures() {
        let Some(gpu) = gpu() else { return };
        let n = 60;
        let place = |i: usize| [(0.37 * i as f32).sin(), (0.53 * i as f32).cos(), 0.4 * (0.11 * i as f32).sin()];
        let gaussians = Arc::new(Activated {
            means: (0..n).map(place).collect(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
            scales: (0..n).map(|i| [0.05 + 0.002 * i as f32, 0.1, 0.02]).collect(),
            opacities: (0..n).map(|i| 0.2 + 0.01 * i as f32).collect(),
            colors: vec![0.3; 3 * n],
            num_channels: 3,
            background: vec![0.5; 3],
            ..Activated::default()
        });
        let camera = Camera::look_at([0.3, 0.1, -3.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 70, 50);
        let mut shares = Image::filled(70, 50, 2, 1.0);
        shares.plane_mut(0).iter_mut().enumerate().for_each(|(i, share)| *share = f32::from(u8::from(i % 70 < 31)));
        let look = GpuLook::new(&gpu);
        let [(own, depths), (expected, by_cpu)] = [&look as &dyn LookRenderer, &CpuLook]
            .map(|renderer| renderer.weights(&gaussians, &camera, &shares, true).unwrap());
        assert!(expected.iter().any(|[changed, whole]| *changed > 1.0 && *whole > changed + 1.0));
        for (i, (own, expected)) in own.iter().zip(&expected).enumerate() {
            let is_near = (0..2).all(|k| (own[k] - expected[k]).abs() <= 1e-3 + 1e-4 * expected[k]);
            assert!(is_near, "Gaussian {i}: {own:?} on the GPU, {expected:?} on the CPU");
        }
        assert!(depths.data.iter().zip(&by_cpu.data).all(|(a, b)| (a - b).abs() < 1e-4));
        let (without, none) = look.weights(&gaussians, &camera, &shares, false).unwrap();
        assert!(without == own && none.data.is_empty());
        // Other Gaussians are loaded.
        let half = Arc::new(gaussians.select(&(0..n / 2).collect::<Vec<_>>()));
        let of_half = look.weights(&half, &camera, &shares, false).unwrap().0;
        assert!(of_half.len() == n / 2 && of_half.iter().zip(&own).any(|(half, all)| half[1] > all[1] + 1.0));

        let one = Arc::new(Activated {
            colors: vec![1.0; n],
            num_channels: 1,
            background: Vec::new(),
            ..Activated::clone(&gaussians)
        });
        let some = tcgs_render::tiles_reached(&one.select(&[3]), &camera);
        let [own, expected] =
            [&look as &dyn LookRenderer, &CpuLook].map(|renderer| renderer.picture(&one, &camera, &some).unwrap());
        for (i, (own, expected)) in own.data.iter().zip(&expected.data).enumerate() {
            if some.contains(some.of_pixel([i % 70, i / 70])) {
                assert!((own - expected).abs() < 1e-4, "pixel {i}: {own} {expected}");
            }
        }
        let nothing = TileMask::none(70, 50);
        assert!(look.picture(&one, &camera, &nothing).unwrap().data.iter().all(|x| *x == 0.0));
    }
}
