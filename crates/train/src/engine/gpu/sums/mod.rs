//! The last sums of an iteration: values of all losses, and Adam of cameras and quantizers.
//!
//! One workgroup per independent sum, all in one dispatch. It moves little (some hundred kilobytes of partial sums);
//! its time is a few round trips to memory, one after another.

use tcgs_render::gpu::raw::Bound;
use tcgs_render::gpu::{Gpu, GpuError};

use super::image_loss::constants;
use crate::engine::device::{Packing, source};

/// Number of workgroups that do not belong to quantizers.
const SUMS: usize = 3;

/// Buffers of the sums. Arrays of rows have room for at least one, even if there is none.
#[derive(Clone, Copy, Debug)]
pub struct SumsBuffers<'a> {
    /// [`super::StepUniform`]
    pub step: &'a wgpu::Buffer,
    /// [`super::ImageLossKernels::partials`]
    pub image_partials: &'a wgpu::Buffer,
    /// [`super::ActivateKernels::mask_partials`]
    pub mask_partials: &'a wgpu::Buffer,
    /// `[ceil(F / 256) + ceil(N / 256), 8]` raw sums: rigid, rot, iso, floor, background, soft_color, stillness, 0.
    pub prior_partials: &'a wgpu::Buffer,
    /// `[rows, 2]` sums of the gradients to steps and offsets, not yet scaled.
    pub quantizer_partials: &'a wgpu::Buffer,
    /// `[Q + 1]` first row of each quantizer, and the end.
    pub quantizer_rows: &'a wgpu::Buffer,
    /// `[Q, 4]` step, offset, lowest code, highest code; moved.
    pub quantizers: &'a wgpu::Buffer,
    /// `[6, Q]` initial steps, scales of the steps' gradients, then moments: steps' first and second, offsets'
    /// first and second.
    pub quantizer_state: &'a wgpu::Buffer,
    /// `[3, 2, K, 3]` values, first and second moments, each of gains, then of offsets; moved.
    pub cameras: &'a wgpu::Buffer,
    /// `[slots, LOSS_VALUES]` one slot overwritten.
    pub losses: &'a wgpu::Buffer,
    /// `[1]` u32: not 0 where the GPU has halted; then nothing moves.
    pub status: &'a wgpu::Buffer,
}

/// Sums up all partial sums of an iteration and applies Adam to cameras and quantizers, in one dispatch. Images with
/// the cameras' colours, masks, and motion have one workgroup each, and so has every quantizer.
#[derive(Clone, Debug)]
pub struct SumsKernel {
    sums: Bound,
    num_groups: usize,
}

impl SumsKernel {
    /// Binds the kernel.
    ///
    /// - `num_quantizers`: `Q`, 0 before quantisation starts
    ///
    /// # Errors
    /// What has gone wrong with the GPU before, or compiling the shader.
    pub fn new(
        gpu: &Gpu,
        packing: &Packing,
        buffers: SumsBuffers<'_>,
        num_quantizers: usize,
    ) -> Result<Self, GpuError> {
        let sums = gpu.kernel(&shader(packing), "sums_and_small_adam").bind(
            gpu.device(),
            &[
                (0, buffers.step),
                (1, buffers.image_partials),
                (2, buffers.mask_partials),
                (3, buffers.prior_partials),
                (4, buffers.quantizer_partials),
                (5, buffers.quantizer_rows),
                (6, buffers.quantizers),
                (7, buffers.quantizer_state),
                (8, buffers.cameras),
                (9, buffers.losses),
                (10, buffers.status),
            ],
        );
        gpu.check()?;
        Ok(Self { sums, num_groups: SUMS + num_quantizers })
    }

    /// Records the sums and the updates.
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.sums.dispatch(pass, [self.num_groups as u32, 1, 1]);
    }
}

pub(super) fn shader(packing: &Packing) -> String {
    source(packing, constants())
        .part(include_str!("../moments.wgsl"))
        .part(include_str!("sums.wgsl"))
        .part(include_str!("images_and_cameras.wgsl"))
        .part(include_str!("masks.wgsl"))
        .part(include_str!("motion.wgsl"))
        .part(include_str!("quantizers.wgsl"))
        .finish()
}

#[cfg(test)]
mod tests {
    use tcgs_codec::BitMap;

    use tcgs_core::Layout;

