//! Reconstructs any timestep on the GPU. The keypoints of a segment are uploaded once; a frame uploads only the index
//! of its timestep and the position of its camera.
//!
//! The steps are those of [`tcgs_codec::Sampler`] on the CPU: codes are dequantised, values between two keypoints are
//! interpolated linearly, and rotations are normalised. Then follow [`tcgs_core::activate`] and, with spherical
//! harmonics, the colours that the camera sees ([`tcgs_core::Drawable`]). The arithmetic is f32 throughout, where the
//! codec dequantises in f64, so values differ in their last bits.
//!
//! - `mod`: the cohorts on the GPU, and their rows among the activated Gaussians
//! - `cohort`: one of them; `kernels`: their WGSL

mod cohort;
mod kernels;

use std::ops::Range;

use tcgs_codec::Segment;
use tcgs_render::device::activated_len;
use tcgs_render::gpu::{Gpu, GpuError};

use crate::holdings::Moment;
use cohort::CohortOnGpu;
pub(crate) use kernels::sources;

/// The cohorts that live at a timestep on the GPU, each with the keypoints of one of its segments.
#[derive(Debug)]
pub struct Reconstruction {
    gpu: Gpu,
    /// Capacity of the arrays below, Gaussians.
    num_rows: usize,
    /// `[14 num_rows]` activated Gaussians in the order that the renderer reads. Unused rows have opacity 0.
    activated: wgpu::Buffer,
    cohorts: Vec<CohortOnGpu>,
}

impl Reconstruction {
    /// Nothing to reconstruct.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if nothing at all fits.
    pub fn new(gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            gpu: gpu.clone(),
            num_rows: 0,
            activated: gpu.storage("activated Gaussians", 1)?,
            cohorts: Vec::new(),
        })
    }

    /// Number of Gaussians in [`Self::activated`], including invisible ones.
    pub fn num_rows(&self) -> usize {
        self.num_rows
    }

    /// Activated Gaussians of the timestep that [`Self::record`] reconstructs, as the renderer reads them.
    /// [`Self::load`] creates a new buffer when it needs more rows.
    pub fn activated(&self) -> &wgpu::Buffer {
        &self.activated
    }

    /// Sets the timestep and the camera position for all passes submitted afterwards. Uploads the cohorts and segments
    /// that are missing on the GPU, and frees those that the timestep does not need.
    ///
    /// - `eye`: position of the camera in the world, scene units
    ///
    /// # Errors
    /// [`GpuError::Memory`] if they do not fit.
    pub fn load(&mut self, moment: &Moment, eye: [f64; 3]) -> Result<(), GpuError> {
        let (stay, gone): (Vec<_>, Vec<_>) = std::mem::take(&mut self.cohorts)
            .into_iter()
            .partition(|cohort| moment.segments.iter().any(|segment| cohort.is_of(segment)));
        self.cohorts = stay;
        gone.iter().for_each(|cohort| self.hide(cohort.rows()));
        drop(gone);
        for segment in &moment.segments {
            if !self.cohorts.iter().any(|cohort| cohort.is_of(segment)) && !self.place(segment)? {
                self.place_all(moment)?;
                break;
            }
        }
        for segment in &moment.segments {
            if let Some(cohort) = self.cohorts.iter_mut().find(|cohort| cohort.is_of(segment)) {
                cohort.load(&self.gpu, segment, &self.activated, self.num_rows)?;
                cohort.set_frame(&self.gpu, moment.timestep, eye);
            }
        }
        Ok(())
    }

    /// Records the dispatches that write the chosen timestep to [`Self::activated`].
    pub fn record(&self, pass: &mut wgpu::ComputePass<'_>) {
        self.cohorts.iter().for_each(|cohort| cohort.record(pass));
    }

    /// Uploads a cohort to the first gap that is long enough; returns whether there is one.
    fn place(&mut self, segment: &Segment) -> Result<bool, GpuError> {
        let mut start = 0;
        let mut index = 0;
        for cohort in &self.cohorts {
            if cohort.rows().start - start >= segment.num_gaussians() {
                break;
            }
            start = cohort.rows().end;
            index += 1;
        }
        if start + segment.num_gaussians() > self.cohorts.get(index).map_or(self.num_rows, |next| next.rows().start) {
            return Ok(false);
        }
        let cohort = CohortOnGpu::new(&self.gpu, segment, start, &self.activated, self.num_rows)?;
        self.cohorts.insert(index, cohort);
        Ok(true)
    }

    /// Uploads all cohorts again, one after the other, to a larger buffer if the present one is too small.
    fn place_all(&mut self, moment: &Moment) -> Result<(), GpuError> {
        self.hide(0..self.num_rows);
        self.cohorts.clear();
        let needed: usize = moment.segments.iter().map(|segment| segment.num_gaussians()).sum();
        if needed > self.num_rows {
            // With a changing number of Gaussians, a new maximum should not always need new buffers.
            let is_only = moment.segments.iter().all(|segment| segment.cohort() == 0);
            let spare = if is_only { 0 } else { needed / 8 };
            self.num_rows = 0;
            // The old buffer is freed first, because there may not be room for both.
            self.activated = self.gpu.storage("activated Gaussians", 1)?;
            self.activated = self.gpu.storage("activated Gaussians", activated_len(needed + spare, 3))?;
            self.num_rows = needed + spare;
        }
        for segment in &moment.segments {
            self.place(segment)?;
        }
        Ok(())
    }

    /// Sets the opacity of some rows to 0, so that they are not drawn.
    fn hide(&self, rows: Range<usize>) {
        if !rows.is_empty() {
            let at = cohort::value_at(tcgs_core::Attribute::LogitOpacity, rows.start, self.num_rows);
            self.gpu.queue().write_buffer(&self.activated, 4 * u64::from(at), &vec![0; 4 * rows.len()]);
        }
    }
}
