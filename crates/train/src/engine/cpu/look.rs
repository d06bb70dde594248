//! The gate's look on the CPU.

use std::sync::Arc;

use tcgs_core::{Activated, Camera, Image, Pinhole};
use tcgs_render::{CpuRasterizer, CpuTiles, Laps, RenderSettings, Scope, TileMask};

use crate::TrainError;
use crate::engine::LookRenderer;

/// Draws on the CPU.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CpuLook;

impl LookRenderer for CpuLook {
    fn weights(
        &self,
        gaussians: &Arc<Activated>,
        camera: &Camera,
        shares: &Image,
        with_depths: bool,
    ) -> Result<(Vec<[f32; 2]>, Image), TrainError> {
        let tiles = CpuTiles::new(gaussians, camera);
        let weights = tiles.weights(shares).as_chunks().0.to_vec();
        if !with_depths {
            return Ok((weights, Image::default()));
        }
        let pinhole = Pinhole::<f32>::new(camera);
        let depths: Vec<f32> = gaussians.means.iter().flat_map(|&mean| [pinhole.camera_point(mean)[2], 1.0]).collect();
        Ok((weights, tiles.draw(&depths, 2)))
    }

    fn picture(&self, gaussians: &Arc<Activated>, camera: &Camera, tiles: &TileMask) -> Result<Image, TrainError> {
        let mut picture = Image::filled(camera.width, camera.height, 1, 0.0);
        let settings = RenderSettings::default();
        CpuRasterizer.forward_in(gaussians, camera, &settings, Scope::Tiles(tiles), &mut picture, &mut Laps::begin());
        Ok(picture)
    }
}
