//! `0.8 L1 + 0.2 (1 − SSIM)` on the GPU: see [`crate::engine::cpu::image_loss`].
//!
//! Two kernels, since the backward filter needs the forward's maps from beyond its block. The floor, for every pixel
//! and channel: forward reads 8 bytes (image, target) and writes 12 (three maps), backward reads 20 and writes 4.
//! Blocks overlap, so that a value is read 2.6 times; all reads but the first hit the cache. Arithmetic takes about 250
//! operations forward and 120 backward, and 100 and 70 reads of workgroup memory.

use tcgs_metrics::{SSIM_C1, SSIM_C2, SSIM_WINDOW};
use tcgs_render::device::{Coverage, MAX_GROUPS_X, Wgsl, groups_in_rows};
use tcgs_render::gpu::raw::Bound;
use tcgs_render::gpu::{Gpu, GpuError};

use crate::engine::device::{NO_SLOT, Packing, StepUniform, source};
use crate::losses::{COUNTED_CHANNELS, L1_SHARE};

/// Pixels along a block's side.
const SIDE: usize = 16;

/// Buffers of the image losses.
#[derive(Clone, Copy, Debug)]
pub struct ImageLossBuffers<'a> {
    /// [`super::StepUniform`]
    pub step: &'a wgpu::Buffer,
    /// `[C, H, W]` before the camera's gain and offset.
    pub rendered: &'a wgpu::Buffer,
    /// `[views, H, W]` bytes red, green, blue, foreground; `[slots, 256]` if a part is drawn.
    pub targets: &'a wgpu::Buffer,
    /// `[2, K, 3]` logarithms of gains, then offsets; the rest is not read.
    pub cameras: &'a wgpu::Buffer,
    /// `[C, H, W]` overwritten, in the tiles that are drawn.
    pub v_image: &'a wgpu::Buffer,
    /// If a part is drawn: the lists of its views and the pixels around its tiles, as in
    /// [`SceneryLists`](crate::engine::device::SceneryLists).
    pub part: Option<[&'a wgpu::Buffer; 2]>,
}

/// Forward and backward of the image losses, bound to their buffers, and the maps that pass between them.
#[derive(Clone, Debug)]
pub struct ImageLossKernels {
    fwd: Bound,
    bwd: Bound,
    /// `[C, blocks, 4]` sums over each block of 16x16 pixels, in the order of the blocks: `1 − SSIM`, `|x − y|`,
    /// gradients with respect to gain and offset. The last two are meaningless for segmentation channels.
    pub partials: wgpu::Buffer,
}

impl ImageLossKernels {
    /// Binds both kernels, and makes room for the maps of the largest image.
    ///
    /// - `max_shape`: `[C, H, W]` of the largest image
    /// - `max_blocks`: most blocks of an image that are compared
    ///
    /// # Errors
    /// If memory for the maps or partial sums cannot be allocated.
    pub fn new(
        gpu: &Gpu,
        packing: &Packing,
        buffers: ImageLossBuffers<'_>,
        max_shape: [usize; 3],
        max_blocks: usize,
    ) -> Result<Self, GpuError> {
        let [channels, height, width] = max_shape;
        let maps = gpu.storage("derivatives of SSIM", 3 * channels * height * width)?;
        let partials = gpu.storage("sums of the image loss", 4 * channels * max_blocks)?;
        let coverage = if buffers.part.is_some() { Coverage::Listed } else { Coverage::Whole };
        let source = shader(packing, coverage);
        let mut inputs = vec![(0, buffers.step), (1, buffers.rendered), (2, buffers.targets), (3, buffers.cameras)];
        inputs.extend([(4, &maps), (5, &partials)]);
        inputs.extend(buffers.part.iter().flat_map(|&[lists, pictures]| [(7, lists), (8, pictures)]));
        let fwd = gpu.kernel(&source, "image_loss_fwd").bind(gpu.device(), &inputs);
        inputs.push((6, buffers.v_image));
        let bwd = gpu.kernel(&source, "image_loss_bwd").bind(gpu.device(), &inputs);
        gpu.check()?;
        Ok(Self { fwd, bwd, partials })
    }

    /// Records forward, then backward.
    ///
    /// - `step`: the iteration's uniform
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>, step: &StepUniform) {
        let channels = if step.has(StepUniform::SEGMENTED) { 5 } else { 3 };
        let groups = |blocks: u32| {
            let [x, y, _] = groups_in_rows(blocks as usize);
            [x, y, channels]
        };
        self.fwd.dispatch(pass, groups(step.num_blocks));
        self.bwd.dispatch(pass, groups(step.num_tiles));
    }
}

