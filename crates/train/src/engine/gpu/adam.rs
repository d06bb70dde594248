//! Adam of the Gaussians: see [`crate::adam()`].
//!
//! The floor is memory: 28 bytes for each value that moves (value, gradient and two moments in, all but the gradient
//! out), and nothing for a group that does not move. A Gaussian of the base layout has 15 values, 11 after the first
//! timestep.

use tcgs_render::device::{MAX_GROUPS_X, Wgsl};
use tcgs_render::gpu::raw::Bound;
use tcgs_render::gpu::{Gpu, GpuError};

use crate::engine::device::{Packing, source};

/// Values that one workgroup updates.
const BLOCK: usize = 1024;

/// Buffers of Adam for the Gaussians.
#[derive(Clone, Copy, Debug)]
pub struct AdamBuffers<'a> {
    /// [`super::StepUniform`]
    pub step: &'a wgpu::Buffer,
    /// `[values * N]` columns and mask logits, see [`Packing`]; moved.
    pub params: &'a wgpu::Buffer,
    /// `[values * N]`
    pub grads: &'a wgpu::Buffer,
    /// `[values * N]` moved.
    pub first_moments: &'a wgpu::Buffer,
    /// `[values * N]` moved.
    pub second_moments: &'a wgpu::Buffer,
    /// `[1]` u32: not 0 where the GPU has halted; then nothing moves.
    pub status: &'a wgpu::Buffer,
}

/// Adam of all columns and of the mask logits in one dispatch, bound to its buffers.
#[derive(Clone, Debug)]
pub struct AdamKernel {
    adam: Bound,
    num_groups: usize,
}

impl AdamKernel {
    /// Binds the kernel.
    ///
    /// - `num_active`: Gaussians that move, as the uniform says
    ///
    /// # Errors
    /// What has gone wrong with the GPU before, or compiling the shader.
    pub fn new(gpu: &Gpu, packing: &Packing, buffers: AdamBuffers<'_>, num_active: usize) -> Result<Self, GpuError> {
        let adam = gpu.kernel(&shader(packing), "adam").bind(
            gpu.device(),
            &[
                (0, buffers.step),
                (1, buffers.params),
                (2, buffers.grads),
                (3, buffers.first_moments),
                (4, buffers.second_moments),
                (5, buffers.status),
            ],
        );
        gpu.check()?;
        Ok(Self { adam, num_groups: packing.group_components().map(|c| (c * num_active).div_ceil(BLOCK)).sum() })
    }

    /// Records one update, then the normalisation of quaternions if quantisation is on.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.adam.dispatch_groups(pass, self.num_groups);
    }
}

