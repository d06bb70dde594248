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
//! Depths are sorted once over all Gaussians, culled ones last; pairs are written in that order and then parted
//! stably by tile, so pairs are sorted by 8 or 16 bits alone. Nothing is read back: the number of pairs sizes dispatches on the GPU.
//! No atomics: each pair's gradient has a place of its own, and a Gaussian's pairs lie in a row.

use bytemuck::{Pod, Zeroable};
use tcgs_core::Camera;

use super::radix::{Dispatch, Radix, SORT_BLOCK};
use super::source::{BUCKET, VISIBLE, source};
use super::{Bound, Gpu, GpuError, MAX_THREADS, WORKGROUP};
use crate::device::activated_len;
use crate::settings::MAX_CHANNELS;
use crate::tiling::{PAIR_GRADS, TILE, tile_grid};
use crate::{PairCounts, Pinhole, RenderSettings};

/// Sources of the renderer's shaders, by name.
///
/// - `keeps`: whether forward keeps what backward needs
pub(super) fn sources(num_channels: usize, keeps: bool) -> [(&'static str, String); 4] {
    let view = include_str!("view.wgsl");
    let reach = include_str!("reach.wgsl");
    let source = || source(num_channels).part(view);
    [
        ("project", source().part(reach).part(include_str!("project.wgsl"))),
        ("bin", source().part(reach).part(include_str!("bin.wgsl"))),
        ("rasterize_fwd", source().constant("KEEPS", keeps).part(include_str!("rasterize_fwd.wgsl"))),
        ("rasterize_bwd", source().part(include_str!("rasterize_bwd.wgsl"))),
    ]
    .map(|(name, source)| (name, source.finish()))
}

/// What a [`GpuRenderer`]'s buffers hold at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capacity {
    /// `N`, exactly.
    pub num_gaussians: usize,
    /// `C`, 1 to 8, exactly.
    pub num_channels: usize,
    /// Of an image.
    pub num_pixels: usize,
    /// Of an image.
    pub num_tiles: usize,
    /// Combinations of a tile and a splat that reaches it.
    pub num_pairs: usize,
    /// Whether backward is wanted.
    pub backward: bool,
}

impl Capacity {
    /// Room for images of any of the cameras, and a first guess of the pairs.
    pub fn new<'a>(
        num_gaussians: usize,
        num_channels: usize,
        cameras: impl IntoIterator<Item = &'a Camera>,
        backward: bool,
    ) -> Self {
        let (mut num_pixels, mut num_tiles) = (1, 1);
        for camera in cameras {
            num_pixels = num_pixels.max(camera.width * camera.height);
            let [columns, rows] = tile_grid(camera.width, camera.height);
            num_tiles = num_tiles.max(columns * rows);
        }
        let num_pairs = 2 * num_gaussians + 16 * num_tiles;
        Self { num_gaussians, num_channels, num_pixels, num_tiles, num_pairs, backward }
    }

    fn num_buckets(&self) -> usize {
        self.num_pairs / BUCKET + self.num_tiles
    }
}

#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
struct ViewUniform {
    rows: [[f32; 4]; 3],
    focal: [f32; 2],
    principal: [f32; 2],
    slope_min: [f32; 2],
    slope_max: [f32; 2],
    size: [u32; 2],
    grid: [u32; 2],
    num_gaussians: u32,
    pair_capacity: u32,
    statistic_channels: u32,
    unused: u32,
    background: [f32; MAX_CHANNELS],
}

/// The buffers that others fill or read.
#[derive(Clone, Debug)]
pub struct RenderBuffers {
    /// `[(11 + C) N]` means, unit quats, scales, opacities, colors: what is drawn.
    pub activated: wgpu::Buffer,
    /// `[C + 1, H, W]` colours with background, then transmittance.
    pub image: wgpu::Buffer,
    /// `[C, H, W]` gradient to the image.
    pub v_image: wgpu::Buffer,
    /// `[(11 + C) N]` gradient to `activated`.
    pub v_activated: wgpu::Buffer,
    /// `[N, 3]` the densification statistic's x and y, and 1 where the Gaussian is visible.
    pub v_means2d_ndc: wgpu::Buffer,
    /// `u32 [4]`: not 0 once an iteration needed more pairs than there is room for; most pairs needed then; pairs that
    /// the last one needed. It stays set until the host clears it: nothing that was computed since is valid.
    pub status: wgpu::Buffer,
}

