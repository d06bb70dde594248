//! From stored values to what is drawn, and back: fake quantisation, activation, masks.
//!
//! As `CpuEngine::forward_backward` on the CPU. The losses on masks are here too, since they need the inputs of the
//! mask's gradient. The floor is memory, for every Gaussian: forward reads 68 bytes and writes 56 (64 with
//! segmentation), backward reads 60 + 56 and writes 60.

use tcgs_render::device::{WORKGROUP, Wgsl};
use tcgs_render::gpu::raw::Bound;
use tcgs_render::gpu::{Gpu, GpuError};

use crate::engine::device::{Packing, source};

/// Buffers of activation and its backward. Arrays for quantizers have room for at least one, even if there is none.
#[derive(Clone, Copy, Debug)]
pub struct ActivateBuffers<'a> {
    /// [`super::StepUniform`]
    pub step: &'a wgpu::Buffer,
    /// `[values * N]` columns and mask logits, see [`Packing`].
    pub params: &'a wgpu::Buffer,
    /// `[N]` bit 0: foreground.
    pub flags: &'a wgpu::Buffer,
    /// `[words, N]` a byte a quantised column: its group of quantizers.
    pub quantizer_groups: &'a wgpu::Buffer,
    /// `[256]` position of a group's first quantizer; the others of its components follow.
    pub group_starts: &'a wgpu::Buffer,
    /// `[Q, 4]` step, offset, lowest code, highest code.
    pub quantizers: &'a wgpu::Buffer,
    /// `[(11 + C) D]` means, unit quats, scales, opacities, colors with `C` channels; the first `N` of each are
    /// overwritten.
    pub activated: &'a wgpu::Buffer,
    /// `[(11 + C) N]` gradients with respect to these.
    pub v_activated: &'a wgpu::Buffer,
    /// `[N]` mask logits of the timestep before; read only if masks are compared.
    pub previous_mask_logits: &'a wgpu::Buffer,
    /// `[values * N]` overwritten: gradients to the quantised stored values.
    pub grads: &'a wgpu::Buffer,
    /// `[N, 3]` gradients to projected centres in NDC units: x, y, whether visible.
    pub v_means2d_ndc: &'a wgpu::Buffer,
    /// `[2 N]` sums of their norms, then counts.
    pub statistic: &'a wgpu::Buffer,
    /// `[1]` u32: not 0 where the GPU has halted; then nothing is counted.
    pub status: &'a wgpu::Buffer,
}

/// Forward from stored values to activated ones, its backward, and the densification statistic, bound to their buffers.
#[derive(Clone, Debug)]
pub struct ActivateKernels {
    fwd: Bound,
    bwd: Bound,
    count: Bound,
    num_gaussians: usize,
    /// `[ceil(N / 256), 2]` sums of `σ(m)` and of `|m − previous m|`.
    pub mask_partials: wgpu::Buffer,
}

impl ActivateKernels {
    /// Binds the three kernels.
    ///
    /// # Errors
    /// If memory for the partial sums cannot be had.
    pub fn new(
        gpu: &Gpu,
        packing: &Packing,
        buffers: ActivateBuffers<'_>,
        num_gaussians: usize,
    ) -> Result<Self, GpuError> {
        let groups = num_gaussians.div_ceil(WORKGROUP as usize);
        let mask_partials = gpu.storage("sums of the mask losses", 2 * groups.max(1))?;
        let source = shader(packing);
        let b = buffers;
        let stored = [(0, b.step), (1, b.params), (3, b.quantizer_groups), (4, b.group_starts), (5, b.quantizers)];
        let bind = |entry, others: &[(u32, &wgpu::Buffer)]| {
            gpu.kernel(&source, entry).bind(gpu.device(), &[&stored[..], others].concat())
        };
        let fwd = bind("activate_fwd", &[(2, b.flags), (6, b.activated)]);
        let bwd = bind(
            "activate_bwd",
            &[(7, b.v_activated), (8, b.previous_mask_logits), (9, b.grads), (10, &mask_partials)],
        );
        let count = gpu
            .kernel(&source, "count_gradients")
            .bind(gpu.device(), &[(0, b.step), (11, b.v_means2d_ndc), (12, b.statistic), (13, b.status)]);
        gpu.check()?;
        Ok(Self { fwd, bwd, count, num_gaussians, mask_partials })
    }