    use super::*;
    use crate::adam::{EPSILON, Moments};
    use crate::engine::cpu::center;
    use crate::engine::device::{LOSS_VALUES, StepUniform, adam_rates};
    use crate::engine::gpu::test_support::{
        QuantizerTables, assert_close, gpu, random, random_gaussians, run, uniform,
    };
    use crate::fake_quant::FakeQuantizers;
    use crate::losses::{Loss, LossTerms, WeightConfig};

    const CAMERAS: usize = 3;
    const SLOTS: usize = 4;
    const WEIGHTS: WeightConfig =
        WeightConfig { rot: 4.0, floor: 2.0, background: 20.0, soft_color: 0.01, stillness: 0.3, ..WeightConfig::NONE };

    /// Everything that the kernel touches, on the host.
    struct State {
        image_partials: Vec<f32>,
        mask_partials: Vec<f32>,
        prior_partials: Vec<f32>,
        quantizer_partials: Vec<f32>,
        quantizer_rows: Vec<u32>,
        quantizers: Vec<[f32; 4]>,
        quantizer_state: Vec<f32>,
        cameras: Vec<f32>,
    }

    /// 70 x 33 pixels in 15 blocks, 1000 Gaussians, 300 of them in front.
    fn step(flags: u32) -> StepUniform {
        StepUniform {
            num_gaussians: 1000,
            num_foreground: 300,
            per_node: 20,
            num_background: 700,
            num_cameras: CAMERAS as u32,
            camera: 1,
            slot: 2,
            flags,
            width: 70,
            height: 33,
            num_blocks: 15,
            weights: WEIGHTS.values(),
            step_min_share: 0.1,
            ..StepUniform::default()
        }
    }

    fn state(quantizers: &FakeQuantizers) -> State {
        let tables = QuantizerTables::new(quantizers);
        let num = tables.quantizers.len();
        // Ranges of none, a few and many rows.
        let mut quantizer_rows = vec![0];
        let mut end = 0_u32;
        for q in 0..num as u32 {
            end += [0, 3, 17, 300, 2500][q as usize % 5];
            quantizer_rows.push(end);
        }
        let mut quantizer_state = [&quantizers.initial_steps[..], &tables.gradient_scales].concat();
        quantizer_state.resize(6 * num, 0.0);
        let mut cameras = random(5, 6 * CAMERAS, -0.5, 0.5);
        cameras.resize(18 * CAMERAS, 0.0);
        State {
            image_partials: random(1, 4 * 5 * 15, -1.0, 2.0),
            mask_partials: random(2, 2 * 4, 0.0, 100.0),
            prior_partials: random(3, 8 * (2 + 4), 0.0, 10.0),
            quantizer_partials: random(4, 2 * end as usize, -1.0, 1.2),
            quantizer_rows,
            quantizers: tables.quantizers,
            quantizer_state,
            cameras,
        }
    }

    struct OnGpu {
        kernel: SumsKernel,
        step: wgpu::Buffer,
        quantizers: wgpu::Buffer,
        quantizer_state: wgpu::Buffer,
        cameras: wgpu::Buffer,
        losses: wgpu::Buffer,
    }

    impl OnGpu {
        fn new(gpu: &Gpu, state: &State, status: u32) -> Self {
            let upload = |values: &[f32]| gpu.upload("values", values).unwrap();
            let (step, quantizers) =
                (uniform(gpu, &StepUniform::default(), &[]), upload(state.quantizers.as_flattened()));
            let (quantizer_state, cameras) = (upload(&state.quantizer_state), upload(&state.cameras));
            let losses = upload(&[-1.0; SLOTS * LOSS_VALUES]);
            let buffers = SumsBuffers {
                step: &step,
                image_partials: &upload(&state.image_partials),
                mask_partials: &upload(&state.mask_partials),
                prior_partials: &upload(&state.prior_partials),
                quantizer_partials: &upload(&state.quantizer_partials),
                quantizer_rows: &gpu.upload("rows", &state.quantizer_rows).unwrap(),
                quantizers: &quantizers,
                quantizer_state: &quantizer_state,
                cameras: &cameras,
                losses: &losses,
                status: &gpu.upload("status", &[status]).unwrap(),
            };
            let kernel = SumsKernel::new(gpu, &Packing::new(&Layout::base()), buffers, state.quantizers.len()).unwrap();
            Self { kernel, step, quantizers, quantizer_state, cameras, losses }
        }

        fn run(&self, gpu: &Gpu, step: &StepUniform, rates: [[f32; 4]; 10]) {
            gpu.queue().write_buffer(&self.step, 0, &step.bytes(&rates));
            run(gpu, |pass| self.kernel.record(pass));
        }
    }

