//! Losses that keep motion plausible after the first timestep, on the GPU; [`crate::engine::cpu::MotionPrior`] defines
//! them.
//!
//! Two dispatches per iteration: `prior_gaussians` computes the losses of a Gaussian alone (`floor`, `background`,
//! `soft_color`, `stillness`) and packs the current poses of the foreground; `prior_edges` walks the lists of
//! [`NeighborLists`]. One dispatch per timestep, `prior_begin`, prepares the reference of the losses.
//!
//! # The floor
//!
//! Counted for 340 k Gaussians, 150 k of them foreground with 20 neighbours each: 3.0 M edges. Two opposite edges share
//! an entry, so there are 1.19 entries per edge, and 5 % are padding. The share was measured on a cloud of that size,
//! split from the points of the basketball capture; it is 1.16 on the points themselves.
//!
//! | way | bytes an edge from memory | total | operations an edge |
//! |---|---|---|---|
//! | far ends written, then gathered | 24 read + 32 written + 4 + 32 read | 276 MB | 100 |
//! | a list of edges that leave, one of those that arrive | 12 + 12 | 72 MB | 180 |
//! | one list of both (this one) | 1.25 · 12 | 45 MB | 150 |
//!
//! An entry is a node, a weight and a first distance. The previous offset is not stored. Like position and rotation it
//! comes from 48 bytes of the neighbouring node; all nodes together are 7 MB and fit in a cache. A workgroup's 256
//! lists name 670 nodes, 32 kB. A node itself moves 136 bytes, 20 MB, less than half of them its gradients. An entry
//! takes about 120 operations and 5 roots, 0.5 G in all. On a GPU of 4.8 TB/s and 30 T operations a second memory takes
//! 14 µs and arithmetic 17 µs, at the same time.
//!
//! `prior_gaussians` moves 80 bytes per Gaussian, 48 more for the foreground and 88 more for the background: 51 MB.
//! `stillness` adds 32 bytes per Gaussian, 11 MB.

use tcgs_core::{Gaussians, normalize};
use tcgs_render::device::WORKGROUP;
use tcgs_render::gpu::raw::{Bound, Kernel};
use tcgs_render::gpu::{Gpu, GpuError};

use crate::engine::device::{NeighborLists, Packing, neighbor_constants, source};
use crate::losses::ROOT_EPSILON;
use crate::neighbors::Neighbors;

/// Buffers that the losses share with the rest of an iteration.
#[derive(Clone, Copy, Debug)]
pub struct PriorBuffers<'a> {
    /// `[values * N]` f32, read.
    pub params: &'a wgpu::Buffer,
    /// `[values * N]` f32, accumulated into.
    pub grads: &'a wgpu::Buffer,
    /// [`super::StepUniform`], a uniform. Used are the weights, the numbers of Gaussians, foreground and background,
    /// and `per_node`.
    pub step: &'a wgpu::Buffer,
    /// [`prior_rows`] rows of 8 f32, overwritten: sums of rigid, rot, iso, floor, background, soft_color,
    /// stillness, 0 before any weight, not yet divided by their counts.
    pub partials: &'a wgpu::Buffer,
}

/// Rows of partial sums: one per workgroup, first those of `prior_edges`, then those of `prior_gaussians`.
pub fn prior_rows(num_gaussians: usize, num_foreground: usize) -> usize {
    let groups = |len: usize| len.div_ceil(WORKGROUP as usize);
    groups(num_foreground) + groups(num_gaussians)
}

/// The losses on motion, ready to be recorded from the second timestep on.
#[derive(Debug)]
pub struct MotionPriorKernels {
    begin: Kernel,
    places: wgpu::Buffer,
    previous_means: wgpu::Buffer,
    previous_inverse_quats: wgpu::Buffer,
    /// `[11 N]`: means, rotations, colours, stillness
    before: wgpu::Buffer,
    gaussians: Bound,
    edges: Bound,
    num_gaussians: usize,
    num_foreground: usize,
}

