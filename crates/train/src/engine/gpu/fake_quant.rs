//! Fake quantisation on the GPU: the learned quantizers as buffers, and the backward of
//! [`crate::FakeQuantizers`].
//!
//! [`QuantizerLists`] lists the members of each group, and says why a workgroup sums for one group alone.
//!
//! # The floor
//!
//! A Gaussian has 11 quantised values. Each takes 12 bytes (value, gradient, gradient), and the lists hold four entries
//! of 4 bytes: 148 bytes in all, 50 MB for 340 k Gaussians. A value takes 15 operations and a division. If widths
//! alternate from one Gaussian to the next, two to four groups fetch the same 32-byte sector. Chunks are therefore
//! dispatched in the order of their first Gaussians, so that later fetches hit the cache.

use tcgs_render::device::Wgsl;
use tcgs_render::gpu::raw::Bound;
use tcgs_render::gpu::{Gpu, GpuError};

use crate::engine::device::{Packing, QuantizerLists, quantizer_rows, source};
use crate::fake_quant::FakeQuantizers;

/// The learned quantizers (Q of them, of N Gaussians), and the members of their groups.
#[derive(Debug)]
pub struct QuantizerBuffers {
    /// `[words, N]` u32: position in [`FakeQuantizers::groups`] for each quantised column, one byte each, four per
    /// word, the first in the lowest byte.
    pub quantizer_groups: wgpu::Buffer,
    /// `[256]` u32: first quantizer of a group; that of component `c` comes `c` later.
    pub group_starts: wgpu::Buffer,
    /// `[Q]` vec4 of f32: step, offset, lowest code, highest code.
    pub quantizers: wgpu::Buffer,
    /// `[Q]` f32: steps that learning started from.
    pub initial_steps: wgpu::Buffer,
    /// `[Q]` f32: scale of a step's and an offset's gradient.
    pub gradient_scales: wgpu::Buffer,
    /// `[Q + 1]` u32: first row of each quantizer in `quantizer_partials`.
    pub quantizer_rows: wgpu::Buffer,
    /// `[rows]` vec2 of f32: partial sums of `(v_step, v_offset)`, overwritten by [`FakeQuantKernels::record`].
    pub quantizer_partials: wgpu::Buffer,
    members: wgpu::Buffer,
    chunks: wgpu::Buffer,
    num_chunks: u32,
}

impl QuantizerBuffers {
    /// Uploads `quantizers`. With no quantizers at all, the buffers are small but can be bound.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if they do not fit.
    ///
    /// # Panics
    /// If a Gaussian has a width that no group has.
    pub fn new(gpu: &Gpu, packing: &Packing, quantizers: &FakeQuantizers) -> Result<Self, GpuError> {
        let mut lists = QuantizerLists::new(packing, quantizers);
        let (num_chunks, num_rows) = (lists.chunks.len() as u32, lists.num_rows());
        let mut table = quantizer_rows(quantizers);
        // An empty array of vectors cannot be bound.
        if lists.chunks.is_empty() {
            lists.chunks.push([0; 8]);
        }
        if table.is_empty() {
            table.push([1.0, 0.0, 0.0, 0.0]);
        }
        Ok(Self {
            quantizer_groups: gpu.upload("groups of quantizers", &lists.groups)?,
            group_starts: gpu.upload("starts of groups", &lists.group_starts)?,
            quantizers: gpu.upload("quantizers", &table)?,
            initial_steps: gpu.upload("initial steps", &quantizers.initial_steps)?,
            gradient_scales: gpu.upload("scales of steps' gradients", &quantizers.gradient_scales)?,
            quantizer_rows: gpu.upload("rows of quantizers", &lists.rows)?,
            quantizer_partials: gpu.storage("partial sums of quantizers", 2 * num_rows.max(1))?,
            members: gpu.upload("members of groups", &lists.members)?,
            chunks: gpu.upload("chunks of groups", &lists.chunks)?,
            num_chunks,
        })
    }
}

/// Backward of fake quantisation, ready to be recorded.
#[derive(Debug)]
pub struct FakeQuantKernels {
    bwd: Bound,
    num_chunks: u32,
}

impl FakeQuantKernels {
    /// - `params`, `grads`: `[values * N]` f32, see [`Packing`]
    /// - `step`: [`super::StepUniform`], a uniform; of it the flag `QUANTIZED`, without which nothing is done
    pub fn new(
        gpu: &Gpu,
        packing: &Packing,
        quantizers: &QuantizerBuffers,
        params: &wgpu::Buffer,
        grads: &wgpu::Buffer,
        step: &wgpu::Buffer,
    ) -> Self {
        let bwd = gpu.kernel(&shader(packing), "fake_quant_bwd").bind(
            gpu.device(),
            &[
                (0, step),
                (1, params),
                (2, grads),
                (3, &quantizers.members),
                (4, &quantizers.chunks),
                (5, &quantizers.quantizers),
                (6, &quantizers.quantizer_partials),
            ],
        );
        Self { bwd, num_chunks: quantizers.num_chunks }
    }

    /// Records the backward: *overwrites* gradients with respect to quantised values with those to the values
    /// themselves, and overwrites the partial sums.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.bwd.dispatch(pass, [self.num_chunks, 1, 1]);
    }
}

pub(super) fn shader(packing: &Packing) -> String {
    source(packing, Wgsl::new()).part(include_str!("fake_quant.wgsl")).finish()
}
