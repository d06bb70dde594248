//! The passes from activated Gaussians to an image and back, on buffers that stay on the GPU.
//!
//! Forward, `N` Gaussians, `P` pairs, `T` tiles, `C` channels; 4 bytes a value:
//!
//! | stage | reads | writes |
//! |---|---|---|
//! | project | 11 N | 11 N |
//! | sort by depth | 4 passes x 3 N | 4 passes x 2 N |
//! | bin | 2 N + 11 visible | 3 P |
//! | sort by tile | 1 or 2 passes x 3 P | 1 or 2 passes x 2 P |
//! | rasterize | (8 + C) P | (1 + C) pixels, and with backward 8 (1 + C) P of checkpoints |
//! | rasterize backward | (8 + C) P + 8 (1 + C) P + 2 C pixels | (8 + C) P |
//! | project backward | (8 + C) P + 11 N | (14 + C) N |
//!
//! Depths are sorted once over all Gaussians, culled ones last. Pairs are written in that order and then sorted stably
//! by tile, so pairs need only 8 or 16 bits. Nothing is read back: the number of pairs sizes dispatches on the GPU.
//! There are no atomics: each pair's gradient has a place of its own, and a Gaussian's pairs are contiguous.

use tcgs_core::Camera;

use super::radix::{Dispatch, Radix};
use super::raw::Bound;
use super::{Gpu, GpuError};
use crate::device::{
    Capacity, Coverage, MAX_THREADS, RenderSources, SORT_BLOCK, VISIBLE, ViewPart, ViewUniform, WORKGROUP,
    activated_len,
};
use crate::settings::MAX_CHANNELS;
use crate::{PairCounts, RenderSettings};

/// Binding of the lists of parts.
const LISTS: u32 = 13;

/// Buffers of a renderer that other operations fill or read.
#[derive(Clone, Debug)]
pub struct RenderBuffers {
    /// `[(11 + C) N]` means, unit quats, scales, opacities, colors of the drawn Gaussians.
    pub activated: wgpu::Buffer,
    /// `[C + 1, H, W]` colours with background, then transmittance.
    pub image: wgpu::Buffer,
    /// `[C, H, W]` gradient to the image.
    pub v_image: wgpu::Buffer,
    /// `[(11 + C) R]` gradient to `activated`, or to its first rows if a view draws a part.
    pub v_activated: wgpu::Buffer,
    /// `[R, 3]` the densification statistic's x and y, and 1 where the Gaussian is visible.
    pub v_means2d_ndc: wgpu::Buffer,
    /// `u32 [4]`: not 0 after an iteration needed more pairs than the capacity; most pairs needed then; pairs needed by
    /// the last iteration. The first value stays set until the host clears it, and all results since are invalid.
    pub status: wgpu::Buffer,
}

/// Lists of the Gaussians and tiles that each view draws.
#[derive(Clone, Copy, Debug)]
pub struct PartLists<'a> {
    /// `u32`, the lists of all views. `listed.wgsl` describes their contents, and [`ViewPart`] has the offset of a
    /// view's lists.
    pub lists: &'a wgpu::Buffer,
    /// `R`, number of rows of gradients.
    pub num_rows: usize,
}

/// Kernels and buffers of the renderer, for one number of Gaussians and channels. Its methods record the stages of an
/// image in the order *project, sort, rasterize, rasterize backward, project backward*.
#[derive(Debug)]
pub struct GpuRenderer {
    capacity: Capacity,
    gpu: Gpu,
    buffers: RenderBuffers,
    view: wgpu::Buffer,
    arguments: wgpu::Buffer,
    tile_counts: wgpu::Buffer,
    /// `[1]` number of Gaussians that the next view lists, whose depths are sorted.
    count: wgpu::Buffer,
    /// The part that the next view draws.
    part: ViewPart,
    project: Bound,
    sort_depths: Radix,
    bin_count: Bound,
    bin_scan: Bound,
    bin_emit: Bound,
    sort_tiles: Radix,
    bin_ranges: Bound,
    bin_buckets: Bound,
    rasterize: Bound,
    backward: Option<(Bound, Bound)>,
}

