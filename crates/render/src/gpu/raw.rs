//! Unstable, for the crates of this workspace only: functions with a type of `wgpu` in their signature.
//!
//! Training and the player run their own shaders between the renderer's, on the same buffers. They use these functions,
//! which are outside the documented interface: a new version of `wgpu` changes them without notice.

use std::ops::Range;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

use super::device::lock;
use super::{Gpu, GpuError};

pub use super::kernel::{Bound, Kernel};
pub use super::renderer::{GpuRenderer, PartLists, RenderBuffers};
pub use super::timing::StageTimer;

#[doc(hidden)]
impl Gpu {
    /// The device of `wgpu`: bind groups, textures, pipelines.
    pub fn device(&self) -> &wgpu::Device {
        &self.0.device
    }

    /// The queue of `wgpu`: writes to buffers.
    pub fn queue(&self) -> &wgpu::Queue {
        &self.0.queue
    }

    /// Number of submissions so far. For tests of the cost of an iteration.
    pub fn num_submissions(&self) -> usize {
        self.0.submissions.load(Ordering::Relaxed)
    }

    /// Number of read-backs so far. For tests of the cost of an iteration.
    pub fn num_reads(&self) -> usize {
        self.0.reads.load(Ordering::Relaxed)
    }

    /// Number of compiled shaders so far. For tests of repeated compilation.
    pub fn num_compiled(&self) -> usize {
        self.0.compiled.load(Ordering::Relaxed)
    }

    /// A compute shader. The first request for a source and an entry point compiles it; later ones share the result.
    ///
    /// - `source`: WGSL, complete; see [`Wgsl`](crate::device::Wgsl)
    /// - `entry`: name of the compute function
    pub fn kernel(&self, source: &str, entry: &'static str) -> Kernel {
        let mut kernels = lock(&self.0.kernels);
        let key = (source.to_owned(), entry);
        if let Some(kernel) = kernels.get(&key) {
            return kernel.clone();
        }
        self.0.compiled.fetch_add(1, Ordering::Relaxed);
        let kernel = Kernel::compile(&self.0.device, source, entry);
        kernels.insert(key, kernel.clone());
        kernel
    }

    /// A storage buffer of 32-bit values, filled with zeros.
    ///
    /// - `len`: number of values; at least four are allocated, the minimum for a binding of vectors
    ///
    /// # Errors
    /// [`GpuError::Memory`] if the adapter allows no buffer of that size or has no memory for it.
    pub fn storage(&self, what: &str, len: usize) -> Result<wgpu::Buffer, GpuError> {
        self.allocate(what, len.max(4) as u64 * 4, wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::INDIRECT)
    }

    /// A uniform buffer of `bytes` bytes.
    ///
    /// - `what`: name of the buffer in errors
    ///
    /// # Errors
    /// As [`Self::storage`].
    pub fn uniform(&self, what: &str, bytes: usize) -> Result<wgpu::Buffer, GpuError> {
        self.allocate(what, bytes as u64, wgpu::BufferUsages::UNIFORM)
    }

    /// A storage buffer with `values`, of 32 bits or rows of such.
    ///
    /// # Errors
    /// As [`Self::storage`].
    pub fn upload<T: bytemuck::NoUninit>(&self, what: &str, values: &[T]) -> Result<wgpu::Buffer, GpuError> {
        let bytes: &[u8] = bytemuck::cast_slice(values);
        if bytes.len() < 16 {
            let buffer = self.storage(what, 1)?;
            let padded = [bytes, &[0; 16]].concat();
            self.0.queue.write_buffer(&buffer, 0, &padded[..16]);
            return Ok(buffer);
        }
        // `create_buffer_init` panics if memory is exhausted, so it is not used.
        let buffer = self.allocate(what, bytes.len() as u64, wgpu::BufferUsages::STORAGE)?;
        self.0.queue.write_buffer(&buffer, 0, bytes);
        Ok(buffer)
    }

    fn allocate(&self, what: &str, bytes: u64, usage: wgpu::BufferUsages) -> Result<wgpu::Buffer, GpuError> {
        self.check_size(what, bytes)?;
        let buffer = self.0.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(what),
            size: bytes,
            usage: usage | wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        self.allocated(what, bytes)?;
        Ok(buffer)
    }