    /// Records the forward: overwrites `activated` with stored values, fake-quantised, activated and masked.
    pub fn record_fwd(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.fwd.dispatch_over(pass, self.num_gaussians);
    }

    /// Records the backward: *overwrites* `grads` with gradients to the quantised stored values and to mask logits, the
    /// weighted losses on masks included, and `mask_partials`.
    pub fn record_bwd(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.bwd.dispatch_over(pass, self.num_gaussians);
    }

    /// Records the densification statistic; does nothing without [`super::StepUniform::COUNTS`].
    pub fn record_count(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.count.dispatch_over(pass, self.num_gaussians);
    }
}

pub(super) fn shader(packing: &Packing) -> String {
    source(packing, Wgsl::new().activated_columns())
        .part(include_str!("quantize.wgsl"))
        .part(include_str!("activate.wgsl"))
        .finish()
}

#[cfg(test)]
mod tests {
    use tcgs_codec::{BitMap, Quantizer};
    use tcgs_core::{ActivatedGrads, Attribute, Gaussians, Layout, activate, activate_bwd};

    use super::*;
    use crate::dropout::Dropout;
    use crate::engine::device::StepUniform;
    use crate::engine::gpu::test_support::{
        QuantizerTables, assert_close, gpu, random, random_gaussians, random_rows, run, uniform,
    };
    use crate::fake_quant::FakeQuantizers;
    use crate::losses::WeightConfig;
    use crate::mask::{mask, mask_consistency_loss, mask_loss, mask_vjp};

    const THRESHOLD: f32 = 0.3;
    const WEIGHTS: WeightConfig = WeightConfig { mask: 2.0, mask_consistency: 3.0, ..WeightConfig::NONE };

    struct Scene {
        gaussians: Gaussians,
        mask_logits: Vec<f32>,
        previous: Vec<f32>,
        foreground: Vec<bool>,
        quantizers: FakeQuantizers,
    }

    impl Scene {
        fn new(n: usize) -> Self {
            let gaussians = random_gaussians(1, n);
            let mut bit_map = BitMap::uniform(n, 16, 6);
            for widths in &mut bit_map.widths {
                widths.iter_mut().zip(random(5, n, 1.0, 17.0)).for_each(|(w, r)| *w = r as u8);
            }
            let mut previous = random(3, n, -3.0, 3.0);
            let mask_logits = random(2, n, -3.0, 3.0);
            previous[0] = mask_logits[0];
            Self {
                quantizers: FakeQuantizers::new(bit_map, &gaussians, true).unwrap(),
                mask_logits,
                previous,
                foreground: random(4, n, 0.0, 1.0).iter().map(|&r| r < 0.5).collect(),
                gaussians,
            }
        }

        fn params(&self) -> Vec<f32> {
            let attributes = Attribute::BASE.map(|a| self.gaussians.values(a));
            [&attributes.concat()[..], &self.mask_logits].concat()
        }

        fn stored(&self, flags: u32) -> Gaussians {
            if flags & StepUniform::QUANTIZED != 0 {
                self.quantizers.forward(&self.gaussians)
            } else {
                self.gaussians.clone()
            }
        }

        /// As the CPU engine draws.
        fn drawn(&self, flags: u32, dropout: Dropout) -> [Vec<f32>; 5] {
            let mut drawn = activate(&self.stored(flags));
            if flags & StepUniform::MASKED != 0 {
                for (i, &logit) in self.mask_logits.iter().enumerate() {
                    let m = mask(logit, THRESHOLD);
                    drawn.scales[i] = drawn.scales[i].map(|s| s * m);
                    drawn.opacities[i] *= m;
                }
            }
            drawn.opacities.iter_mut().enumerate().for_each(|(i, opacity)| *opacity *= dropout.factor(i as u32));
            let colors = drawn.colors.chunks(3).zip(&self.foreground).flat_map(|(color, &f)| {
                let segmentation = [f32::from(u8::from(f)), f32::from(u8::from(!f))];
                let shown = if flags & StepUniform::SEGMENTED != 0 { 2 } else { 0 };
                [color, &segmentation[..shown]].concat()
            });
            [
                drawn.means.as_flattened().to_vec(),
                drawn.quats.as_flattened().to_vec(),
                drawn.scales.as_flattened().to_vec(),
                drawn.opacities,
                colors.collect(),
            ]
        }