impl GpuRenderer {
    /// Allocates all buffers and compiles the kernels.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if a buffer does not fit; [`GpuError::Unfit`] if there are more Gaussians or pairs than one
    /// dispatch takes.
    ///
    /// # Panics
    /// If the number of channels is not in `1..=MAX_CHANNELS`.
    pub fn new(gpu: &Gpu, capacity: Capacity) -> Result<Self, GpuError> {
        Self::of_gaussians(gpu, capacity, &gpu.storage("activated Gaussians", capacity.activated_len())?)
    }

    /// The same with a buffer of Gaussians that outlives the renderer.
    ///
    /// - `activated`: [`RenderBuffers::activated`]
    ///
    /// # Errors
    /// As [`Self::new`].
    ///
    /// # Panics
    /// As [`Self::new`].
    pub fn of_gaussians(gpu: &Gpu, capacity: Capacity, activated: &wgpu::Buffer) -> Result<Self, GpuError> {
        Self::build(gpu, capacity, activated, None)
    }

    /// The same for views that draw parts: [`Self::set_part`].
    ///
    /// - `capacity`: its number of tiles is the maximum per view
    ///
    /// # Errors
    /// As [`Self::new`].
    ///
    /// # Panics
    /// As [`Self::new`].
    pub fn of_parts(
        gpu: &Gpu,
        capacity: Capacity,
        activated: &wgpu::Buffer,
        lists: PartLists<'_>,
    ) -> Result<Self, GpuError> {
        Self::build(gpu, capacity, activated, Some(lists))
    }

