//! The GPU renderer behind the common contract: arrays in, arrays out.

use std::ops::Range;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use tcgs_core::{Activated, ActivatedGrads, Camera, Image};

use super::raw::{GpuRenderer, RenderBuffers, StageTimer};
use super::{Gpu, GpuError};
use crate::device::{Capacity, pack};
use crate::{Draw, Rasterizer, RenderGrads, RenderOutput, RenderSettings};

/// The renderer on a GPU behind [`Rasterizer`] and [`Draw`]: arrays in, arrays out. Buffers, and the Gaussians of
/// [`Draw::draw`], stay on the GPU between images.
#[derive(Debug)]
pub struct GpuRasterizer {
    gpu: Gpu,
    kept: Mutex<Kept>,
}

/// State kept between images.
#[derive(Debug, Default)]
struct Kept {
    renderer: Option<GpuRenderer>,
    /// The Gaussians in the renderer's buffers, if the next drawing may find them unchanged.
    loaded: Option<Arc<Activated>>,
}

/// A request for one image.
struct Job<'a> {
    gaussians: &'a Activated,
    camera: &'a Camera,
    settings: &'a RenderSettings,
    v_image: Option<&'a Image>,
}

/// State that the GPU's forward saves for its backward: nothing, because its buffers serve the next image too. Backward
/// draws again; training does not use it.
#[derive(Clone, Copy, Debug)]
pub struct GpuSaved;

impl GpuRasterizer {
    /// A renderer on `gpu`.
    pub fn new(gpu: &Gpu) -> Self {
        Self { gpu: gpu.clone(), kept: Mutex::default() }
    }

