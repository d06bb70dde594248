//! Fake quantisation on the GPU: the learned quantizers as buffers, and the backward of
//! [`crate::FakeQuantizers`].
//!
//! Members of a group (one attribute, one width) are listed, so that a workgroup sums for one group's
//! quantizers only and writes one row for each: no atomics, and every sum has one order.
//!
//! # The floor
//!
//! A Gaussian has 11 quantised values: 12 bytes each (value, gradient, gradient) and four entries of 4 bytes in the
//! lists, 148 bytes, 50 MB of 340 k Gaussians; 15 operations and a division a value. Where widths alternate from one
//! Gaussian to the next, a 32-byte sector is fetched by two to four groups; chunks are therefore dispatched in the
//! order of the Gaussians that they begin with, so that the others find it in the cache.

use tcgs_core::Attribute;
use tcgs_render::device::Wgsl;
use tcgs_render::gpu::{Bound, Gpu, GpuError};

use super::step::source;
use crate::fake_quant::FakeQuantizers;

/// Most members of a group that one workgroup handles.
const CHUNK: usize = 1024;

/// Attributes that are quantised, in the order of the bytes of `quantizer_groups`.
const QUANTIZED: [Attribute; 4] = [Attribute::Quat, Attribute::LogScale, Attribute::LogitOpacity, Attribute::Color];

/// The learned quantizers (Q of them, of N Gaussians) and who uses which.
#[derive(Debug)]
pub struct QuantizerBuffers {
    /// `[N]` u32: position in [`FakeQuantizers::groups`] of the quat, log_scale, logit_opacity and color, a byte each,
    /// the quat's lowest.
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
    /// Uploads `quantizers`; of none at all it makes buffers that can be bound.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if they do not fit.
    ///
    /// # Panics
    /// If a Gaussian has a width that no group has.
    pub fn new(gpu: &Gpu, quantizers: &FakeQuantizers) -> Result<Self, GpuError> {
        let num_gaussians = quantizers.bit_map.num_gaussians();
        let mut quantizer_groups = vec![0_u32; num_gaussians];
        let mut group_starts = vec![0_u32; 256];
        let mut quantizer_rows = vec![0_u32];
        let mut members = Vec::new();
        // First Gaussian, and what the shader reads.
        let mut chunks: Vec<(u32, [u32; 8])> = Vec::new();
        let mut first_quantizer = 0;
        for (group, &(attribute, width)) in quantizers.groups.iter().enumerate() {
            let widths = &quantizers.bit_map.widths[attribute.index()];
            let byte = QUANTIZED.iter().position(|&a| a == attribute).expect("positions are not quantised");
            let components = attribute.components() as u32;
            let first_member = members.len();
            for i in (0..num_gaussians).filter(|&i| widths[i] == width) {
                quantizer_groups[i] |= (group as u32) << (8 * byte);
                members.push(i as u32);
            }
            let num_chunks = (members.len() - first_member).div_ceil(CHUNK) as u32;
            let first_row = quantizer_rows[first_quantizer as usize];
            for (i, chunk) in members[first_member..].chunks(CHUNK).enumerate() {
                let first = (first_member + i * CHUNK) as u32;
                let values = [first_word(attribute, num_gaussians), components, first, chunk.len() as u32];
                let rows = [first_quantizer, first_row + i as u32, num_chunks, 0];
                chunks.push((chunk[0], std::array::from_fn(|k| if k < 4 { values[k] } else { rows[k - 4] })));
            }
            group_starts[group] = first_quantizer;
            quantizer_rows.extend((1..=components).map(|c| first_row + c * num_chunks));
            first_quantizer += components;
        }
        assert_eq!(members.len(), QUANTIZED.len() * num_gaussians, "members of all groups against Gaussians");
        chunks.sort_by_key(|&(first, chunk)| (chunk[0], first));
        let num_chunks = chunks.len() as u32;
        let mut chunks: Vec<[u32; 8]> = chunks.into_iter().map(|(_, chunk)| chunk).collect();
        let mut table: Vec<[f32; 4]> = quantizers
            .quantizers
            .iter()
            .map(|q| [q.step, q.offset, q.min_code() as f32, q.max_code() as f32])
            .collect();
        let num_rows = quantizer_rows.last().map_or(0, |&rows| rows as usize);
        // An empty array of vectors cannot be bound.
        if chunks.is_empty() {
            chunks.push([0; 8]);
        }
        if table.is_empty() {
            table.push([1.0, 0.0, 0.0, 0.0]);
        }
        Ok(Self {
            quantizer_groups: gpu.upload("groups of quantizers", &quantizer_groups)?,
            group_starts: gpu.upload("starts of groups", &group_starts)?,
            quantizers: gpu.upload("quantizers", &table)?,
            initial_steps: gpu.upload("initial steps", &quantizers.initial_steps)?,
            gradient_scales: gpu.upload("scales of steps' gradients", &quantizers.gradient_scales)?,
            quantizer_rows: gpu.upload("rows of quantizers", &quantizer_rows)?,
            quantizer_partials: gpu.storage("partial sums of quantizers", 2 * num_rows.max(1))?,
            members: gpu.upload("members of groups", &members)?,
            chunks: gpu.upload("chunks of groups", &chunks)?,
            num_chunks,
        })
    }
}

/// First word of an attribute in `params`.
fn first_word(attribute: Attribute, num_gaussians: usize) -> u32 {
    let before = &Attribute::BASE[..attribute.index()];
    (num_gaussians * before.iter().map(|a| a.components()).sum::<usize>()) as u32
}

/// Backward of fake quantisation, ready to be recorded.
#[derive(Debug)]
pub struct FakeQuantKernels {
    bwd: Bound,
    num_chunks: u32,
}

impl FakeQuantKernels {
    /// - `params`, `grads`: `[15 N]` f32
    /// - `step`: [`super::StepUniform`], a uniform; of it the flag `QUANTIZED`, without which nothing is done
    pub fn new(
        gpu: &Gpu,
        quantizers: &QuantizerBuffers,
        params: &wgpu::Buffer,
        grads: &wgpu::Buffer,
        step: &wgpu::Buffer,
    ) -> Self {
        let source = source(Wgsl::new()).part(include_str!("fake_quant.wgsl")).finish();
        let bwd = gpu.kernel(&source, "fake_quant_bwd").bind(
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

    /// Records the backward: *overwrites* gradients to quantised values with those to the values themselves, and the
    /// partial sums.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.bwd.dispatch(pass, [self.num_chunks, 1, 1]);
    }
}