    fn build(
        gpu: &Gpu,
        capacity: Capacity,
        activated: &wgpu::Buffer,
        parts: Option<PartLists<'_>>,
    ) -> Result<Self, GpuError> {
        let Capacity { num_gaussians: n, num_channels: c, num_pixels, num_pairs: p, backward, .. } = capacity;
        assert!((1..=MAX_CHANNELS).contains(&c), "{c} channels, expected 1 to {MAX_CHANNELS}");
        if n > MAX_THREADS {
            let problem = format!("would have to draw {n} Gaussians, expected at most {MAX_THREADS}");
            return Err(GpuError::Unfit { name: gpu.info().name.clone(), problem });
        }
        let if_backward = |len: usize| if backward { len } else { 1 };
        let num_rows = parts.map_or(n, |parts| parts.num_rows);
        let view = gpu.uniform("the view", size_of::<ViewUniform>())?;
        let buffers = RenderBuffers {
            activated: activated.clone(),
            image: gpu.storage("the image", capacity.image_len())?,
            v_image: gpu.storage("the image's gradient", if_backward(c * num_pixels))?,
            v_activated: gpu.storage("gradients of activated Gaussians", if_backward(activated_len(num_rows, c)))?,
            v_means2d_ndc: gpu.storage("the statistic's gradients", if_backward(3 * num_rows))?,
            status: gpu.storage("status", 4)?,
        };
        let splats = gpu.storage("splats", 8 * n)?;
        let keys = [gpu.storage("depths", n)?, gpu.storage("depths", n)?];
        let values = [gpu.storage("depth order", n)?, gpu.storage("depth order", n)?];
        let tile_counts = gpu.storage("tile counts", n)?;
        let block_sums = gpu.storage("block sums", n.div_ceil(WORKGROUP as usize))?;
        let pair_keys = [gpu.storage("pairs' tiles", p)?, gpu.storage("pairs' tiles", p)?];
        let pair_values = [gpu.storage("pairs", p)?, gpu.storage("pairs", p)?];
        let pair_gaussian = gpu.storage("pairs' Gaussians", p)?;
        let pair_first = gpu.storage("first pairs", n)?;
        let num_pairs = gpu.storage("number of pairs", 1)?;
        let arguments = gpu.storage("dispatch arguments", 6)?;
        let tiles = gpu.storage("tiles", capacity.tiles_len())?;
        let checkpoints = gpu.storage("checkpoints", if_backward(capacity.checkpoints_len()))?;
        let v_pairs = gpu.storage("gradients of pairs", if_backward(capacity.pair_grads_len()))?;

        let count = gpu.upload("number of Gaussians", &[n as u32])?;
        let sort_depths = Radix::new(gpu, [&keys[0], &keys[1]], [&values[0], &values[1]], &count, n, 32)?;
        let order = &values[sort_depths.result_index()];
        let sort_tiles = Radix::new(
            gpu,
            [&pair_keys[0], &pair_keys[1]],
            [&pair_values[0], &pair_values[1]],
            &num_pairs,
            p,
            capacity.tile_bits(),
        )?;
        let sorted = sort_tiles.result_index();

        let coverage = if parts.is_some() { Coverage::Listed } else { Coverage::Whole };
        let RenderSources { project, bin, rasterize_fwd: fwd, rasterize_bwd: bwd } =
            RenderSources::new(c, backward, coverage);
        let device = gpu.device();
        let bind = |source: &str, entry, buffers: &[(u32, &wgpu::Buffer)]| {
            let with_view: Vec<_> = std::iter::once((0, &view)).chain(buffers.iter().copied()).collect();
            gpu.kernel(source, entry).bind(device, &with_view)
        };
        // Like `bind`, for a kernel that reads the lists if there are any.
        let bind_listed = |source: &str, entry, buffers: &[(u32, &wgpu::Buffer)]| {
            let lists = parts.map(|parts| (LISTS, parts.lists));
            bind(source, entry, &buffers.iter().copied().chain(lists).collect::<Vec<_>>())
        };
        let activated = &buffers.activated;
        let renderer = Self {
            project: bind_listed(
                &project,
                "project_fwd",
                &[(1, activated), (2, &splats), (3, &keys[0]), (4, &values[0]), (5, &tile_counts)],
            ),
            bin_count: bind(&bin, "bin_count", &[(2, order), (3, &tile_counts), (4, &block_sums)]),
            bin_scan: bind(
                &bin,
                "bin_scan",
                &[(4, &block_sums), (9, &buffers.status), (10, &num_pairs), (11, &arguments)],
            ),
            bin_emit: bind_listed(
                &bin,
                "bin_emit",
                &[
                    (1, &splats),
                    (2, order),
                    (3, &tile_counts),
                    (4, &block_sums),
                    (5, &pair_keys[0]),
                    (6, &pair_values[0]),
                    (7, &pair_gaussian),
                    (8, &pair_first),
                ],
            ),
            bin_ranges: bind(&bin, "bin_ranges", &[(5, &pair_keys[sorted]), (10, &num_pairs), (12, &tiles)]),
            bin_buckets: bind(&bin, "bin_buckets", &[(11, &arguments), (12, &tiles)]),
            rasterize: bind_listed(
                &fwd,
                "rasterize_fwd",
                &[
                    (1, &splats),
                    (2, activated),
                    (3, &pair_gaussian),
                    (4, &pair_values[sorted]),
                    (5, &tiles),
                    (6, &buffers.image),
                    (7, &checkpoints),
                ],
            ),
            backward: backward.then(|| {
                let rasterize = bind_listed(
                    &bwd,
                    "rasterize_bwd",
                    &[
                        (1, &splats),
                        (2, activated),
                        (3, &pair_gaussian),
                        (4, &pair_values[sorted]),
                        (5, &tiles),
                        (6, &buffers.image),
                        (7, &buffers.v_image),
                        (8, &checkpoints),
                        (9, &v_pairs),
                    ],
                );
                let project = bind(
                    &project,
                    "project_bwd",
                    &[
                        (1, activated),
                        (5, &tile_counts),
                        (6, &pair_first),
                        (7, &v_pairs),
                        (8, &buffers.v_activated),
                        (9, &buffers.v_means2d_ndc),
                    ],
                );
                (rasterize, project)
            }),
            sort_depths,
            sort_tiles,
            capacity,
            gpu: gpu.clone(),
            view,
            arguments,
            tile_counts,
            count,
            part: ViewPart { num_listed: 0, num_rows: 0, num_active: 0, num_tiles: 0, lists_at: 0 },
            buffers,
        };
        gpu.check()?;
        Ok(renderer)
    }