impl MotionPriorKernels {
    /// Prepares all timesteps after the first.
    ///
    /// - `neighbors`: among the foreground, as found after the first timestep
    /// - `first_means`, `first_quats`: `[N]`, at the first timestep; rotations in any length
    ///
    /// # Errors
    /// [`GpuError::Memory`] if the lists do not fit.
    ///
    /// # Panics
    /// If there are not as many rotations as means.
    pub fn new(
        gpu: &Gpu,
        packing: &Packing,
        neighbors: &Neighbors<f32>,
        first_means: &[[f32; 3]],
        first_quats: &[[f32; 4]],
        buffers: &PriorBuffers<'_>,
    ) -> Result<Self, GpuError> {
        assert_eq!(first_means.len(), first_quats.len(), "first means against first rotations");
        let NeighborLists { places, mut nodes, links } = NeighborLists::new(neighbors, first_means);
        let (num_gaussians, num_foreground) = (first_means.len(), nodes.len());
        let mut first = Vec::new();
        let mut is_background = vec![true; num_gaussians];
        neighbors.foreground.iter().for_each(|&i| is_background[i as usize] = false);
        for i in (0..num_gaussians).filter(|&i| is_background[i]) {
            let [x, y, z] = first_means[i];
            first.extend([[x, y, z, 0.0], normalize(first_quats[i])]);
        }
        // An empty array of vectors cannot be bound.
        if nodes.is_empty() {
            nodes.push([0; 4]);
        }
        if first.is_empty() {
            first.push([0.0; 4]);
        }
        let rows = |what, rows: usize| gpu.storage(what, 4 * rows.max(1));
        let places = gpu.upload("places of Gaussians", &places)?;
        let nodes = gpu.upload("nodes", &nodes)?;
        let links = gpu.upload("neighbour lists", &links)?;
        let first = gpu.upload("first background", &first)?;
        let previous_means = rows("previous means", num_foreground)?;
        let previous_inverse_quats = rows("previous rotations", num_foreground)?;
        let before = gpu.storage("the timestep before", 11 * num_gaussians)?;
        let moving = rows("moving foreground", 2 * num_foreground)?;

        let source = shader(packing);
        let PriorBuffers { params, grads, step, partials } = *buffers;
        let bind = |entry, buffers: &[(u32, &wgpu::Buffer)]| gpu.kernel(&source, entry).bind(gpu.device(), buffers);
        Ok(Self {
            begin: gpu.kernel(&source, "prior_begin"),
            gaussians: bind(
                "prior_gaussians",
                &[
                    (0, step),
                    (1, params),
                    (2, grads),
                    (3, partials),
                    (4, &places),
                    (5, &first),
                    (7, &previous_inverse_quats),
                    (8, &before),
                    (18, &moving),
                ],
            ),
            edges: bind(
                "prior_edges",
                &[
                    (0, step),
                    (2, grads),
                    (3, partials),
                    (6, &previous_means),
                    (7, &previous_inverse_quats),
                    (9, &moving),
                    (10, &nodes),
                    (11, &links),
                ],
            ),
            places,
            previous_means,
            previous_inverse_quats,
            before,
            num_gaussians,
            num_foreground,
        })
    }

    /// Starts a timestep: from here on the losses compare with `previous`. Iterations submitted before are not
    /// affected.
    ///
    /// - `previous`: `[N]` the timestep before, stored form
    /// - `stillness`: `[N]` how still each is seen to be, 0 to 1; empty if unknown
    ///
    /// # Errors
    /// [`GpuError::Memory`] if the upload does not fit.
    pub fn begin(&self, gpu: &Gpu, previous: &Gaussians, stillness: &[f32]) -> Result<(), GpuError> {
        let (means, quats, colors) = (previous.means(), previous.quats(), previous.colors());
        let mut before = [means.as_flattened(), quats.as_flattened(), colors.as_flattened(), stillness].concat();
        before.resize(11 * self.num_gaussians, 0.0);
        gpu.queue().write_buffer(&self.before, 0, bytemuck::cast_slice(&before));
        let begin = self.begin.bind(
            gpu.device(),
            &[(4, &self.places), (8, &self.before), (16, &self.previous_means), (17, &self.previous_inverse_quats)],
        );
        let mut encoder = gpu.encoder();
        begin.dispatch_over(
            &mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()),
            self.num_gaussians,
        );
        gpu.submit(encoder);
        Ok(())
    }

    /// Records the losses of an iteration: *accumulates* their weighted gradients, overwrites the partial sums. A
    /// weight of 0 leaves a loss out, `rigid`, `rot` and `iso` only together.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.gaussians.dispatch_over(pass, self.num_gaussians);
        self.edges.dispatch_over(pass, self.num_foreground);
    }
}

pub(super) fn shader(packing: &Packing) -> String {
    let constants = neighbor_constants().constant("ROOT_EPSILON", ROOT_EPSILON as f32);
    source(packing, constants).part(include_str!("motion_prior.wgsl")).finish()
}
