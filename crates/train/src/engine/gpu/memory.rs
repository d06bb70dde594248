//! Contents of the GPU's memory, and the parts that must be rebuilt when one of them no longer fits.

use std::sync::Arc;

use tcgs_render::device::Capacity;
use tcgs_render::gpu::{Gpu, GpuError};

use super::motion_prior::{MotionPriorKernels, PriorBuffers, prior_rows};
use super::parts::Parts;
use super::passes::Passes;
use super::state_buffers::StateBuffers;
use super::targets::Targets;
use crate::neighbors::Neighbors;
use crate::state::State;

/// The losses on motion, with the neighbours that they were made for.
#[derive(Debug)]
pub(super) struct Motion {
    neighbors: Arc<Neighbors<f32>>,
    /// The losses' kernels.
    pub kernels: MotionPriorKernels,
    partials: wgpu::Buffer,
}

/// A state in the GPU's memory.
#[derive(Debug)]
pub(super) struct Loaded {
    /// The state, and gradients.
    pub model: StateBuffers,
    /// From the second timestep on.
    pub motion: Option<Motion>,
}

/// Contents of the GPU's memory. Each state holds everything that the previous one does.
#[derive(Debug, Default)]
pub(super) enum Memory {
    /// Nothing.
    #[default]
    Empty,
    /// A state without kernels: images or room for pairs are about to change.
    Loaded(Loaded),
    /// A state, and the kernels of an iteration, bound to the state, to the images and to room for pairs.
    Ready(Loaded, Box<Passes>),
}

impl Memory {
    /// Brings `state` to the GPU: into the memory that there is, if it fits, else into new memory without kernels.
    ///
    /// # Errors
    /// [`GpuError::Memory`] if it does not fit; the memory is then empty.
    pub fn upload(&mut self, gpu: &Gpu, state: &State) -> Result<(), GpuError> {
        let (loaded, passes) = match std::mem::take(self) {
            Self::Loaded(loaded) if loaded.model.fits(state) => (Some(loaded), None),
            Self::Ready(loaded, passes) if loaded.model.fits(state) => (Some(loaded), Some(passes)),
            // The old memory is given back before new is asked for.
            _ => (None, None),
        };
        let mut loaded = match loaded {
            Some(loaded) => loaded,
            None => Loaded { model: StateBuffers::new(gpu, state)?, motion: None },
        };
        let has_new_motion = loaded.upload_past(gpu, state)?;
        loaded.model.write(gpu, state);
        *self = match passes {
            Some(passes) if !has_new_motion => Self::Ready(loaded, passes),
            _ => Self::Loaded(loaded),
        };
        Ok(())
    }

    /// Binds the kernels of an iteration, unless they are bound.
    ///
    /// - `parts`: the part that is drawn; none if everything is
    /// - `num_pairs`: room for pairs of tiles and splats; 0 leaves it to a guess
    ///
    /// # Errors
    /// [`GpuError::Memory`] if an iteration's buffers do not fit; the state stays.
    ///
    /// # Panics
    /// If no state was uploaded.
    pub fn bind(
        &mut self,
        gpu: &Gpu,
        targets: &Targets,
        parts: Option<&Parts>,
        num_pairs: usize,
    ) -> Result<(), GpuError> {
        if let Self::Ready(..) = self {
            return Ok(());
        }
        let loaded = self.loaded();
        let mut capacity = Capacity::new(loaded.model.num_gaussians, targets.num_channels(), &targets.cameras, true);
        if let Some(parts) = parts {
            capacity = parts.capacity(capacity);
        }
        if num_pairs > 0 {
            capacity.num_pairs = num_pairs;
        }
        // Without losses on motion their sums are not read, but something must be bound.
        let partials = loaded.motion.as_ref().map_or(&loaded.model.flags, |motion| &motion.partials);
        let passes = Box::new(Passes::new(gpu, &loaded.model, targets, parts, capacity, partials)?);
        if let Self::Loaded(loaded) = std::mem::take(self) {
            *self = Self::Ready(loaded, passes);
        }
        Ok(())
    }

    /// Gives the kernels of an iteration and their buffers back; the state stays.
    pub fn unbind(&mut self) {
        *self = match std::mem::take(self) {
            Self::Ready(loaded, _) => Self::Loaded(loaded),
            other => other,
        };
    }

    /// The state.
    ///
    /// # Panics
    /// If none was uploaded.
    pub fn loaded(&self) -> &Loaded {
        match self {
            Self::Loaded(loaded) | Self::Ready(loaded, _) => loaded,
            Self::Empty => unreachable!("a state is uploaded before anything is computed with it"),
        }
    }

    /// The state and the kernels of an iteration.
    ///
    /// # Panics
    /// If none are bound.
    pub fn ready(&mut self) -> (&Loaded, &mut Passes) {
        match self {
            Self::Ready(loaded, passes) => (loaded, passes),
            Self::Loaded(_) | Self::Empty => unreachable!("kernels are bound before an iteration"),
        }
    }
}

impl Loaded {
    /// Tells the losses on motion what to compare with, and makes them if they are not there yet.
    ///
    /// - returns: whether they were made
    fn upload_past(&mut self, gpu: &Gpu, state: &State) -> Result<bool, GpuError> {
        let Some(past) = &state.past else { return Ok(false) };
        let fits = |motion: &Motion| Arc::ptr_eq(&motion.neighbors, &past.neighbors);
        let has_new_motion = !self.motion.as_ref().is_some_and(fits);
        if has_new_motion {
            self.motion = None;
            let model = &self.model;
            let rows = prior_rows(model.num_gaussians, past.neighbors.foreground.len());
            let partials = gpu.storage("sums of the losses on motion", 8 * rows)?;
            let buffers =
                PriorBuffers { params: &model.params, grads: &model.grads, step: &model.step, partials: &partials };
            let (neighbors, first) = (Arc::clone(&past.neighbors), &past.first);
            let kernels =
                MotionPriorKernels::new(gpu, &model.packing, &neighbors, &first.means, &first.quats, &buffers)?;
            self.motion = Some(Motion { neighbors, kernels, partials });
        }
        if let Some(motion) = &self.motion {
            motion.kernels.begin(gpu, &past.previous, &past.stillness)?;
        }
        Ok(has_new_motion)
    }
}
