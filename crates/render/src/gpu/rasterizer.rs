//! The GPU renderer behind the contract that every renderer keeps: arrays in, arrays out.

use std::sync::{Mutex, PoisonError};

use tcgs_core::{Activated, ActivatedGrads, Camera, Image};

use super::{Capacity, Gpu, GpuError, GpuRenderer};
use crate::{Draw, Rasterizer, RenderGrads, RenderOutput, RenderSettings};

/// Draws on a GPU. Buffers are kept from one image to the next.
#[derive(Debug)]
pub struct GpuRasterizer {
    gpu: Gpu,
    renderer: Mutex<Option<GpuRenderer>>,
}

/// What the GPU's forward keeps for its backward: nothing, since its buffers serve the next image too. Backward draws
/// again; training does not take this way.
#[derive(Clone, Copy, Debug)]
pub struct GpuSaved;

impl GpuRasterizer {
    /// A renderer on `gpu`.
    pub fn new(gpu: &Gpu) -> Self {
        Self { gpu: gpu.clone(), renderer: Mutex::new(None) }
    }

    /// The GPU it draws on.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Draws, and takes the gradient back if there is one; repeats with larger buffers where they were too small.
    fn run<T>(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
        v_image: Option<&Image>,
        take: impl Fn(&GpuRenderer) -> Result<T, GpuError>,
    ) -> Result<T, GpuError> {
        let mut slot = self.renderer.lock().unwrap_or_else(PoisonError::into_inner);
        let backward = v_image.is_some();
        let mut wanted = Capacity::new(gaussians.num_gaussians(), gaussians.num_channels, [camera], backward);
        if let Some(renderer) = slot.as_ref() {
            // Room found to be needed for these Gaussians stays.
            let kept = renderer.capacity();
            if kept.num_gaussians == wanted.num_gaussians {
                wanted.num_pairs = wanted.num_pairs.max(kept.num_pairs);
            }
        }
        let packed = pack(gaussians);
        loop {
            let mut renderer = match slot.take() {
                Some(renderer) if serves(renderer.capacity(), &wanted) => renderer,
                _ => GpuRenderer::new(&self.gpu, wanted)?,
            };
            let queue = self.gpu.queue();
            queue.write_buffer(&renderer.buffers().activated, 0, bytemuck::cast_slice(&packed));
            queue.write_buffer(&renderer.buffers().status, 0, &[0; 16]);
            if let Some(v_image) = v_image {
                queue.write_buffer(&renderer.buffers().v_image, 0, bytemuck::cast_slice(&v_image.data));
            }
            renderer.set_view(camera, settings);
            let mut encoder = self.gpu.encoder();
            {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                renderer.project(&mut pass);
                renderer.sort(&mut pass);
                renderer.rasterize(&mut pass);
                if backward {
                    renderer.rasterize_bwd(&mut pass);
                    renderer.project_bwd(&mut pass);
                }
            }
            self.gpu.submit(encoder);
            let [halted, needed, ..] = *self.gpu.read::<u32>(&renderer.buffers().status, 4)? else {
                unreachable!("four values were asked for")
            };
            if halted == 0 {
                let taken = take(&renderer);
                *slot = Some(renderer);
                return taken;
            }
            wanted.num_pairs = needed as usize + needed as usize / 4;
        }
    }
}

fn serves(capacity: &Capacity, wanted: &Capacity) -> bool {
    capacity.num_gaussians == wanted.num_gaussians
        && capacity.num_channels == wanted.num_channels
        && capacity.num_pixels >= wanted.num_pixels
        && capacity.num_tiles >= wanted.num_tiles
        && capacity.num_pairs >= wanted.num_pairs
        && capacity.backward >= wanted.backward
}

/// Array after array, as the shaders read them.
pub(super) fn pack(gaussians: &Activated) -> Vec<f32> {
    let n = gaussians.num_gaussians();
    let arrays: [(&str, &[f32], usize); 5] = [
        ("means", gaussians.means.as_flattened(), 3),
        ("quats", gaussians.quats.as_flattened(), 4),
        ("scales", gaussians.scales.as_flattened(), 3),
        ("opacities", &gaussians.opacities, 1),
        ("colors", &gaussians.colors, gaussians.num_channels),
    ];
    let mut packed = Vec::with_capacity((11 + gaussians.num_channels) * n);
    for (name, values, components) in arrays {
        assert_eq!(values.len(), n * components, "{name} against [{n}, {components}]");
        packed.extend_from_slice(values);
    }
    packed
}

impl Rasterizer for GpuRasterizer {
    type Saved = GpuSaved;

    fn forward(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(RenderOutput, GpuSaved), GpuError> {
        let (channels, pixels) = (gaussians.num_channels, camera.width * camera.height);
        self.run(gaussians, camera, settings, None, |renderer| {
            let mut data: Vec<f32> = self.gpu.read(&renderer.buffers().image, (channels + 1) * pixels)?;
            let transmittance = data.split_off(channels * pixels);
            let image = Image { data, ..Image::filled(camera.width, camera.height, channels, 0.0) };
            Ok((RenderOutput { image, transmittance }, GpuSaved))
        })
    }

    fn backward(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
        _: &GpuSaved,
        v_image: &Image,
    ) -> Result<RenderGrads, GpuError> {
        let (n, c) = (gaussians.num_gaussians(), gaussians.num_channels);
        let shape = [v_image.num_channels, v_image.height, v_image.width];
        assert_eq!(shape, [c, camera.height, camera.width], "v_image against the rendered image");
        self.run(gaussians, camera, settings, Some(v_image), |renderer| {
            let v: Vec<f32> = self.gpu.read(&renderer.buffers().v_activated, (11 + c) * n)?;
            let statistic: Vec<f32> = self.gpu.read(&renderer.buffers().v_means2d_ndc, 3 * n)?;
            let rows = statistic.as_chunks::<3>().0;
            Ok(RenderGrads {
                activated: ActivatedGrads {
                    v_means: v[..3 * n].as_chunks().0.to_vec(),
                    v_quats: v[3 * n..7 * n].as_chunks().0.to_vec(),
                    v_scales: v[7 * n..10 * n].as_chunks().0.to_vec(),
                    v_opacities: v[10 * n..11 * n].to_vec(),
                    v_colors: v[11 * n..].to_vec(),
                },
                v_means2d_ndc: rows.iter().map(|&[x, y, _]| [x, y]).collect(),
                visible: rows.iter().map(|row| row[2] != 0.0).collect(),
            })
        })
    }
}

impl Draw for GpuRasterizer {
    fn name(&self) -> String {
        format!("gpu, {}", self.gpu.info().name)
    }

    fn draw(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<RenderOutput, GpuError> {
        self.forward(gaussians, camera, settings).map(|(output, _)| output)
    }
}