    /// The GPU it draws on.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Draws, and computes gradients if `v_image` is given. Repeats with larger buffers if they were too small.
    ///
    /// - `shared`: the job's Gaussians, if they will not change until drawn again
    /// - `wanted`: buffers to read, and the range of values of each
    /// - returns: their values, and the milliseconds on the GPU
    fn run<const K: usize>(
        &self,
        job: &Job<'_>,
        shared: Option<&Arc<Activated>>,
        wanted: impl Fn(&RenderBuffers) -> [(&wgpu::Buffer, Range<usize>); K],
    ) -> Result<([Vec<f32>; K], f64), GpuError> {
        let Job { gaussians, camera, settings, v_image } = *job;
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        let backward = v_image.is_some();
        let mut capacity = Capacity::new(gaussians.num_gaussians(), gaussians.num_channels, [camera], backward);
        if let Some(renderer) = &kept.renderer {
            // Capacity that earlier images of these Gaussians needed is kept.
            let before = renderer.capacity();
            if before.num_gaussians == capacity.num_gaussians {
                capacity.num_pairs = capacity.num_pairs.max(before.num_pairs);
            }
        }
        let timer = StageTimer::new(&self.gpu, &["draw"])?;
        loop {
            let mut renderer = match kept.renderer.take() {
                Some(renderer) if renderer.capacity().serves(&capacity) => renderer,
                _ => {
                    kept.loaded = None;
                    GpuRenderer::new(&self.gpu, capacity)?
                }
            };
            let queue = self.gpu.queue();
            let is_loaded =
                shared.is_some_and(|shared| kept.loaded.as_ref().is_some_and(|loaded| Arc::ptr_eq(loaded, shared)));
            if !is_loaded {
                queue.write_buffer(&renderer.buffers().activated, 0, bytemuck::cast_slice(&pack(gaussians)));
                kept.loaded = shared.cloned();
            }
            queue.write_buffer(&renderer.buffers().status, 0, &[0; 16]);
            if let Some(v_image) = v_image {
                queue.write_buffer(&renderer.buffers().v_image, 0, bytemuck::cast_slice(&v_image.data));
            }
            let settings = settings.clone().or_background(&gaussians.background);
            renderer.set_view(camera, &settings, gaussians.is_antialiased);
            let mut encoder = self.gpu.encoder();
            let begin = Instant::now();
            {
                let mut pass = match &timer {
                    Some(timer) => timer.pass(&mut encoder, 0),
                    None => encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()),
                };
                renderer.project(&mut pass);
                renderer.sort(&mut pass);
                renderer.rasterize(&mut pass);
                if backward {
                    renderer.rasterize_bwd(&mut pass);
                    renderer.project_bwd(&mut pass);
                }
            }
            let times = timer.as_ref().map(|timer| timer.stage(&self.gpu, &mut encoder)).transpose()?;
            let status = self.gpu.stage(&mut encoder, &renderer.buffers().status, 2)?;
            let mut staged = Vec::with_capacity(K);
            for (buffer, range) in wanted(renderer.buffers()) {
                staged.push(self.gpu.stage_range(&mut encoder, buffer, range)?);
            }
            self.gpu.submit(encoder);
            staged.iter().chain([&status]).for_each(|staged| staged.map(&self.gpu));
            let ms = match (&timer, &times) {
                (Some(timer), Some(times)) => timer.read(&self.gpu, times)?.total,
                _ => {
                    self.gpu.wait()?;
                    begin.elapsed().as_secs_f64() * 1e3
                }
            };
            let status: Vec<u32> = status.take(&self.gpu)?;
            if status[0] == 0 {
                kept.renderer = Some(renderer);
                let mut arrays = std::array::from_fn(|_| Vec::new());
                for (array, staged) in arrays.iter_mut().zip(staged) {
                    *array = staged.take(&self.gpu)?;
                }
                return Ok((arrays, ms));
            }
            capacity.num_pairs = status[1] as usize + status[1] as usize / 4;
        }
    }

    /// A picture, and the blending weight of every Gaussian summed over its pixels: as
    /// [`CpuTiles::weights`](crate::CpuTiles::weights), of one drawing.
    ///
    /// - `gaussians`: of `C` channels; shared as for [`Draw::draw`]
    /// - `shares`: `[C, H, W]` of the camera's size, each pixel's weight in each of `C` sums
    /// - returns: `[C, H, W]`; and `[N, C]`, pixels
    ///
    /// # Errors
    /// [`GpuError`] if the GPU fails, or lacks the memory.
    ///
    /// # Panics
    /// If `shares` is of another size.
    pub fn picture_and_weights(
        &self,
        gaussians: &Arc<Activated>,
        camera: &Camera,
        shares: &Image,
    ) -> Result<(Image, Vec<f32>), GpuError> {
        let (n, c) = (gaussians.num_gaussians(), gaussians.num_channels);
        assert_eq!(shares.shape(), [c, camera.height, camera.width], "shares of all pixels");
        let settings = &RenderSettings { statistic_channels: 0, ..RenderSettings::default() };
        let job = Job { gaussians, camera, settings, v_image: Some(shares) };
        let pixels = camera.width * camera.height;
        // A gradient to a colour is a blending weight.
        let ([data, weights], _) = self.run(&job, Some(gaussians), |buffers| {
            [(&buffers.image, 0..c * pixels), (&buffers.v_activated, 11 * n..(11 + c) * n)]
        })?;
        Ok((Image { data, ..Image::filled(camera.width, camera.height, c, 0.0) }, weights))
    }

    fn image(&self, job: &Job<'_>, shared: Option<&Arc<Activated>>) -> Result<(RenderOutput, f64), GpuError> {
        let (channels, camera) = (job.gaussians.num_channels, job.camera);
        let pixels = camera.width * camera.height;
        let ([mut data], ms) = self.run(job, shared, |buffers| [(&buffers.image, 0..(channels + 1) * pixels)])?;
        let transmittance = data.split_off(channels * pixels);
        let image = Image { data, ..Image::filled(camera.width, camera.height, channels, 0.0) };
        Ok((RenderOutput { image, transmittance }, ms))
    }
}

impl Rasterizer for GpuRasterizer {
    type Saved = GpuSaved;
    type Error = GpuError;

    fn forward(
        &self,
        gaussians: &Activated,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(RenderOutput, GpuSaved), GpuError> {
        Ok((self.image(&Job { gaussians, camera, settings, v_image: None }, None)?.0, GpuSaved))
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
        assert_eq!(v_image.shape(), [c, camera.height, camera.width], "v_image against the rendered image");
        let job = Job { gaussians, camera, settings, v_image: Some(v_image) };
        let ([v, statistic], _) = self
            .run(&job, None, |buffers| [(&buffers.v_activated, 0..(11 + c) * n), (&buffers.v_means2d_ndc, 0..3 * n)])?;
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
    }
}

impl Draw for GpuRasterizer {
    type Error = GpuError;

    fn name(&self) -> String {
        format!("gpu, {}", self.gpu.info().name)
    }

    fn draw(
        &self,
        gaussians: &Arc<Activated>,
        camera: &Camera,
        settings: &RenderSettings,
    ) -> Result<(RenderOutput, f64), GpuError> {
        self.image(&Job { gaussians, camera, settings, v_image: None }, Some(gaussians))
    }
}