        /// Gradients by attribute, then of mask logits, and the two losses.
        fn grads(&self, flags: u32, dropout: Dropout, v: &[f32]) -> ([Vec<f32>; 6], [f64; 2]) {
            let n = self.mask_logits.len();
            let stored = self.stored(flags);
            let activated = activate(&stored);
            let channels = (v.len() / n) - 11;
            let mut v_activated = ActivatedGrads {
                v_means: v[..3 * n].as_chunks().0.to_vec(),
                v_quats: v[3 * n..7 * n].as_chunks().0.to_vec(),
                v_scales: v[7 * n..10 * n].as_chunks().0.to_vec(),
                v_opacities: v[10 * n..11 * n].to_vec(),
                v_colors: v[11 * n..].chunks(channels).flat_map(|row| row[..3].to_vec()).collect(),
            };
            v_activated.v_opacities.iter_mut().enumerate().for_each(|(i, v)| *v *= dropout.factor(i as u32));
            let mut v_masks = vec![0.0; n];
            let mut losses = [0.0; 2];
            if flags & StepUniform::MASKED != 0 {
                for i in 0..n {
                    let (s, v_s) = (activated.scales[i], v_activated.v_scales[i]);
                    let v_mask = s[0] * v_s[0]
                        + s[1] * v_s[1]
                        + s[2] * v_s[2]
                        + activated.opacities[i] * v_activated.v_opacities[i];
                    v_masks[i] = mask_vjp(self.mask_logits[i], v_mask);
                    let m = mask(self.mask_logits[i], THRESHOLD);
                    v_activated.v_scales[i] = v_s.map(|v| v * m);
                    v_activated.v_opacities[i] *= m;
                }
                losses[0] = mask_loss(&self.mask_logits, |i, v| v_masks[i] += WEIGHTS.mask * v);
                if flags & StepUniform::COMPARES_MASKS != 0 {
                    losses[1] = mask_consistency_loss(&self.mask_logits, &self.previous, |i, v| {
                        v_masks[i] += WEIGHTS.mask_consistency * v;
                    });
                }
            }
            let grads = activate_bwd(&stored, &activated, &v_activated);
            let [means, quats, scales, opacities, colors] = Attribute::BASE.map(|a| grads.values(a).to_vec());
            ([means, quats, scales, opacities, colors, v_masks], losses)
        }
    }