    fn check_size(&self, what: &str, bytes: u64) -> Result<(), GpuError> {
        let limits = self.0.device.limits();
        let limit = limits.max_storage_buffer_binding_size.min(limits.max_buffer_size);
        if bytes > limit {
            let problem = format!("more than the {limit} that {} allows a buffer", self.info().name);
            return Err(GpuError::Memory { what: what.into(), bytes, problem });
        }
        Ok(())
    }

    /// Names the buffer in an allocation error.
    fn allocated(&self, what: &str, bytes: u64) -> Result<(), GpuError> {
        // A lost device reports so only when polled.
        self.poll()?;
        self.check().map_err(|error| match error {
            GpuError::Memory { bytes: 0, problem, .. } => GpuError::Memory { what: what.into(), bytes, problem },
            other => other,
        })
    }

    /// Starts recording commands.
    pub fn encoder(&self) -> wgpu::CommandEncoder {
        self.0.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
    }

    /// Submits recorded commands to the GPU; does not wait for them.
    pub fn submit(&self, encoder: wgpu::CommandEncoder) -> wgpu::SubmissionIndex {
        self.0.submissions.fetch_add(1, Ordering::Relaxed);
        self.0.queue.submit([encoder.finish()])
    }

    /// Records a copy of the first `len` 32-bit values of `buffer` to memory that can be mapped.
    ///
    /// # Errors
    /// As [`Self::storage`].
    pub fn stage(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        buffer: &wgpu::Buffer,
        len: usize,
    ) -> Result<Staged, GpuError> {
        self.stage_range(encoder, buffer, 0..len)
    }

    /// As [`Self::stage`], for the values in a range.
    ///
    /// # Errors
    /// As [`Self::storage`].
    pub fn stage_range(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        buffer: &wgpu::Buffer,
        range: Range<usize>,
    ) -> Result<Staged, GpuError> {
        let bytes = range.len().max(1) as u64 * 4;
        let staging = self.0.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size: bytes,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        self.allocated("memory to read back", bytes)?;
        encoder.copy_buffer_to_buffer(buffer, range.start as u64 * 4, &staging, 0, bytes);
        Ok(Staged { staging, len: range.len(), mapped: Arc::default() })
    }

    /// Reads the first `len` 32-bit values of `buffer`; waits for the GPU.
    ///
    /// # Errors
    /// An error that occurred meanwhile.
    pub fn read<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, len: usize) -> Result<Vec<T>, GpuError> {
        let mut encoder = self.encoder();
        let staged = self.stage(&mut encoder, buffer, len)?;
        self.submit(encoder);
        staged.map(self);
        self.wait()?;
        staged.take(self)
    }
}

/// A copy of a buffer's values on its way back to the host: recorded by [`Gpu::stage`], requested by [`Self::map`],
/// present once [`Self::is_ready`], taken by [`Self::take`].
#[derive(Debug)]
pub struct Staged {
    staging: wgpu::Buffer,
    len: usize,
    mapped: Arc<Mutex<Option<bool>>>,
}

impl Staged {
    /// Requests the values, after the copy was submitted; does not wait.
    pub fn map(&self, gpu: &Gpu) {
        gpu.0.reads.fetch_add(1, Ordering::Relaxed);
        let mapped = Arc::clone(&self.mapped);
        self.staging.map_async(wgpu::MapMode::Read, .., move |result| *lock(&mapped) = Some(result.is_ok()));
    }

    /// Whether the values had arrived at the last poll or wait.
    pub fn is_ready(&self) -> bool {
        lock(&self.mapped).is_some()
    }

    /// The copied values.
    ///
    /// # Errors
    /// [`GpuError::Lost`] if they never arrived.
    pub fn take<T: bytemuck::Pod>(&self, gpu: &Gpu) -> Result<Vec<T>, GpuError> {
        gpu.check()?;
        let lost = |problem: &str| GpuError::Lost(format!("its results cannot be read: {problem}"));
        if *lock(&self.mapped) != Some(true) {
            return Err(lost("not mapped"));
        }
        let view = self.staging.get_mapped_range(..).map_err(|e| lost(&e.to_string()))?;
        Ok(bytemuck::pod_collect_to_vec(&view[..self.len * 4]))
    }
}
