//! The images of a timestep, 8 bits a channel, on the GPU.

use rayon::prelude::*;
use tcgs_core::Camera;
use tcgs_render::gpu::{Gpu, GpuError};

use crate::engine::Target;
use crate::engine::device::target_word;

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
    /// - `before`: images of the timestep before; their memory is reused if it is large enough
    pub fn new(gpu: &Gpu, targets: &[Target], before: Option<Self>) -> Result<Self, GpuError> {
        let mut packed: Vec<u32> = Vec::new();
        let mut offsets = Vec::with_capacity(targets.len());
        for Target { image, .. } in targets {
            offsets.push(packed.len() as u32);
            packed.par_extend((0..image.num_pixels()).into_par_iter().map(|pixel| target_word(image, pixel)));
        }
        Self::of_words(gpu, targets, &packed, offsets, before)
    }

    /// Copies pixels of the images to the GPU.
    ///
    /// - `packed`: words of all images
    /// - `offsets`: position of each image's first word
    /// - `before`: as in [`Self::new`]
    pub fn of_words(
        gpu: &Gpu,
        targets: &[Target],
        packed: &[u32],
        offsets: Vec<u32>,
        before: Option<Self>,
    ) -> Result<Self, GpuError> {
        let segmented = targets.iter().all(|target| target.image.num_channels == 5);
        let (buffer, len) = match before {
            Some(before) if before.len >= packed.len() => (before.buffer, before.len),
            _ => (gpu.storage("images", packed.len())?, packed.len()),
        };
        gpu.queue().write_buffer(&buffer, 0, bytemuck::cast_slice(packed));
        let cameras = targets.iter().map(|target| target.camera.clone()).collect();
        Ok(Self { buffer, offsets, cameras, segmented, len })
    }

    /// Number of compared channels of the images.
    pub fn num_channels(&self) -> usize {
        if self.segmented { 5 } else { 3 }
    }

    /// Buffers and cameras that kernels are bound to; targets of equal shape share kernels.
    pub fn shape(&self) -> (wgpu::Buffer, usize, Vec<Camera>) {
        (self.buffer.clone(), self.num_channels(), self.cameras.clone())
    }

    /// Rows and columns that hold every image.
    pub fn max_size(&self) -> [usize; 2] {
        let max = |side: fn(&Camera) -> usize| self.cameras.iter().map(side).max().unwrap_or(1);
        [max(|camera| camera.height), max(|camera| camera.width)]
    }
}