    fn split<'a>(mut values: &'a [f32], lens: &[usize]) -> Vec<&'a [f32]> {
        lens.iter().map(|&len| values.split_off(..len).expect("as long as its parts")).collect()
    }

    struct OnGpu {
        kernels: ActivateKernels,
        activated: wgpu::Buffer,
        grads: wgpu::Buffer,
        statistic: wgpu::Buffer,
    }

    fn on_gpu(gpu: &Gpu, scene: &Scene, step: &StepUniform, v: &[f32], v_ndc: &[f32], status: u32) -> OnGpu {
        let n = scene.mask_logits.len();
        let tables = QuantizerTables::new(&scene.quantizers);
        let upload = |values: &[f32]| gpu.upload("values", values).unwrap();
        let activated = gpu.storage("activated", v.len()).unwrap();
        let (grads, statistic) = (gpu.storage("grads", 15 * n).unwrap(), gpu.storage("statistic", 2 * n).unwrap());
        let flags: Vec<u32> = scene.foreground.iter().map(|&f| u32::from(f) | 2).collect();
        let buffers = ActivateBuffers {
            step: &uniform(gpu, step, &[]),
            params: &upload(&scene.params()),
            flags: &gpu.upload("flags", &flags).unwrap(),
            quantizer_groups: &gpu.upload("groups", &tables.groups).unwrap(),
            group_starts: &gpu.upload("starts", &tables.starts).unwrap(),
            quantizers: &gpu.upload("quantizers", &tables.quantizers).unwrap(),
            activated: &activated,
            v_activated: &upload(v),
            previous_mask_logits: &upload(&scene.previous),
            grads: &grads,
            v_means2d_ndc: &upload(v_ndc),
            statistic: &statistic,
            status: &gpu.upload("status", &[status]).unwrap(),
        };
        let kernels = ActivateKernels::new(gpu, &Packing::new(&Layout::base()), buffers, n).unwrap();
        OnGpu { kernels, activated, grads, statistic }
    }

    #[test]
    fn drawn_values_and_gradients_are_those_of_the_cpu() {
        let Some(gpu) = gpu() else { return };
        let (masked, quantized) = (StepUniform::MASKED, StepUniform::QUANTIZED);
        let (segmented, compares) = (StepUniform::SEGMENTED, StepUniform::COMPARES_MASKS);
        let (all, some) = (Dropout::default(), Dropout { share: 0.3, draw: 7 });
        let cases = [0, masked, quantized | segmented, masked | quantized | compares, masked | compares | segmented]
            .map(|flags| (flags, all));
        for (flags, dropout) in [&cases[..], &[(0, some), (masked | quantized, some)]].concat() {
            for n in [1, 256, 700, 1301] {
                let scene = Scene::new(n);
                let channels = if flags & segmented != 0 { 5 } else { 3 };
                let v = random(6, (11 + channels) * n, -1.0, 1.0);
                let step = StepUniform {
                    num_gaussians: n as u32,
                    num_drawn: n as u32,
                    flags,
                    mask_threshold: THRESHOLD,
                    drop_share: dropout.share,
                    drop_draw: dropout.draw,
                    weights: WEIGHTS.values(),
                    ..StepUniform::default()
                };
                let found = on_gpu(&gpu, &scene, &step, &v, &vec![0.0; 3 * n], 0);
                run(&gpu, |pass| {
                    found.kernels.record_fwd(pass);
                    found.kernels.record_bwd(pass);
                });

                let names = ["means", "quats", "scales", "opacities", "colors", "masks"];
                let activated: Vec<f32> = gpu.read(&found.activated, v.len()).unwrap();
                let lens = [3, 4, 3, 1, channels].map(|c| c * n);
                for ((name, found), expected) in
                    names.iter().zip(split(&activated, &lens)).zip(scene.drawn(flags, dropout))
                {
                    assert_close(&format!("{name} of {n}, flags {flags}"), found, &expected, 2e-6);
                }
                let grads: Vec<f32> = gpu.read(&found.grads, 15 * n).unwrap();
                let (expected, losses) = scene.grads(flags, dropout, &v);
                let lens = [3, 4, 3, 1, 3, 1].map(|c| c * n);
                for ((name, found), expected) in names.iter().zip(split(&grads, &lens)).zip(&expected) {
                    assert_close(&format!("v of {name} of {n}, flags {flags}"), found, expected, 5e-6);
                }
                let groups = n.div_ceil(256);
                let partials: Vec<f32> = gpu.read(&found.kernels.mask_partials, 2 * groups).unwrap();
                for (i, loss) in losses.iter().enumerate() {
                    let sum: f64 = partials.iter().skip(i).step_by(2).map(|&p| f64::from(p)).sum();
                    assert!((sum / n as f64 - loss).abs() <= 1e-6 * loss, "{sum} / {n} against {loss}");
                }
            }
        }
    }

    /// Values at, just below and just above the middle between two codes, and elsewhere, among them far
    /// outside, for quantizers of every width.
    fn delicate(n: usize) -> Scene {
        let mut scene = Scene::new(n);
        let mut bit_map = BitMap::uniform(n, 16, 8);
        bit_map.widths[Attribute::Color.index()].iter_mut().enumerate().for_each(|(i, w)| *w = (i % 16) as u8 + 1);
        let mut quantizers = FakeQuantizers::new(bit_map, &scene.gaussians, true).unwrap();
        let first = quantizers.quantizers.len() - 48;
        for (i, q) in quantizers.quantizers[first..].iter_mut().enumerate() {
            // For each width: exact halves, a symmetric quantizer, an offset beyond the range. No half lies at zero,
            // because values around zero are so small that f64 loses them beside the offset.
            let step = 2.0_f32.powi(-i32::from(q.bits));
            let (step, offset) = [(step, 0.25 + 2.0_f32.powi(-20)), (step * 1.1, 0.0), (step * 0.7, -3.1)][i % 3];
            *q = Quantizer::new(step, offset, q.bits).unwrap();
        }
        let picks: Vec<f32> = random(8, 3 * n, 0.0, 1.0);
        for (i, color) in scene.gaussians.colors_mut().iter_mut().enumerate() {
            for (channel, x) in color.iter_mut().enumerate() {
                let q = quantizers.quantizers[first + 3 * (i % 16) + channel];
                let span = f64::from(q.max_code()) - f64::from(q.min_code()) + 2.0;
                let code = (f64::from(q.min_code()) - 1.0 + f64::from(picks[3 * i + channel]) * span).floor();
                let middle = ((code + 0.5) * f64::from(q.step) + f64::from(q.offset)) as f32;
                *x = match i / 16 % 6 {
                    0 => middle,
                    1 => middle.next_up(),
                    2 => middle.next_down(),
                    3 => middle.next_up().next_up(),
                    4 => (middle - q.offset) * 100.0,
                    _ => middle + q.step * picks[3 * i + channel].fract(),
                };
            }
        }
        scene.quantizers = quantizers;
        scene
    }

    #[test]
    fn codes_are_those_of_the_cpu() {
        let Some(gpu) = gpu() else { return };
        let n = 20_000;
        let scene = delicate(n);
        let (num, flags) = (n as u32, StepUniform::QUANTIZED);
        let step = StepUniform { num_gaussians: num, num_drawn: num, flags, ..StepUniform::default() };
        let found = on_gpu(&gpu, &scene, &step, &vec![0.0; 14 * n], &vec![0.0; 3 * n], 0);
        run(&gpu, |pass| found.kernels.record_fwd(pass));
        let activated: Vec<f32> = gpu.read(&found.activated, 14 * n).unwrap();
        let first = scene.quantizers.quantizers.len() - 48;
        for (i, color) in activated[11 * n..].chunks(3).enumerate() {
            for (channel, &value) in color.iter().enumerate() {
                let q = scene.quantizers.quantizers[first + 3 * (i % 16) + channel];
                let x = scene.gaussians.colors()[i][channel];
                let code = (f64::from(value) - f64::from(q.offset)) / f64::from(q.step);
                assert_eq!(code.round() as i32, q.quantize(x), "{x} by {q:?}");
                assert!((value - q.dequantize(q.quantize(x))).abs() <= value.abs().max(q.offset.abs()) * 1.2e-7);
            }
        }
    }

    #[test]
    fn visible_gradients_are_counted_unless_halted() {
        let Some(gpu) = gpu() else { return };
        let n = 777;
        let scene = Scene::new(n);
        let mut v_ndc = random_rows::<3>(7, n, -1.0, 1.0);
        v_ndc.iter_mut().for_each(|v| v[2] = f32::from(u8::from(v[2] > 0.0)));
        let v = vec![0.0; 14 * n];
        for (flags, status, times) in [(StepUniform::COUNTS, 0, 3), (StepUniform::COUNTS, 1, 0), (0, 0, 0)] {
            let step = StepUniform { num_gaussians: n as u32, flags, ..StepUniform::default() };
            let found = on_gpu(&gpu, &scene, &step, &v, v_ndc.as_flattened(), status);
            run(&gpu, |pass| (0..3).for_each(|_| found.kernels.record_count(pass)));
            let statistic: Vec<f32> = gpu.read(&found.statistic, 2 * n).unwrap();
            let count = |v: &[f32; 3]| times as f32 * v[2];
            let sums: Vec<f32> = v_ndc.iter().map(|v| count(v) * (v[0] * v[0] + v[1] * v[1]).sqrt()).collect();
            assert_close("sums", &statistic[..n], &sums, 1e-6);
            assert!(statistic[n..].iter().zip(&v_ndc).all(|(&found, v)| found == count(v)));
        }
    }
}
