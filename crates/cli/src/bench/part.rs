//! A part of a scene as the gate trains it: about a sixth of the Gaussians, in the tiles that they reach.

use std::sync::Arc;

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;
use tcgs_core::{Image, squared_distance, upper_median};
use tcgs_pipeline::Backend;
use tcgs_render::{RenderSettings, gaussians_reaching, tiles_reached};
use tcgs_train::engine::cpu::drawn;
use tcgs_train::engine::{Scenery, ViewScenery};
use tcgs_train::{State, TrainConfig};

use super::scene::{BenchScene, later_timestep};

/// Share of active Gaussians: that of a later timestep of Panoptic's basketball, `docs/PERFORMANCE.md`.
const ACTIVE: f64 = 0.15;

/// Inputs of an iteration that trains a part.
pub struct Part {
    /// The active Gaussians; none is held.
    pub state: State,
    pub scenery: Scenery,
    /// Positions of the views that have something to draw.
    pub cameras: Vec<usize>,
    /// Share of the tiles of all views that is drawn.
    pub tiles: f64,
}

impl Part {
    /// Takes the Gaussians nearest to the middle of the scene.
    pub fn new(backend: &Backend, scene: &BenchScene) -> anyhow::Result<Self> {
        let whole = &scene.state.parameters;
        let rows = nearest(whole.gaussians.means(), ACTIVE);
        let state = later_timestep(whole.select(&rows), &mut Pcg64Mcg::seed_from_u64(0))?;
        let with_segmentation = scene.targets[0].image.num_channels > 3;
        let mask = TrainConfig::default().mask;
        let all = Arc::new(drawn(&scene.state, &mask, with_segmentation));
        let active = all.select(&rows);
        let renderer = backend.renderer();
        let (mut num_drawn, mut num_tiles) = (0, 0);
        let mut views = Vec::new();
        for camera in scene.cameras() {
            let tiles = tiles_reached(&active, &camera);
            num_drawn += tiles.len();
            num_tiles += tiles.grid()[0] * tiles.grid()[1];
            let (mut gaussians, mut picture) = (Vec::new(), Image::default());
            if !tiles.is_empty() {
                gaussians = gaussians_reaching(&all, &camera, &tiles);
                gaussians.extend(rows.iter().map(|&i| i as u32));
                gaussians.sort_unstable();
                gaussians.dedup();
                picture = renderer.draw(&all, &camera, &RenderSettings::default())?.0.image;
            }
            views.push(ViewScenery { tiles, gaussians, colors: None, picture });
        }
        let cameras = (0..views.len()).filter(|&i| !views[i].tiles.is_empty()).collect();
        let places = rows.iter().map(|&i| i as u32).collect();
        let scenery = Scenery { num_active: rows.len(), drawn: (*all).clone(), places, views };
        Ok(Self { state, scenery, cameras, tiles: f64::from(num_drawn as u32) / f64::from(num_tiles as u32) })
    }
}

/// Ascending indices of a share of the points, at least one: those nearest to the median point.
fn nearest(points: &[[f32; 3]], share: f64) -> Vec<usize> {
    let middle = [0, 1, 2].map(|axis| upper_median(points.iter().map(|point| point[axis])).unwrap_or_default());
    let distance = |i: usize| squared_distance(points[i], middle);
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
    order.truncate(((share * points.len() as f64) as usize).max(1));
    order.sort_unstable();
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_to_the_middle_are_taken() {
        let points: Vec<[f32; 3]> = [9.0, 1.0, 4.0, 5.0, 5.9, -3.0, 5.5].map(|x| [x, 0.0, 0.0]).to_vec();
        assert_eq!(nearest(&points, 0.43), [3, 4, 6]);
        assert_eq!(nearest(&points, 0.0), [3]);
    }
}
