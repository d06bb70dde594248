//! Draws the same Gaussians repeatedly and measures the time.

use std::time::Instant;

use tcgs_core::{Activated, Camera, Image};

use super::raw::{GpuRenderer, StageTimer};
use super::{Gpu, GpuError};
use crate::device::{Capacity, pack};
use crate::{PairCounts, RENDER_STAGES, RenderSettings, StageTimes};

/// Number of [`RENDER_STAGES`] that draw; the others compute gradients.
const FORWARD_STAGES: usize = 3;

/// Draws Gaussians that stay on the GPU, stage by stage.
#[derive(Debug)]
pub struct RenderProfiler {
    gpu: Gpu,
    renderer: GpuRenderer,
    packed: Vec<f32>,
    is_antialiased: bool,
    timer: Option<StageTimer>,
    backward: bool,
}

impl RenderProfiler {
    /// Copies the Gaussians to the GPU.
    ///
    /// - `cameras`: all cameras that [`Self::sample`] will be called with
    /// - `backward`: whether gradients are computed too, from a gradient of 1 at every value of the image. Otherwise
    ///   forward saves nothing for backward.
    ///
    /// # Errors
    /// [`GpuError`] if the GPU lacks the memory, or fails.
    ///
    /// # Panics
    /// As [`crate::Rasterizer::forward`].
    pub fn new(gpu: &Gpu, gaussians: &Activated, cameras: &[Camera], backward: bool) -> Result<Self, GpuError> {
        let capacity = Capacity::new(gaussians.num_gaussians(), gaussians.num_channels, cameras, backward);
        let packed = pack(gaussians);
        let stages = if backward { &RENDER_STAGES } else { &RENDER_STAGES[..FORWARD_STAGES] };
        Ok(Self {
            renderer: renderer(gpu, capacity, &packed)?,
            timer: StageTimer::new(gpu, stages)?,
            gpu: gpu.clone(),
            packed,
            is_antialiased: gaussians.is_antialiased,
            backward,
        })
    }

    /// Draws once. On a GPU without timestamps there is one stage, `render`, timed by the CPU's clock.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn sample(&mut self, camera: &Camera) -> Result<StageTimes, GpuError> {
        loop {
            let times = self.attempt(camera)?;
            let status = self.gpu.read::<u32>(&self.renderer.buffers().status, 2)?;
            if status[0] == 0 {
                return Ok(times);
            }
            // The buffers were too small, so most of it was skipped; the next attempt has larger ones.
            let needed = status[1] as usize;
            let capacity = Capacity { num_pairs: needed + needed / 4, ..*self.renderer.capacity() };
            self.renderer = renderer(&self.gpu, capacity, &self.packed)?;
        }
    }

    fn attempt(&mut self, camera: &Camera) -> Result<StageTimes, GpuError> {
        self.renderer.set_view(camera, &RenderSettings::default(), self.is_antialiased);
        let renderer = &self.renderer;
        let stages: [fn(&GpuRenderer, &mut wgpu::ComputePass<'_>); RENDER_STAGES.len()] = [
            GpuRenderer::project,
            GpuRenderer::sort,
            GpuRenderer::rasterize,
            GpuRenderer::rasterize_bwd,
            GpuRenderer::project_bwd,
        ];
        let stages = if self.backward { &stages[..] } else { &stages[..FORWARD_STAGES] };
        let mut encoder = self.gpu.encoder();
        if let Some(timer) = &self.timer {
            for (number, stage) in stages.iter().enumerate() {
                stage(renderer, &mut timer.pass(&mut encoder, number));
            }
            let staged = timer.stage(&self.gpu, &mut encoder)?;
            self.gpu.submit(encoder);
            return timer.read(&self.gpu, &staged);
        }
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            stages.iter().for_each(|stage| stage(renderer, &mut pass));
        }
        let begin = Instant::now();
        self.gpu.submit(encoder);
        self.gpu.wait()?;
        let total = begin.elapsed().as_secs_f64() * 1e3;
        Ok(StageTimes { stages: vec![("render", total)], total })
    }

    /// Numbers of pairs and splats in the last sample.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn counts(&self) -> Result<PairCounts, GpuError> {
        self.renderer.read_counts()
    }
}

fn renderer(gpu: &Gpu, capacity: Capacity, packed: &[f32]) -> Result<GpuRenderer, GpuError> {
    let renderer = GpuRenderer::new(gpu, capacity)?;
    gpu.queue().write_buffer(&renderer.buffers().activated, 0, bytemuck::cast_slice(packed));
    if capacity.backward {
        let ones = Image::filled(capacity.num_pixels, 1, capacity.num_channels, 1.0);
        gpu.queue().write_buffer(&renderer.buffers().v_image, 0, bytemuck::cast_slice(&ones.data));
    }
    Ok(renderer)
}