/// Constants that the shaders of the loss and of its sums share.
pub(super) fn constants() -> Wgsl {
    Wgsl::new().constant("L1_SHARE", L1_SHARE).constant("COUNTED_CHANNELS", COUNTED_CHANNELS).constant("SIDE", SIDE)
}

pub(super) fn shader(packing: &Packing, coverage: Coverage) -> String {
    let mut constants = constants()
        .constant("C1", SSIM_C1)
        .constant("C2", SSIM_C2)
        .constant("MAX_GROUPS_X", MAX_GROUPS_X)
        .constant("NO_SLOT", NO_SLOT);
    let pixels = match coverage {
        Coverage::Whole => include_str!("image_whole.wgsl"),
        Coverage::Listed => include_str!("image_listed.wgsl"),
    };
    for (distance, weight) in SSIM_WINDOW.into_iter().enumerate() {
        constants = constants.constant(&format!("WINDOW{distance}"), weight);
    }
    source(packing, constants).part(include_str!("image_loss.wgsl")).part(pixels).finish()
}

#[cfg(test)]
mod tests {
    use tcgs_core::{Activated, Camera, Image, Layout, activate};
    use tcgs_render::TileMask;

    use super::*;
    use crate::engine::device::SceneryLists;
    use crate::engine::gpu::test_support::{assert_close, gpu, random, random_gaussians, run, uniform};
    use crate::engine::{Scenery, Target, ViewScenery, cpu};
    use crate::losses::WeightConfig;

    const GAIN: [f32; 3] = [0.1, -0.2, 0.05];
    const OFFSET: [f32; 3] = [0.02, 0.0, -0.03];

