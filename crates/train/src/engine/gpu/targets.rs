//! The images of a timestep, 8 bits a channel, on the GPU.

use tcgs_core::Camera;
use tcgs_render::gpu::{Gpu, GpuError};

use crate::engine::Target;

/// All images of a timestep.
#[derive(Debug)]
pub(super) struct Targets {
    pub buffer: wgpu::Buffer,
    /// Position of each image's first value.
    pub offsets: Vec<u32>,
    pub cameras: Vec<Camera>,
    pub segmented: bool,
    len: usize,
}

impl Targets {
    /// Copies the images to the GPU.
    ///
    /// - `before`: of the timestep before, whose memory is used again if it is large enough
    pub fn new(gpu: &Gpu, targets: &[Target], before: Option<Self>) -> Result<Self, GpuError> {
        let segmented = targets.iter().all(|target| target.image.num_channels == 5);
        let mut packed: Vec<u32> = Vec::new();
        let mut offsets = Vec::with_capacity(targets.len());
        for Target { image, .. } in targets {
            offsets.push(packed.len() as u32);
            let plane = |c: usize| if c < image.num_channels { image.plane(c) } else { &[] };
            let [r, g, b, foreground] = [0, 1, 2, 3].map(plane);
            packed.extend((0..image.num_pixels()).map(|i| {
                let foreground = foreground.get(i).copied().unwrap_or(0.0);
                u32::from_le_bytes([r[i], g[i], b[i], foreground].map(|v| (v * 255.0).round() as u8))
            }));
        }
        let (buffer, len) = match before {
            Some(before) if before.len >= packed.len() => (before.buffer, before.len),
            _ => (gpu.storage("images", packed.len())?, packed.len()),
        };
        gpu.queue().write_buffer(&buffer, 0, bytemuck::cast_slice(&packed));
        let cameras = targets.iter().map(|target| target.camera.clone()).collect();
        Ok(Self { buffer, offsets, cameras, segmented, len })
    }

    /// Channels of the images as they are compared.
    pub fn num_channels(&self) -> usize {
        if self.segmented { 5 } else { 3 }
    }

    /// What kernels are bound to: equal shapes can share them.
    pub fn shape(&self) -> (wgpu::Buffer, usize, Vec<Camera>) {
        (self.buffer.clone(), self.num_channels(), self.cameras.clone())
    }

    /// Rows and columns that hold every image.
    pub fn max_size(&self) -> [usize; 2] {
        let max = |side: fn(&Camera) -> usize| self.cameras.iter().map(side).max().unwrap_or(1);
        [max(|camera| camera.height), max(|camera| camera.width)]
    }
}
