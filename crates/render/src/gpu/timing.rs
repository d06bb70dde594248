//! Time of stages on the GPU, by its own clock.

use super::raw::Staged;
use super::{Gpu, GpuError};
use crate::StageTimes;

/// A pair of GPU timestamps around each of a few stages.
#[derive(Debug)]
pub struct StageTimer {
    queries: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    stages: &'static [&'static str],
}

impl StageTimer {
    /// A timer of the named stages; `None` if the adapter has no timestamps.
    ///
    /// # Errors
    /// As [`Gpu::storage`].
    pub fn new(gpu: &Gpu, stages: &'static [&'static str]) -> Result<Option<Self>, GpuError> {
        if !gpu.device().features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return Ok(None);
        }
        let count = 2 * stages.len() as u32;
        let queries = gpu.device().create_query_set(&wgpu::QuerySetDescriptor {
            label: Some("stages"),
            ty: wgpu::QueryType::Timestamp,
            count,
        });
        let resolved = gpu.device().create_buffer(&wgpu::BufferDescriptor {
            label: Some("stages' timestamps"),
            size: u64::from(count) * 8,
            usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
            mapped_at_creation: false,
        });
        gpu.check()?;
        Ok(Some(Self { queries, resolved, stages }))
    }

    /// Begins the compute pass of one stage.
    ///
    /// - `stage`: position among the names
    pub fn pass<'a>(&self, encoder: &'a mut wgpu::CommandEncoder, stage: usize) -> wgpu::ComputePass<'a> {
        encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: None,
            timestamp_writes: Some(wgpu::ComputePassTimestampWrites {
                query_set: &self.queries,
                beginning_of_pass_write_index: Some(2 * stage as u32),
                end_of_pass_write_index: Some(2 * stage as u32 + 1),
            }),
        })
    }

    /// Records the read-back of the times, after the last pass.
    ///
    /// # Errors
    /// As [`Gpu::storage`].
    pub fn stage(&self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder) -> Result<Staged, GpuError> {
        encoder.resolve_query_set(&self.queries, 0..2 * self.stages.len() as u32, &self.resolved, 0);
        gpu.stage(encoder, &self.resolved, 4 * self.stages.len())
    }

    /// The time of each stage in milliseconds; waits for the GPU.
    ///
    /// - `staged`: as [`Self::stage`] returned it, submitted
    ///
    /// # Errors
    /// An error that occurred meanwhile.
    pub fn read(&self, gpu: &Gpu, staged: &Staged) -> Result<StageTimes, GpuError> {
        staged.map(gpu);
        gpu.wait()?;
        let words: Vec<u32> = staged.take(gpu)?;
        let ticks: Vec<u64> =
            words.as_chunks::<2>().0.iter().map(|w| u64::from(w[1]) << 32 | u64::from(w[0])).collect();
        let ms = |ticks: u64| ticks as f64 * f64::from(gpu.queue().get_timestamp_period()) * 1e-6;
        let stages = self.stages.iter().zip(ticks.as_chunks::<2>().0);
        Ok(StageTimes {
            stages: stages.map(|(&name, [begin, end])| (name, ms(end.saturating_sub(*begin)))).collect(),
            total: ms(ticks[ticks.len() - 1].saturating_sub(ticks[0])),
        })
    }
}