    /// Packed values of two views, and the second of them as an image.
    fn target(seed: u64, [channels, height, width]: [usize; 3]) -> (Vec<u32>, Image) {
        let pixels = height * width;
        let packed: Vec<u32> = random(seed, 2 * pixels, 0.0, 256.0)
            .iter()
            .enumerate()
            .map(|(i, &v)| {
                let foreground = 255 * u32::from(v > 128.0);
                // Noise above, a ramp below: SSIM is most delicate in smooth parts of an image.
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
            let [channels, height, width]: [usize; 3] = shape;
            let blocks = height.div_ceil(SIDE) * width.div_ceil(SIDE);
            let (packed, target) = target(1, shape);
            // Near the target in every other row.
            let noise = random(2, target.data.len(), -0.1, 1.1);
            let near = |(i, (r, t)): (usize, (&f32, &f32))| if i / width % 2 == 0 { *r } else { t + 0.05 * r };
            let rendered =
                Image { data: noise.iter().zip(&target.data).enumerate().map(near).collect(), ..target.clone() };
            let mut expected_v = Image::default();
            let expected = cpu::image_loss(&rendered, &target, GAIN, OFFSET, 1.5, 3.0, &mut expected_v);

            let mut cameras = vec![9.0; 18];
            cameras[6..9].copy_from_slice(&GAIN);
            cameras[15..].copy_from_slice(&OFFSET);
            let step = StepUniform {
                num_cameras: 3,
                camera: 2,
                width: width as u32,
                height: height as u32,
                target_offset: (width * height) as u32,
                num_tiles: blocks as u32,
                num_blocks: blocks as u32,
                flags: if channels == 5 { StepUniform::SEGMENTED } else { 0 },
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
                part: None,
            };
            let kernels = ImageLossKernels::new(&gpu, &Packing::new(&Layout::base()), buffers, shape, blocks).unwrap();
            run(&gpu, |pass| kernels.record(pass, &step));

            let found: Vec<f32> = gpu.read(&v_image, rendered.data.len()).unwrap();
            assert_close(&format!("v_image of {shape:?}"), &found, &expected_v.data, 1e-5);
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

    /// Gradient of the image and sums of the blocks, for a whole image or a part.
    fn on_gpu(
        gpu: &Gpu,
        step: &StepUniform,
        rendered: &Image,
        targets: &[u32],
        part: Option<&SceneryLists>,
    ) -> (Vec<f32>, Vec<f32>) {
        let [channels, height, width] = rendered.shape();
        let v_image = gpu.storage("v_image", rendered.data.len()).unwrap();
        let lists =
            part.map(|p| [gpu.upload("lists", &p.lists).unwrap(), gpu.upload("pictures", &p.pictures).unwrap()]);
        // Around the drawn tiles the image is undefined.
        let mut drawn = rendered.clone();
        if let Some(lists) = part {
            let [columns, at] = [width.div_ceil(SIDE), step.slots_at as usize];
            for (i, value) in drawn.data.iter_mut().enumerate() {
                let (x, y) = (i % width, i / width % height);
                if lists.lists[at + y / SIDE * columns + x / SIDE] >= step.num_tiles {
                    *value = f32::NAN;
                }
            }
        }
        let buffers = ImageLossBuffers {
            step: &uniform(gpu, step, &[]),
            rendered: &gpu.upload("rendered", &drawn.data).unwrap(),
            targets: &gpu.upload("targets", targets).unwrap(),
            cameras: &gpu.upload("cameras", &[&GAIN[..], &OFFSET].concat()).unwrap(),
            v_image: &v_image,
            part: lists.as_ref().map(|[lists, pictures]| [lists, pictures]),
        };
        let (shape, blocks) = ([channels, height, width], step.num_blocks as usize);
        let kernels = ImageLossKernels::new(gpu, &Packing::new(&Layout::base()), buffers, shape, blocks).unwrap();
        run(gpu, |pass| kernels.record(pass, step));
        let partials = gpu.read(&kernels.partials, 4 * channels * blocks).unwrap();
        (gpu.read(&v_image, rendered.data.len()).unwrap(), partials)
    }

    #[test]
    fn some_tiles_have_the_gradient_of_the_whole_image_to_the_bit() {
        let Some(gpu) = gpu() else { return };
        let (width, height) = (120, 91);
        let mut some = TileMask::none(width, height);
        for (x, y) in [(0, 0), (40, 20), (56, 20), (40, 36), (119, 90), (70, 70)] {
            some.insert_pixels(x..x + 1, y..y + 1);
        }
        for (channels, tiles) in [(3, some.clone()), (5, some), (5, TileMask::all(width, height))] {
            let (packed, image) = target(3, [channels, height, width]);
            let rendered = Image { data: random(4, image.data.len(), 0.0, 1.0), ..image.clone() };
            let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 50.0, width, height);
            let drawn = Activated { num_channels: channels, ..activate(&random_gaussians(1, 1)) };
            let drawn = Activated { colors: vec![0.5; channels], ..drawn };
            let view =
                ViewScenery { tiles: tiles.clone(), gaussians: vec![0], colors: None, picture: rendered.clone() };
            let scenery = Scenery { num_active: 1, drawn, places: vec![0], views: vec![view] };
            let lists = SceneryLists::new(&scenery, &[Target { camera, image }]);
            let blocks = (height.div_ceil(SIDE) * width.div_ceil(SIDE)) as u32;
            let whole = StepUniform {
                num_cameras: 1,
                width: width as u32,
                height: height as u32,
                num_tiles: blocks,
                num_blocks: blocks,
                flags: if channels == 5 { StepUniform::SEGMENTED } else { 0 },
                weights: WeightConfig { image: 1.5, segmentation: 3.0, ..WeightConfig::NONE }.values(),
                ..StepUniform::default()
            };
            let view = lists.views[0];
            let part = StepUniform {
                num_tiles: view.part.num_tiles,
                num_blocks: view.num_near,
                slots_at: view.slots_at,
                flags: whole.flags | StepUniform::LISTED,
                ..whole
            };
            let (expected, expected_sums) = on_gpu(&gpu, &whole, &rendered, &packed[width * height..], None);
            let (found, sums) = on_gpu(&gpu, &part, &rendered, &lists.targets, Some(&lists));
            for tile in tiles.iter() {
                let [columns, rows] = tiles.pixels(tile, width, height);
                for (channel, y) in (0..channels).flat_map(|c| rows.clone().map(move |y| (c, y))) {
                    let at = (channel * height + y) * width;
                    let range = at + columns.start..at + columns.end;
                    assert_eq!(found[range.clone()], expected[range], "tile {tile}, channel {channel}, row {y}");
                }
            }
            if tiles == TileMask::all(width, height) {
                assert_eq!(sums, expected_sums);
            } else {
                assert!(sums.iter().all(|sum| sum.is_finite()) && view.num_near < blocks);
            }
        }
    }
}
