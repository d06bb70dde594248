//! Upload and download of the optimisation's state.

use tcgs_codec::BitMap;
use tcgs_render::gpu::{Gpu, GpuError};

use super::fake_quant::QuantizerBuffers;
use crate::adam::Moments;
use crate::engine::device::{LOSS_VALUES, Packing, StepUniform, quantizer_rows};
use crate::fake_quant::FakeQuantizers;
use crate::state::State;

/// Iterations between two reports, and slots of the ring of losses.
pub(super) const REPORT: usize = 64;

/// Data that outlives an iteration, and gradients.
#[derive(Debug)]
pub(super) struct StateBuffers {
    pub packing: Packing,
    pub num_gaussians: usize,
    pub num_cameras: usize,
    pub params: wgpu::Buffer,
    pub grads: wgpu::Buffer,
    pub first_moments: wgpu::Buffer,
    pub second_moments: wgpu::Buffer,
    pub statistic: wgpu::Buffer,
    pub flags: wgpu::Buffer,
    pub previous_mask_logits: wgpu::Buffer,
    pub cameras: wgpu::Buffer,
    pub quantizers: QuantizerBuffers,
    pub quantizer_state: wgpu::Buffer,
    pub num_quantizers: usize,
    /// The segmentation that `flags` was made for; `quantizers` was made for `bit_map`.
    foreground: Vec<bool>,
    bit_map: Option<BitMap>,
    pub step: wgpu::Buffer,
    pub losses: wgpu::Buffer,
}

impl StateBuffers {
    /// Memory for a state of this shape. Only constants are written yet.
    pub fn new(gpu: &Gpu, state: &State) -> Result<Self, GpuError> {
        let n = state.parameters.num_gaussians();
        let packing = Packing::new(state.parameters.gaussians.layout());
        let values = packing.values() * n;
        let num_cameras = state.parameters.camera_gains.len();
        let none = FakeQuantizers::restore(BitMap::uniform(0, 16, 8), Vec::new(), Vec::new(), Vec::new(), true);
        let quantizers = state.quantizers.as_ref().unwrap_or(&none);
        let num_quantizers = quantizers.quantizers.len();
        let flags: Vec<u32> = state.parameters.foreground.iter().map(|&f| u32::from(f)).collect();
        Ok(Self {
            num_gaussians: n,
            num_cameras,
            params: gpu.storage("parameters", values)?,
            grads: gpu.storage("gradients", values)?,
            first_moments: gpu.storage("first moments", values)?,
            second_moments: gpu.storage("second moments", values)?,
            statistic: gpu.storage("densification statistic", 2 * n)?,
            flags: gpu.upload("flags", &flags)?,
            previous_mask_logits: gpu.storage("previous mask logits", n)?,
            cameras: gpu.storage("cameras' colours", 18 * num_cameras)?,
            quantizers: QuantizerBuffers::new(gpu, &packing, quantizers)?,
            quantizer_state: gpu.storage("quantizers' state", 6 * num_quantizers)?,
            num_quantizers,
            foreground: state.parameters.foreground.clone(),
            bit_map: state.quantizers.as_ref().map(|q| q.bit_map.clone()),
            step: gpu.uniform("the step", StepUniform::size(&packing))?,
            losses: gpu.storage("losses", REPORT * LOSS_VALUES)?,
            packing,
        })
    }

    /// Whether this memory fits a state: its shape, and all data that [`Self::write`] does not overwrite, must agree.
    /// The Gaussians themselves may differ.
    pub fn fits(&self, state: &State) -> bool {
        self.num_gaussians == state.parameters.num_gaussians()
            && self.packing.layout() == state.parameters.gaussians.layout()
            && self.num_cameras == state.parameters.camera_gains.len()
            && self.num_quantizers == state.quantizers.as_ref().map_or(0, |q| q.quantizers.len())
            && self.foreground == state.parameters.foreground
            && self.bit_map.as_ref() == state.quantizers.as_ref().map(|q| &q.bit_map)
    }

