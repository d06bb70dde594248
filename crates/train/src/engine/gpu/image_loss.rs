//! `0.8 L1 + 0.2 (1 − SSIM)` on the GPU: see [`crate::engine::cpu::image_loss`].
//!
//! Two kernels, since the backward filter needs the forward's maps from beyond its block. The floor, for
//! every pixel and channel: forward reads 8 bytes (image, target) and writes 12 (three maps), backward
//! reads 20 and writes 4; blocks overlap, so that a value is read 2.6 times, from the cache all but once.
//! Arithmetic: about 250 operations forward, 120 backward, and 100 and 70 reads of workgroup memory.

use tcgs_metrics::{SSIM_C1, SSIM_C2, SSIM_WINDOW};
use tcgs_render::device::Wgsl;
use tcgs_render::gpu::raw::Bound;
use tcgs_render::gpu::{Gpu, GpuError};

use crate::engine::device::{Packing, source};
use crate::losses::{COUNTED_CHANNELS, L1_SHARE};

/// Pixels along a block's side.
const SIDE: usize = 16;

/// What the image losses read and write.
#[derive(Clone, Copy, Debug)]
pub struct ImageLossBuffers<'a> {
    /// [`super::StepUniform`]
    pub step: &'a wgpu::Buffer,
    /// `[C, H, W]` before the camera's colours.
    pub rendered: &'a wgpu::Buffer,
    /// `[views, H, W]` bytes red, green, blue, foreground.
    pub targets: &'a wgpu::Buffer,
    /// `[2, K, 3]` logarithms of gains, then offsets; what follows is not read.
    pub cameras: &'a wgpu::Buffer,
    /// `[C, H, W]` overwritten.
    pub v_image: &'a wgpu::Buffer,
}

/// Forward and backward of the image losses, bound to their buffers, and the maps that pass between them.
#[derive(Clone, Debug)]
pub struct ImageLossKernels {
    fwd: Bound,
    bwd: Bound,
    /// `[C, blocks, 4]` sums over each block of 16x16 pixels, row by row: `1 − SSIM`, `|x − y|`, gradients to
    /// the gain and to the offset. The last two say nothing for channels of segmentation.
    pub partials: wgpu::Buffer,
}

impl ImageLossKernels {
    /// Binds both kernels, and makes room for the maps of the largest image.
    ///
    /// - `max_shape`: `[C, H, W]` of the largest image
    ///
    /// # Errors
    /// If memory for the maps or partial sums cannot be had.
    pub fn new(
        gpu: &Gpu,
        packing: &Packing,
        buffers: ImageLossBuffers<'_>,
        max_shape: [usize; 3],
    ) -> Result<Self, GpuError> {
        let [channels, height, width] = max_shape;
        let maps = gpu.storage("derivatives of SSIM", 3 * channels * height * width)?;
        let blocks = height.div_ceil(SIDE) * width.div_ceil(SIDE);
        let partials = gpu.storage("sums of the image loss", 4 * channels * blocks)?;
        let source = shader(packing);
        let inputs = [(0, buffers.step), (1, buffers.rendered), (2, buffers.targets), (3, buffers.cameras)];
        let kept = [(4, &maps), (5, &partials)];
        let fwd = gpu.kernel(&source, "image_loss_fwd").bind(gpu.device(), &[&inputs[..], &kept].concat());
        let outputs = [(6, buffers.v_image)];
        let bwd = gpu.kernel(&source, "image_loss_bwd").bind(gpu.device(), &[&inputs[..], &kept, &outputs].concat());
        gpu.check()?;
        Ok(Self { fwd, bwd, partials })
    }

    /// Records forward, then backward.
    ///
    /// - `shape`: `[C, H, W]` of this image, as the uniform says
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>, shape: [usize; 3]) {
        let [channels, height, width] = shape;
        let groups = [width.div_ceil(SIDE) as u32, height.div_ceil(SIDE) as u32, channels as u32];
        self.fwd.dispatch(pass, groups);
        self.bwd.dispatch(pass, groups);
    }
}

/// What the shaders of the loss and of its sums share.
pub(super) fn constants() -> Wgsl {
    Wgsl::new().constant("L1_SHARE", L1_SHARE).constant("COUNTED_CHANNELS", COUNTED_CHANNELS).constant("SIDE", SIDE)
}