    fn quantizers() -> FakeQuantizers {
        let mut bit_map = BitMap::uniform(200, 16, 6);
        bit_map.widths[1][..50].fill(9);
        FakeQuantizers::new(bit_map, &random_gaussians(7, 200), true).unwrap()
    }

    /// Sum of every `stride`th value.
    fn sum(values: &[f32], start: usize, stride: usize) -> f64 {
        values.iter().skip(start).step_by(stride).map(|&v| f64::from(v)).sum()
    }

    #[test]
    fn losses_are_means_and_zero_where_they_are_off() {
        let Some(gpu) = gpu() else { return };
        let state = state(&quantizers());
        let (masked, compares) = (StepUniform::MASKED, StepUniform::COMPARES_MASKS);
        let (segmented, prior) = (StepUniform::SEGMENTED, StepUniform::HAS_PRIOR);
        for flags in [0, masked, masked | compares | segmented | prior, compares | prior] {
            let on_gpu = OnGpu::new(&gpu, &state, 1);
            on_gpu.run(&gpu, &step(flags), [[0.0; 4]; 10]);
            let on = |flag: u32, value: f64| if flags & flag == flag { value } else { 0.0 };
            let image = |channels: std::ops::Range<usize>| {
                let partials = &state.image_partials[60 * channels.start..60 * channels.end];
                (0.8 * sum(partials, 1, 4) + 0.2 * sum(partials, 0, 4)) / (3.0 * 70.0 * 33.0)
            };
            let prior_mean = |i: usize, count: f64| on(prior, sum(&state.prior_partials, i, 8) / count);
            let expected = LossTerms {
                image: image(0..3),
                segmentation: on(segmented, image(3..5)),
                rigid: prior_mean(0, 6000.0),
                rot: prior_mean(1, 6000.0),
                iso: prior_mean(2, 6000.0),
                floor: prior_mean(3, 300.0),
                background: prior_mean(4, 700.0),
                soft_color: prior_mean(5, 1000.0),
                stillness: prior_mean(6, 1000.0),
                mask: on(masked, sum(&state.mask_partials, 0, 2) / 1000.0),
                mask_consistency: on(masked | compares, sum(&state.mask_partials, 1, 2) / 1000.0),
            };
            let check = |expected: &LossTerms| {
                let losses: Vec<f32> = gpu.read(&on_gpu.losses, SLOTS * LOSS_VALUES).unwrap();
                let slot = &losses[2 * LOSS_VALUES..3 * LOSS_VALUES];
                for (loss, (&found, expected)) in Loss::ALL.into_iter().zip(slot.iter().zip(expected.values())) {
                    let error = (f64::from(found) - expected).abs();
                    assert!(error <= 1e-6 * expected.abs(), "{}: {found} against {expected}", loss.name());
                }
                // The status, then nothing.
                let (status, rest) = slot[Loss::ALL.len()..].split_first().unwrap();
                assert!(*status == 1.0 && rest.iter().all(|&v| v == 0.0));
                assert!(losses[..2 * LOSS_VALUES].iter().chain(&losses[3 * LOSS_VALUES..]).all(|&v| v == -1.0));
            };
            check(&expected);
            // A weight of zero, and a set of none.
            let off = StepUniform {
                weights: WeightConfig { rot: 0.0, floor: 0.0, ..WEIGHTS }.values(),
                num_background: 0,
                ..step(flags)
            };
            on_gpu.run(&gpu, &off, [[0.0; 4]; 10]);
            check(&LossTerms { rigid: 0.0, rot: 0.0, iso: 0.0, floor: 0.0, background: 0.0, ..expected });
        }
    }

    #[test]
    fn cameras_move_as_on_the_cpu() {
        let Some(gpu) = gpu() else { return };
        for flags in [0, StepUniform::CENTERS_CAMERAS] {
            cameras_move_with(&gpu, flags);
        }
    }

