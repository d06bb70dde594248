//! Unstable, for the crates of this workspace only: what has a type of `wgpu` in its signature.
//!
//! Training and the player run shaders of their own between the renderer's, on the same buffers. What they need for
//! that is here, outside of the documented interface: a new version of `wgpu` changes it without notice.

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

    /// How often work was submitted so far. For tests of what an iteration costs.
    pub fn num_submissions(&self) -> usize {
        self.0.submissions.load(Ordering::Relaxed)
    }

    /// How often results were read back so far. For tests of what an iteration costs.
    pub fn num_reads(&self) -> usize {
        self.0.reads.load(Ordering::Relaxed)
    }

    /// How many shaders were compiled so far. For tests of what is compiled twice.
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
    /// - `len`: values; at least four are allocated, as much as a binding of vectors asks for
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

    /// A storage buffer that holds `values`, of 32 bits or rows of such.
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
        // Not create_buffer_init, which panics where there is no memory.
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

    /// Names the buffer in an error of its allocation.
    fn allocated(&self, what: &str, bytes: u64) -> Result<(), GpuError> {
        // A device that was lost says so only when asked.
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

    /// Hands recorded commands to the GPU; does not wait for them.
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
        let bytes = len.max(1) as u64 * 4;
        let staging = self.0.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size: bytes,
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        self.allocated("memory to read back", bytes)?;
        encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, bytes);
        Ok(Staged { staging, len, mapped: Arc::default() })
    }

    /// Reads the first `len` 32-bit values of `buffer`; waits for the GPU.
    ///
    /// # Errors
    /// What has gone wrong meanwhile.
    pub fn read<T: bytemuck::Pod>(&self, buffer: &wgpu::Buffer, len: usize) -> Result<Vec<T>, GpuError> {
        let mut encoder = self.encoder();
        let staged = self.stage(&mut encoder, buffer, len)?;
        self.submit(encoder);
        staged.map(self);
        self.wait()?;
        staged.take(self)
    }
}

/// A copy of values of a buffer on its way back to the host: recorded by [`Gpu::stage`], asked for by [`Self::map`],
/// there once [`Self::is_ready`], taken by [`Self::take`].
#[derive(Debug)]
pub struct Staged {
    staging: wgpu::Buffer,
    len: usize,
    mapped: Arc<Mutex<Option<bool>>>,
}

impl Staged {
    /// Asks for the values, after the work that copies them was submitted; does not wait.
    pub fn map(&self, gpu: &Gpu) {
        gpu.0.reads.fetch_add(1, Ordering::Relaxed);
        let mapped = Arc::clone(&self.mapped);
        self.staging.map_async(wgpu::MapMode::Read, .., move |result| *lock(&mapped) = Some(result.is_ok()));
    }

    /// Whether the values have arrived, as of the last poll or wait.
    pub fn is_ready(&self) -> bool {
        lock(&self.mapped).is_some()
    }

    /// The values that were copied.
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