    /// Capacity of the buffers.
    pub fn capacity(&self) -> &Capacity {
        &self.capacity
    }

    /// Buffers that other operations fill or read.
    pub fn buffers(&self) -> &RenderBuffers {
        &self.buffers
    }

    /// Numbers of pairs and splats in the last image; reads back, and waits for the GPU.
    ///
    /// # Errors
    /// An error that occurred meanwhile.
    pub fn read_counts(&self) -> Result<PairCounts, GpuError> {
        let counts: Vec<u32> = self.gpu.read(&self.tile_counts, self.capacity.num_gaussians)?;
        let tiles = counts.iter().map(|count| (count & !VISIBLE) as usize);
        Ok(PairCounts { pairs: tiles.clone().sum(), splats: tiles.filter(|&tiles| tiles > 0).count() })
    }

    /// Sets the camera of all passes submitted afterwards.
    ///
    /// - `antialiased`: [`Activated::is_antialiased`](tcgs_core::Activated) of the drawn Gaussians
    ///
    /// # Panics
    /// If its image is larger than the capacity.
    pub fn set_view(&mut self, camera: &Camera, settings: &RenderSettings, antialiased: bool) {
        self.set(&ViewUniform::new(camera, settings, antialiased, &self.capacity));
    }

    /// Sets the camera of all passes submitted afterwards, and the part of the scene and of the image that they draw.
    /// All other pixels keep their values.
    ///
    /// # Panics
    /// If its image or the part is larger than the capacity.
    pub fn set_part(&mut self, camera: &Camera, settings: &RenderSettings, antialiased: bool, part: ViewPart) {
        self.set(&ViewUniform::of_part(camera, settings, antialiased, &self.capacity, part));
    }

    fn set(&mut self, uniform: &ViewUniform) {
        self.part = uniform.part;
        self.gpu.queue().write_buffer(&self.view, 0, bytemuck::bytes_of(uniform));
        self.gpu.queue().write_buffer(&self.count, 0, &uniform.part.num_listed.to_le_bytes());
    }

    fn num_listed(&self) -> usize {
        self.part.num_listed as usize
    }

    /// Records *project*: `activated` to splats, with the tiles that each reaches.
    pub fn project(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.project.dispatch_over(pass, self.num_listed());
    }

    /// Records *sort*: splats to each tile's list, front to back.
    pub fn sort(&self, pass: &mut wgpu::ComputePass<'_>) {
        let n = self.num_listed();
        self.sort_depths.record(pass, Dispatch::Blocks(n.div_ceil(SORT_BLOCK) as u32));
        self.bin_count.dispatch_over(pass, n);
        self.bin_scan.dispatch(pass, [1, 1, 1]);
        self.bin_emit.dispatch_over(pass, n);
        self.sort_tiles.record(pass, Dispatch::Indirect(&self.arguments, 0));
        self.bin_ranges.dispatch_over(pass, self.part.num_tiles as usize + 1);
        self.bin_buckets.dispatch(pass, [1, 1, 1]);
    }

    /// Records *rasterize*: overwrites `image` with each tile's list, blended.
    pub fn rasterize(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.rasterize.dispatch_groups(pass, self.part.num_tiles as usize);
    }

    /// Records *rasterize backward*, after the forward stages: `v_image` to the gradients of pairs.
    ///
    /// # Panics
    /// If the capacity has no room for backward.
    pub fn rasterize_bwd(&self, pass: &mut wgpu::ComputePass<'_>) {
        let (rasterize, _) = self.backward.as_ref().expect("a renderer with backward");
        rasterize.dispatch_indirect(pass, &self.arguments, 12);
    }

    /// Records *project backward*, after [`Self::rasterize_bwd`]: overwrites `v_activated` and `v_means2d_ndc`.
    ///
    /// # Panics
    /// If the capacity has no room for backward.
    pub fn project_bwd(&self, pass: &mut wgpu::ComputePass<'_>) {
        let (_, project) = self.backward.as_ref().expect("a renderer with backward");
        project.dispatch_over(pass, self.part.num_rows as usize);
    }
}