    /// Overwrites everything with `state`, which fits.
    pub fn write(&self, gpu: &Gpu, state: &State) {
        let write = |buffer: &wgpu::Buffer, values: &[f32]| {
            gpu.queue().write_buffer(buffer, 0, bytemuck::cast_slice(values));
        };
        let (p, o) = (&state.parameters, &state.optimizer);
        write(&self.params, &self.packing.pack(&p.gaussians, &p.mask_logits));
        write(&self.first_moments, &self.packing.pack(&o.first, &o.mask.first));
        write(&self.second_moments, &self.packing.pack(&o.second, &o.mask.second));
        let counts: Vec<f32> = state.statistic.count.iter().map(|&c| c as f32).collect();
        write(&self.statistic, &[state.statistic.sum.as_slice(), &counts].concat());
        if let Some(previous) = state.past.as_ref().and_then(|past| past.previous_mask_logits.as_ref()) {
            write(&self.previous_mask_logits, previous);
        }
        let cameras = [
            p.camera_gains.as_flattened(),
            p.camera_offsets.as_flattened(),
            &o.gains.first,
            &o.offsets.first,
            &o.gains.second,
            &o.offsets.second,
        ];
        write(&self.cameras, &cameras.concat());
        if let Some(q) = &state.quantizers {
            write(&self.quantizers.quantizers, quantizer_rows(q).as_flattened());
            let (steps, offsets) = (&o.quantizer_steps, &o.quantizer_offsets);
            let scales = &q.gradient_scales;
            let state = [&q.initial_steps, scales, &steps.first, &steps.second, &offsets.first, &offsets.second]
                .map(Vec::as_slice);
            write(&self.quantizer_state, &state.concat());
        }
    }

    /// Overwrites `state` with everything that iterations change; waits for the GPU.
    pub fn read(&self, gpu: &Gpu, state: &mut State) -> Result<(), GpuError> {
        let n = self.num_gaussians;
        let values = self.packing.values() * n;
        let wanted = [
            (&self.params, values),
            (&self.first_moments, values),
            (&self.second_moments, values),
            (&self.statistic, 2 * n),
            (&self.cameras, 18 * self.num_cameras),
            (&self.quantizers.quantizers, 4 * self.num_quantizers),
            (&self.quantizer_state, 6 * self.num_quantizers),
        ];
        let mut encoder = gpu.encoder();
        let staged =
            wanted.iter().map(|&(buffer, len)| gpu.stage(&mut encoder, buffer, len)).collect::<Result<Vec<_>, _>>()?;
        gpu.submit(encoder);
        staged.iter().for_each(|staged| staged.map(gpu));
        gpu.wait()?;
        let mut arrays =
            staged.iter().map(|staged| staged.take::<f32>(gpu)).collect::<Result<Vec<_>, _>>()?.into_iter();
        let mut next = || arrays.next().expect("one array for each that was asked for");

        let (p, o) = (&mut state.parameters, &mut state.optimizer);
        self.packing.unpack(&next(), &mut p.gaussians, &mut p.mask_logits);
        self.packing.unpack(&next(), &mut o.first, &mut o.mask.first);
        self.packing.unpack(&next(), &mut o.second, &mut o.mask.second);

        let statistic = next();
        state.statistic.sum.copy_from_slice(&statistic[..n]);
        state.statistic.count = statistic[n..].iter().map(|&count| count as u32).collect();

        let cameras = next();
        let rows = |i: usize| &cameras[i * 3 * self.num_cameras..][..3 * self.num_cameras];
        p.camera_gains.as_flattened_mut().copy_from_slice(rows(0));
        p.camera_offsets.as_flattened_mut().copy_from_slice(rows(1));
        copy_moments(&mut o.gains, rows(2), rows(4));
        copy_moments(&mut o.offsets, rows(3), rows(5));

        let (quantizers, quantizer_state) = (next(), next());
        if let Some(q) = &mut state.quantizers {
            for (q, row) in q.quantizers.iter_mut().zip(quantizers.as_chunks::<4>().0) {
                (q.step, q.offset) = (row[0], row[1]);
            }
            let rows = |i: usize| &quantizer_state[i * self.num_quantizers..][..self.num_quantizers];
            copy_moments(&mut o.quantizer_steps, rows(2), rows(3));
            copy_moments(&mut o.quantizer_offsets, rows(4), rows(5));
        }
        Ok(())
    }
}

fn copy_moments(moments: &mut Moments, first: &[f32], second: &[f32]) {
    moments.first.copy_from_slice(first);
    moments.second.copy_from_slice(second);
}