pub(super) fn shader(packing: &Packing) -> String {
    let mut constants = constants().constant("C1", SSIM_C1).constant("C2", SSIM_C2);
    for (distance, weight) in SSIM_WINDOW.into_iter().enumerate() {
        constants = constants.constant(&format!("WINDOW{distance}"), weight);
    }
    source(packing, constants).part(include_str!("image_loss.wgsl")).finish()
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Image, Layout};

    use super::*;
    use crate::engine::cpu;
    use crate::engine::device::StepUniform;
    use crate::engine::gpu::test_support::{assert_close, gpu, random, run, uniform};
    use crate::losses::WeightConfig;

    const GAIN: [f32; 3] = [0.1, -0.2, 0.05];
    const OFFSET: [f32; 3] = [0.02, 0.0, -0.03];

    /// Packed values of two views, the second of which is wanted, and that one as an image.
    fn target(seed: u64, [channels, height, width]: [usize; 3]) -> (Vec<u32>, Image) {
        let pixels = height * width;
        let packed: Vec<u32> = random(seed, 2 * pixels, 0.0, 256.0)
            .iter()
            .enumerate()
            .map(|(i, &v)| {
                let foreground = 255 * u32::from(v > 128.0);
                // Noise above, a ramp below: where an image is smooth SSIM is at its most delicate.
                let red = if i % pixels < pixels / 2 { v as u32 } else { (i % width * 255 / width) as u32 };
                red | (v as u32 * 7 % 256) << 8 | (i as u32 % 256) << 16 | foreground << 24
            })
            .collect();
        let mut image = Image::filled(width, height, channels, 0.0);
        for (channel, plane) in image.data.chunks_mut(pixels).enumerate() {
            for (value, word) in plane.iter_mut().zip(&packed[pixels..]) {
                let bytes = word.to_le_bytes();
                *value = f32::from(if channel == 4 { 255 - bytes[3] } else { bytes[channel] }) / 255.0;
            }
        }
        (packed, image)
    }

    #[test]
    fn values_and_gradients_are_those_of_the_cpu() {
        let Some(gpu) = gpu() else { return };
        for shape in [[3, 3, 5], [3, 16, 16], [5, 23, 37], [3, 70, 131], [5, 48, 64]] {
            let [channels, height, width] = shape;
            let (packed, target) = target(1, shape);
            // Near the target in every other row.
            let noise = random(2, target.data.len(), -0.1, 1.1);
            let near = |(i, (r, t)): (usize, (&f32, &f32))| if i / width % 2 == 0 { *r } else { t + 0.05 * r };
            let rendered =
                Image { data: noise.iter().zip(&target.data).enumerate().map(near).collect(), ..target.clone() };
            let expected = cpu::image_loss(&rendered, &target, GAIN, OFFSET, 1.5, 3.0);

            let mut cameras = vec![9.0; 18];
            cameras[6..9].copy_from_slice(&GAIN);
            cameras[15..].copy_from_slice(&OFFSET);
            let step = StepUniform {
                num_cameras: 3,
                camera: 2,
                width: width as u32,
                height: height as u32,
                target_offset: (width * height) as u32,
                weights: WeightConfig { image: 1.5, segmentation: 3.0, ..WeightConfig::NONE }.values(),
                ..StepUniform::default()
            };
            let v_image = gpu.storage("v_image", rendered.data.len()).unwrap();
            let buffers = ImageLossBuffers {
                step: &uniform(&gpu, &step, &[]),
                rendered: &gpu.upload("rendered", &rendered.data).unwrap(),
                targets: &gpu.upload("targets", &packed).unwrap(),
                cameras: &gpu.upload("cameras", &cameras).unwrap(),
                v_image: &v_image,
            };
            let kernels = ImageLossKernels::new(&gpu, &Packing::new(&Layout::base()), buffers, shape).unwrap();
            run(&gpu, |pass| kernels.record(pass, shape));

            let found: Vec<f32> = gpu.read(&v_image, rendered.data.len()).unwrap();
            assert_close(&format!("v_image of {shape:?}"), &found, &expected.v_image.data, 1e-5);
            let blocks = height.div_ceil(SIDE) * width.div_ceil(SIDE);
            let partials: Vec<[f32; 4]> =
                gpu.read::<f32>(&kernels.partials, 4 * channels * blocks).unwrap().as_chunks::<4>().0.to_vec();
            let sum = |channels: std::ops::Range<usize>, i: usize| -> f64 {
                partials[channels.start * blocks..channels.end * blocks].iter().map(|p| f64::from(p[i])).sum()
            };
            let loss = |range: std::ops::Range<usize>| {
                (0.8 * sum(range.clone(), 1) + 0.2 * sum(range, 0)) / (3 * width * height) as f64
            };
            let pairs = [(loss(0..3), expected.image), (loss(3..channels), expected.segmentation)];
            for (found, expected) in pairs {
                assert!((found - expected).abs() <= 1e-6 * expected, "{shape:?}: {found} against {expected}");
            }
            let along = |i| [0, 1, 2].map(|c| sum(c..c + 1, i) as f32);
            assert_close("v_gain", &along(2), &expected.v_gain, 1e-5);
            assert_close("v_offset", &along(3), &expected.v_offset, 1e-5);
        }
    }
}
