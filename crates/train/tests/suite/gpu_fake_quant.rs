//! Fake quantisation on the GPU against that on the CPU.

use std::sync::Arc;

use crate::support::{Random, further_layout, gpu, packed, relative_l2};
use tcgs_codec::BitMap;
use tcgs_core::{GaussianGrads, Gaussians, Layout};
use tcgs_render::gpu::Gpu;
use tcgs_train::FakeQuantizers;
use tcgs_train::engine::gpu::testing::{FakeQuantKernels, Packing, QuantizerBuffers, StepUniform};

/// Gradients and the sums for steps and offsets.
fn backward(
    gpu: &Gpu,
    quantizers: &FakeQuantizers,
    gaussians: &Gaussians,
    v: &[f32],
    flags: u32,
) -> (Vec<f32>, Vec<f32>, Vec<f32>) {
    let n = gaussians.num_gaussians();
    let packing = Packing::new(gaussians.layout());
    let buffers = QuantizerBuffers::new(gpu, &packing, quantizers).unwrap();
    let params = gpu.upload("params", &packed(gaussians)).unwrap();
    let grads = gpu.upload("grads", v).unwrap();
    let step = gpu.uniform("step", StepUniform::size(&packing)).unwrap();
    let settings = StepUniform { num_gaussians: n as u32, flags, ..Default::default() };
    gpu.queue().write_buffer(&step, 0, &settings.bytes(&vec![[0.0; 4]; packing.num_groups()]));
    let kernels = FakeQuantKernels::new(gpu, &packing, &buffers, &params, &grads, &step);
    let mut encoder = gpu.encoder();
    kernels.record(&mut encoder.begin_compute_pass(&Default::default()));
    gpu.submit(encoder);

    let num_quantizers = quantizers.quantizers.len();
    let rows: Vec<u32> = gpu.read(&buffers.quantizer_rows, num_quantizers + 1).unwrap();
    let partials: Vec<[f32; 2]> = gpu
        .read::<f32>(&buffers.quantizer_partials, 2 * rows[num_quantizers] as usize)
        .unwrap()
        .as_chunks::<2>()
        .0
        .to_vec();
    let scales: Vec<f32> = gpu.read(&buffers.gradient_scales, num_quantizers).unwrap();
    let sum = |q: usize, which: usize| {
        let own = &partials[rows[q] as usize..rows[q + 1] as usize];
        own.iter().map(|row| f64::from(row[which])).sum::<f64>() as f32 * scales[q]
    };
    (
        gpu.read(&grads, v.len()).unwrap(),
        (0..num_quantizers).map(|q| sum(q, 0)).collect(),
        (0..num_quantizers).map(|q| sum(q, 1)).collect(),
    )
}

fn scene(layout: &Arc<Layout>, n: usize, random: &mut Random) -> (BitMap, Gaussians) {
    let mut bit_map = BitMap::uniform_of(layout, n, 16, 8);
    let mut gaussians = Gaussians::zeros_of(layout, n);
    for column in layout.columns() {
        let attribute = column.attribute;
        let size = 1.0 + attribute.index() as f32;
        gaussians.values_mut(attribute).fill_with(|| random.within(size) + 0.3);
        if column.quantized {
            // One width of many chunks, a few of one chunk, and one of a lone Gaussian.
            bit_map.widths[attribute.index()].fill_with(|| [6, 6, 6, 4, 5, 7, 9, 12][random.below(8)]);
            bit_map.widths[attribute.index()][n / 2] = 1 + attribute.index() as u8 % 3;
        }
    }
    (bit_map, gaussians)
}