    fn cameras_move_with(gpu: &Gpu, flags: u32) {
        let state = state(&quantizers());
        let on_gpu = OnGpu::new(gpu, &state, 0);
        let (mut values, mut moments) = (state.cameras[..18].to_vec(), [Moments::new(9), Moments::new(9)]);
        for turn in 0..5 {
            let camera = turn % CAMERAS;
            let mut rates = [[0.0; 4]; 10];
            let now = StepUniform { camera: camera as u32, ..step(flags) };
            for kind in 0..2 {
                let mut v = vec![0.0; 9];
                for c in 0..3 {
                    v[3 * camera + c] = sum(&state.image_partials[60 * c..][..60], 2 + kind, 4) as f32;
                }
                // No rate in one update: it only counts.
                let rate = if turn == 2 { 0.0 } else { 1e-3 };
                rates[6 + kind] = adam_rates(rate, moments[kind].step + 1, EPSILON);
                moments[kind].update(&mut values[9 * kind..][..9], &v, rate);
                if flags != 0 {
                    center(values[9 * kind..][..9].as_chunks_mut::<3>().0);
                }
            }
            on_gpu.run(gpu, &now, rates);
        }
        let found: Vec<f32> = gpu.read(&on_gpu.cameras, 18 * CAMERAS).unwrap();
        let [gains, offsets] = &moments;
        assert_close("cameras", &found[..18], &values, 1e-6);
        assert_close("first moments", &found[18..36], &[&gains.first[..], &offsets.first].concat(), 1e-5);
        assert_close("second moments", &found[36..], &[&gains.second[..], &offsets.second].concat(), 1e-5);
    }

    #[test]
    fn quantizers_move_as_on_the_cpu() {
        let Some(gpu) = gpu() else { return };
        for learned_offset in [true, false] {
            let mut expected = quantizers();
            expected.learned_offset = learned_offset;
            let state = state(&expected);
            let num = expected.quantizers.len();
            let [mut steps, mut offsets] = [Moments::new(num), Moments::new(num)];
            let on_gpu = OnGpu::new(&gpu, &state, 0);
            let gradient = |kind: usize| -> Vec<f32> {
                (0..num)
                    .map(|q| {
                        let [first, end] = [q, q + 1].map(|i| state.quantizer_rows[i] as usize);
                        let sum = sum(&state.quantizer_partials[2 * first..2 * end], kind, 2);
                        sum as f32 * state.quantizer_state[num + q]
                    })
                    .collect()
            };
            let flags = StepUniform::QUANTIZED | if learned_offset { StepUniform::LEARNED_OFFSET } else { 0 };
            for _ in 0..5 {
                // Far enough that some steps meet the floor.
                let rate = 0.25;
                let mut rates = [[0.0; 4]; 10];
                let now = StepUniform { num_quantizers: num as u32, ..step(flags) };
                rates[8] = adam_rates(rate, steps.step + 1, EPSILON);
                rates[9] = adam_rates(rate, offsets.step + 1, EPSILON);
                expected.update(&gradient(0), &gradient(1), &mut steps, &mut offsets, rate);
                on_gpu.run(&gpu, &now, rates);
            }
            let found: Vec<f32> = gpu.read(&on_gpu.quantizers, 4 * num).unwrap();
            let expected = QuantizerTables::new(&expected).quantizers;
            assert!(expected.iter().zip(&state.quantizer_state).any(|(q, initial)| q[0] == 0.1 * initial));
            for i in 0..4 {
                let found: Vec<f32> = found.iter().skip(i).step_by(4).copied().collect();
                let expected: Vec<f32> = expected.iter().map(|q| q[i]).collect();
                assert_close(["steps", "offsets", "lowest", "highest"][i], &found, &expected, 1e-5);
            }
            let found: Vec<f32> = gpu.read(&on_gpu.quantizer_state, 6 * num).unwrap();
            for (i, moments) in [&steps.first, &steps.second, &offsets.first, &offsets.second].iter().enumerate() {
                let found = &found[(2 + i) * num..][..num];
                assert_close(["m of steps", "s of steps", "m of offsets", "s of offsets"][i], found, moments, 1e-5);
            }
        }
    }

    #[test]
    fn a_halted_iteration_moves_nothing() {
        let Some(gpu) = gpu() else { return };
        let state = state(&quantizers());
        let on_gpu = OnGpu::new(&gpu, &state, 1);
        let num = state.quantizers.len();
        let now =
            StepUniform { num_quantizers: num as u32, ..step(StepUniform::QUANTIZED | StepUniform::LEARNED_OFFSET) };
        on_gpu.run(&gpu, &now, [adam_rates(0.1, 1, EPSILON); 10]);
        assert_eq!(gpu.read::<f32>(&on_gpu.cameras, 18 * CAMERAS).unwrap(), state.cameras);
        assert_eq!(gpu.read::<f32>(&on_gpu.quantizers, 4 * num).unwrap(), state.quantizers.as_flattened());
        assert_eq!(gpu.read::<f32>(&on_gpu.quantizer_state, 6 * num).unwrap(), state.quantizer_state);
    }
}
