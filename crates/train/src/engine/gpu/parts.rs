//! The scenery of a timestep in the GPU's memory.

use tcgs_render::device::Capacity;
use tcgs_render::gpu::{Gpu, GpuError};

use crate::engine::device::{ListedView, PartPlace, SceneryLists};
use crate::engine::{Scenery, Target};

/// The scenery of a timestep that trains a part of the scene. Only the values of the rows change before the timestep
/// ends.
#[derive(Debug)]
pub(super) struct Parts {
    /// `[(11 + C) D]`, rows of the state first; each iteration overwrites these.
    pub activated: wgpu::Buffer,
    /// [`SceneryLists::lists`]
    pub lists: wgpu::Buffer,
    /// [`SceneryLists::pictures`]
    pub pictures: wgpu::Buffer,
    /// [`SceneryLists::colors`]; room for one where there are none.
    pub colors: wgpu::Buffer,
    /// Most Gaussians that a view draws.
    pub max_listed: usize,
    /// Most blocks of an image that are compared.
    pub max_blocks: usize,
    pub num_rows: usize,
    pub num_active: usize,
    max_tiles: usize,
    num_drawn: usize,
    views: Vec<ListedView>,
}

impl Parts {
    /// Copies the scenery to the GPU.
    ///
    /// - returns: also the words of the targets, and where each view's begin: those of pixels that are compared
    pub fn new(gpu: &Gpu, scenery: &Scenery, targets: &[Target]) -> Result<(Self, Vec<u32>, Vec<u32>), GpuError> {
        let all = SceneryLists::new(scenery, targets);
        let [max_tiles, max_blocks] = all.max_tiles();
        let offsets = all.views.iter().map(|view| view.targets_at).collect();
        let parts = Self {
            activated: gpu.upload("activated Gaussians", &all.activated)?,
            lists: gpu.upload("lists of what is drawn", &all.lists)?,
            pictures: gpu.upload("pixels around what is drawn", &all.pictures)?,
            colors: match all.colors.is_empty() {
                true => gpu.storage("colours that views see", 1)?,
                false => gpu.upload("colours that views see", &all.colors)?,
            },
            max_listed: all.max_listed(),
            max_blocks,
            num_rows: all.num_rows,
            num_active: scenery.num_active,
            max_tiles,
            num_drawn: all.num_drawn,
            views: all.views,
        };
        Ok((parts, all.targets, offsets))
    }

    /// The part of the scene that a view draws, and its position in memory.
    ///
    /// # Panics
    /// If it draws nothing.
    pub fn place(&self, camera: usize) -> PartPlace {
        let view = self.views[camera];
        assert!(view.part.num_tiles > 0, "an iteration on view {camera}, in which nothing is drawn");
        PartPlace { num_drawn: self.num_drawn as u32, view }
    }

    /// `whole` with room for what is drawn instead of everything.
    pub fn capacity(&self, whole: Capacity) -> Capacity {
        let (num_gaussians, num_tiles) = (self.num_drawn, self.max_tiles);
        Capacity { num_gaussians, num_tiles, num_pairs: 2 * num_gaussians + 16 * num_tiles, ..whole }
    }
}