/// The GPU's renderer for one number of Gaussians and channels.
#[derive(Debug)]
pub struct GpuRenderer {
    capacity: Capacity,
    gpu: Gpu,
    buffers: RenderBuffers,
    view: wgpu::Buffer,
    arguments: wgpu::Buffer,
    tile_counts: wgpu::Buffer,
    grid: [usize; 2],
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
    /// Allocates everything.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if something does not fit; [`GpuError::Unfit`] if there are more Gaussians or pairs than one
    /// dispatch takes.
    ///
    /// # Panics
    /// If the number of channels is not in `1..=MAX_CHANNELS`.
    pub fn new(gpu: &Gpu, capacity: Capacity) -> Result<Self, GpuError> {
        let len = activated_len(capacity.num_gaussians, capacity.num_channels);
        Self::of_gaussians(gpu, capacity, &gpu.storage("activated Gaussians", len)?)
    }

    /// Allocates everything but the Gaussians, which outlive the renderer.
    ///
    /// - `activated`: [`RenderBuffers::activated`]
    ///
    /// # Errors
    /// As [`Self::new`].
    ///
    /// # Panics
    /// As [`Self::new`].
    pub fn of_gaussians(gpu: &Gpu, capacity: Capacity, activated: &wgpu::Buffer) -> Result<Self, GpuError> {
        let Capacity { num_gaussians: n, num_channels: c, num_pixels, num_tiles, num_pairs: p, backward } = capacity;
        assert!((1..=MAX_CHANNELS).contains(&c), "{c} channels, expected 1 to {MAX_CHANNELS}");
        if n > MAX_THREADS {
            let problem = format!("would have to draw {n} Gaussians, expected at most {MAX_THREADS}");
            return Err(GpuError::Unfit { name: gpu.info().name.clone(), problem });
        }
        let if_backward = |len: usize| if backward { len } else { 1 };
        let view = gpu.uniform("the view", size_of::<ViewUniform>())?;
        let buffers = RenderBuffers {
            activated: activated.clone(),
            image: gpu.storage("the image", (c + 1) * num_pixels)?,
            v_image: gpu.storage("the image's gradient", if_backward(c * num_pixels))?,
            v_activated: gpu.storage("gradients of activated Gaussians", if_backward(activated_len(n, c)))?,
            v_means2d_ndc: gpu.storage("the statistic's gradients", if_backward(3 * n))?,
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
        let tiles = gpu.storage("tiles", 2 * (num_tiles + 1) + capacity.num_buckets())?;
        let checkpoints = gpu.storage("checkpoints", if_backward(capacity.num_buckets() * (1 + c) * TILE * TILE))?;
        let v_pairs = gpu.storage("gradients of pairs", if_backward(p * (PAIR_GRADS + c)))?;

        let count = gpu.upload("number of Gaussians", &[n as u32])?;
        let sort_depths = Radix::new(gpu, [&keys[0], &keys[1]], [&values[0], &values[1]], &count, n, 32)?;
        let order = &values[sort_depths.result_index()];
        let tile_bits = (usize::BITS - num_tiles.saturating_sub(1).leading_zeros()).max(1);
        let sort_tiles = Radix::new(
            gpu,
            [&pair_keys[0], &pair_keys[1]],
            [&pair_values[0], &pair_values[1]],
            &num_pairs,
            p,
            tile_bits,
        )?;
        let sorted = sort_tiles.result_index();

        let [project, bin, fwd, bwd] = sources(c, backward).map(|(_, source)| source);
        let device = gpu.device();
        let bind = |source: &str, entry, buffers: &[(u32, &wgpu::Buffer)]| {
            let with_view: Vec<_> = std::iter::once((0, &view)).chain(buffers.iter().copied()).collect();
            gpu.kernel(source, entry).bind(device, &with_view)
        };
        let activated = &buffers.activated;
        let renderer = Self {
            project: bind(
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
            bin_emit: bind(
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
            rasterize: bind(
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
                let rasterize = bind(
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
            grid: [0; 2],
            buffers,
        };
        gpu.check()?;
        Ok(renderer)
    }

    /// What the buffers hold.
    pub fn capacity(&self) -> &Capacity {
        &self.capacity
    }

    /// The buffers that others fill or read.
    pub fn buffers(&self) -> &RenderBuffers {
        &self.buffers
    }

    /// What the last image had to blend; reads back, and waits for the GPU.
    ///
    /// # Errors
    /// What has gone wrong meanwhile.
    pub fn read_counts(&self) -> Result<PairCounts, GpuError> {
        let counts: Vec<u32> = self.gpu.read(&self.tile_counts, self.capacity.num_gaussians)?;
        let tiles = counts.iter().map(|count| (count & !VISIBLE) as usize);
        Ok(PairCounts { pairs: tiles.clone().sum(), splats: tiles.filter(|&tiles| tiles > 0).count() })
    }

    /// Chooses the camera of the passes submitted from now on.
    ///
    /// # Panics
    /// If its image is larger than there is room for.
    pub fn set_view(&mut self, camera: &Camera, settings: &RenderSettings) {
        let grid = tile_grid(camera.width, camera.height);
        assert!(
            camera.width * camera.height <= self.capacity.num_pixels && grid[0] * grid[1] <= self.capacity.num_tiles,
            "an image of {}x{}, room for {} pixels",
            camera.width,
            camera.height,
            self.capacity.num_pixels
        );
        self.grid = grid;
        let pinhole = Pinhole::<f32>::new(camera);
        let row = |i: usize| {
            let [x, y, z] = pinhole.rotation[i];
            [x, y, z, pinhole.translation[i]]
        };
        let uniform = ViewUniform {
            rows: [row(0), row(1), row(2)],
            focal: pinhole.focal,
            principal: pinhole.principal,
            slope_min: pinhole.slope_min,
            slope_max: pinhole.slope_max,
            size: [camera.width as u32, camera.height as u32],
            grid: grid.map(|x| x as u32),
            num_gaussians: self.capacity.num_gaussians as u32,
            pair_capacity: self.capacity.num_pairs as u32,
            statistic_channels: settings.statistic_channels as u32,
            unused: 0,
            background: settings.background,
        };
        self.gpu.queue().write_buffer(&self.view, 0, bytemuck::bytes_of(&uniform));
    }

    /// Projects `activated` to splats.
    pub fn project(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.project.dispatch_over(pass, self.capacity.num_gaussians);
    }

    /// Sorts splats into tiles, front to back.
    pub fn sort(&self, pass: &mut wgpu::ComputePass<'_>) {
        let n = self.capacity.num_gaussians;
        self.sort_depths.record(pass, Dispatch::Blocks(n.div_ceil(SORT_BLOCK) as u32));
        self.bin_count.dispatch_over(pass, n);
        self.bin_scan.dispatch(pass, [1, 1, 1]);
        self.bin_emit.dispatch_over(pass, n);
        self.sort_tiles.record(pass, Dispatch::Indirect(&self.arguments, 0));
        self.bin_ranges.dispatch_over(pass, self.grid[0] * self.grid[1] + 1);
        self.bin_buckets.dispatch(pass, [1, 1, 1]);
    }

    /// Blends the tiles' splats to `image`.
    pub fn rasterize(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.rasterize.dispatch_groups(pass, self.grid[0] * self.grid[1]);
    }

    /// From `v_image` to gradients of the splats, after the forward stages.
    ///
    /// # Panics
    /// If there are no buffers for it.
    pub fn rasterize_bwd(&self, pass: &mut wgpu::ComputePass<'_>) {
        let (rasterize, _) = self.backward.as_ref().expect("a renderer with backward");
        rasterize.dispatch_indirect(pass, &self.arguments, 12);
    }

    /// Overwrites `v_activated` and `v_means2d_ndc`, after [`Self::rasterize_bwd`].
    ///
    /// # Panics
    /// If there are no buffers for it.
    pub fn project_bwd(&self, pass: &mut wgpu::ComputePass<'_>) {
        let (_, project) = self.backward.as_ref().expect("a renderer with backward");
        project.dispatch_over(pass, self.capacity.num_gaussians);
    }
}