pub(super) fn shader(packing: &Packing) -> String {
    source(packing, Wgsl::new().constant("MAX_GROUPS_X", MAX_GROUPS_X).constant("BLOCK", BLOCK))
        .part(include_str!("moments.wgsl"))
        .part(include_str!("adam.wgsl"))
        .finish()
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Layout, normalize};

    use super::*;
    use crate::adam::{EPSILON, Moments, adam};
    use crate::engine::device::{StepUniform, adam_rates};
    use crate::engine::gpu::test_support::{assert_close, gpu, random, run, uniform};

    /// Values of a Gaussian by group: mean, quat, log_scale, logit_opacity, color, mask.
    const COMPONENTS: [usize; 6] = [3, 4, 3, 1, 3, 1];
    const RATES: [f32; 6] = [1e-2, 1e-3, 0.0, 5e-2, 2.5e-3, 1e-2];
    const EPSILONS: [f32; 6] = [EPSILON, EPSILON, EPSILON, EPSILON, 1e-3, EPSILON];

    struct Case {
        flags: u32,
        halted: u32,
        num_gaussians: usize,
    }

    /// Five updates on both; returns what was found and what was expected: values and both moments.
    fn five_updates(gpu: &Gpu, case: &Case) -> [(Vec<f32>, Vec<f32>); 3] {
        let n = case.num_gaussians;
        let starts: Vec<usize> =
            COMPONENTS.iter().scan(0, |sum, c| Some(std::mem::replace(sum, *sum + c * n))).collect();
        let mut values = random(1, 15 * n, -2.0, 2.0);
        let mut moments = COMPONENTS.map(|c| Moments::new(c * n));
        // Moments carried over from the timestep before.
        for (m, count) in moments.iter_mut().zip([0, 400, 7, 0, 90_000, 3]) {
            m.step = count;
            m.first.fill(1e-3);
            m.second.fill(1e-5);
        }
        let of = |pick: &dyn Fn(&Moments) -> Vec<f32>, moments: &[Moments; 6]| -> Vec<f32> {
            moments.iter().flat_map(pick).collect()
        };
        let (params, grads) = (gpu.upload("params", &values).unwrap(), gpu.storage("grads", 15 * n).unwrap());
        let first = gpu.upload("first", &of(&|m| m.first.clone(), &moments)).unwrap();
        let second = gpu.upload("second", &of(&|m| m.second.clone(), &moments)).unwrap();
        let step = uniform(gpu, &StepUniform::default(), &[]);
        let status = gpu.upload("status", &[case.halted]).unwrap();
        let buffers = AdamBuffers {
            step: &step,
            params: &params,
            grads: &grads,
            first_moments: &first,
            second_moments: &second,
            status: &status,
        };
        let kernel = AdamKernel::new(gpu, &Packing::new(&Layout::base()), buffers, n).unwrap();
        for turn in 0..5 {
            let v = random(10 + turn, 15 * n, -1e-3, 1e-3);
            let mut rates = [[0.0; 4]; 10];
            let now = StepUniform {
                num_gaussians: n as u32,
                num_active: n as u32,
                flags: case.flags,
                ..StepUniform::default()
            };
            for group in 0..6 {
                rates[group] = adam_rates(RATES[group], moments[group].step + 1, EPSILONS[group]);
                let range = starts[group]..starts[group] + COMPONENTS[group] * n;
                let moves = case.flags & StepUniform::MOVES != 0
                    && (group < 5 || case.flags & StepUniform::MASKED != 0)
                    && case.halted == 0;
                if moves {
                    let Moments { first, second, step } = &mut moments[group];
                    let (values, v) = (&mut values[range.clone()], &v[range]);
                    adam(values, v, first, second, step, RATES[group], EPSILONS[group]);
                }
            }
            if case.flags & StepUniform::QUANTIZED != 0 && case.halted == 0 {
                let quats = values[starts[1]..starts[2]].as_chunks_mut::<4>().0;
                quats.iter_mut().for_each(|quat| *quat = normalize(*quat));
            }
            gpu.queue().write_buffer(&step, 0, &now.bytes(&rates));
            gpu.queue().write_buffer(&grads, 0, bytemuck::cast_slice(&v));
            run(gpu, |pass| kernel.record(pass));
        }
        let read = |buffer| gpu.read::<f32>(buffer, 15 * n).unwrap();
        [
            (read(&params), values),
            (read(&first), of(&|m| m.first.clone(), &moments)),
            (read(&second), of(&|m| m.second.clone(), &moments)),
        ]
    }

    #[test]
    fn five_updates_are_those_of_the_cpu() {
        let Some(gpu) = gpu() else { return };
        let (moves, quantized, masked) = (StepUniform::MOVES, StepUniform::QUANTIZED, StepUniform::MASKED);
        for flags in [moves, moves | quantized | masked, quantized, 0] {
            for num_gaussians in [1, 255, 341, 1500] {
                let [values, first, second] = five_updates(&gpu, &Case { flags, halted: 0, num_gaussians });
                assert_close("values", &values.0, &values.1, 1e-6);
                assert_close("first moments", &first.0, &first.1, 1e-6);
                assert_close("second moments", &second.0, &second.1, 1e-6);
            }
        }
    }

    #[test]
    fn a_halted_iteration_moves_nothing() {
        let Some(gpu) = gpu() else { return };
        let flags = StepUniform::MOVES | StepUniform::QUANTIZED | StepUniform::MASKED;
        for (found, expected) in five_updates(&gpu, &Case { flags, halted: 1, num_gaussians: 300 }) {
            assert_eq!(found, expected);
        }
    }
}