#[test]
fn gradients_are_those_of_the_cpu() {
    let Some(gpu) = gpu() else { return };
    let mut random = Random::new(7);
    let (base, further) = (Layout::base(), further_layout());
    for (layout, n, learned_offset) in
        [(&base, 9_001, true), (&base, 9_001, false), (&base, 300, true), (&further, 2_500, true)]
    {
        let values = layout.components() + 1;
        let (bit_map, mut gaussians) = scene(layout, n, &mut random);
        let quantizers = FakeQuantizers::new(bit_map, &gaussians, learned_offset).unwrap();
        // Values have moved since: some are beyond the range, some exactly at its end or between two codes.
        for attribute in layout.attributes() {
            gaussians.values_mut(attribute).iter_mut().for_each(|x| *x = 1.1 * *x + random.within(0.02));
        }
        for (i, &(attribute, width)) in quantizers.groups.iter().enumerate() {
            let first: usize = quantizers.groups[..i].iter().map(|(a, _)| a.components()).sum();
            let widths = &quantizers.bit_map.widths[attribute.index()];
            let members = (0..n).filter(|&i| widths[i] == width);
            for (code, member) in [-8.0, 7.0, -0.5, 0.5, 1.5, -2.5].into_iter().zip(members) {
                for component in 0..attribute.components() {
                    let q = &quantizers.quantizers[first + component];
                    gaussians.values_mut(attribute)[member * attribute.components() + component] =
                        code * q.step + q.offset;
                }
            }
        }
        let v: Vec<f32> = (0..values * n).map(|_| random.within(1.0)).collect();
        let mut expected = GaussianGrads::zeros_of(layout, n);
        let mut first = 0;
        for attribute in layout.attributes() {
            let own = expected.values_mut(attribute);
            own.copy_from_slice(&v[first..first + own.len()]);
            first += own.len();
        }
        let (v_steps, v_offsets) = quantizers.backward(&gaussians, &mut expected);

        let (found, found_steps, found_offsets) = backward(&gpu, &quantizers, &gaussians, &v, StepUniform::QUANTIZED);
        let mut expected = packed(&expected);
        expected[first..].copy_from_slice(&v[first..]);
        // A quotient may round differently, so that a value falls on the other side of a range's end.
        let different = found.iter().zip(&expected).filter(|(a, b)| a != b).count();
        assert!(different <= n / 1000, "{different} gradients of {n} Gaussians differ");
        let errors = [relative_l2(&found_steps, &v_steps), relative_l2(&found_offsets, &v_offsets)];
        eprintln!("{n}: {different} differ, {errors:?}");
        assert!(errors.iter().all(|&e| e < 1e-5), "relative L2 {errors:?}");
    }
}

#[test]
fn nothing_happens_before_quantisation() {
    let Some(gpu) = gpu() else { return };
    let (bit_map, gaussians) = scene(&Layout::base(), 100, &mut Random::new(3));
    let quantizers = FakeQuantizers::new(bit_map, &gaussians, true).unwrap();
    let v = vec![1.5; 1500];
    let (found, v_steps, _) = backward(&gpu, &quantizers, &gaussians, &v, 0);
    assert_eq!(found, v);
    assert!(v_steps.iter().all(|&v| v == 0.0));

    let none = FakeQuantizers::restore(BitMap::uniform(0, 16, 8), vec![], vec![], vec![], true);
    let (_, v_steps, _) = backward(&gpu, &none, &Gaussians::zeros(0), &[], StepUniform::QUANTIZED);
    assert!(v_steps.is_empty());
    gpu.check().unwrap();
}

#[test]
fn every_gaussian_finds_its_quantizers() {
    let Some(gpu) = gpu() else { return };
    for layout in [Layout::base(), further_layout()] {
        let (bit_map, gaussians) = scene(&layout, 500, &mut Random::new(5));
        let quantizers = FakeQuantizers::new(bit_map, &gaussians, true).unwrap();
        let buffers = QuantizerBuffers::new(&gpu, &Packing::new(&layout), &quantizers).unwrap();
        let quantized: Vec<_> = layout.columns().iter().filter(|column| column.quantized).collect();
        let words = quantized.len().div_ceil(4);
        let groups: Vec<u32> = gpu.read(&buffers.quantizer_groups, 500 * words).unwrap();
        let starts: Vec<u32> = gpu.read(&buffers.group_starts, 256).unwrap();
        let table: Vec<f32> = gpu.read(&buffers.quantizers, 4 * quantizers.quantizers.len()).unwrap();
        let wanted = quantizers.table();
        for (place, column) in quantized.into_iter().enumerate() {
            for i in 0..500 {
                let word = groups[place / 4 * 500 + i];
                let first = starts[(word >> (8 * (place % 4)) & 255) as usize] as usize;
                for channel in 0..column.components() {
                    let width = quantizers.bit_map.widths[column.attribute.index()][i];
                    let q = wanted.get(column.attribute, width, channel).unwrap();
                    let expected = [q.step, q.offset, q.min_code() as f32, q.max_code() as f32];
                    assert_eq!(table[4 * (first + channel)..][..4], expected, "{}", column.name);
                }
            }
        }
    }
}
