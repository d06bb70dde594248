//! Scenes that are read a timestep at a time.

use std::convert::Infallible;
use std::ops::Range;
use std::sync::Arc;

use crate::{DynamicGaussians, Gaussians, Layout};

/// A scene over time that is read a timestep at a time: a run, PLY files, a `.tcgs` file, or floats in memory. What
/// reads through it needs memory for some timesteps, not for all.
pub trait SceneReader {
    /// What reading fails with; [`Infallible`] for what lies in memory.
    type Error: std::error::Error + Send + Sync + 'static;

    /// Which columns its Gaussians have.
    fn layout(&self) -> &Arc<Layout>;

    /// `N`, at every timestep.
    fn num_gaussians(&self) -> usize;

    /// `T`.
    fn num_timesteps(&self) -> usize;

    /// The timesteps that come at little more cost together with `timestep`, which is one of them: a segment of a
    /// file. One alone where nothing is shared.
    fn span(&self, timestep: usize) -> Range<usize> {
        timestep..timestep + 1
    }

    /// The scene at one timestep, in stored form.
    ///
    /// # Errors
    /// If it cannot be read, or is not what the rest of the scene promised.
    ///
    /// # Panics
    /// If `timestep` is not below [`Self::num_timesteps`].
    fn at(&mut self, timestep: usize) -> Result<Gaussians, Self::Error>;
}

impl SceneReader for &DynamicGaussians {
    type Error = Infallible;

    fn layout(&self) -> &Arc<Layout> {
        DynamicGaussians::layout(self)
    }

    fn num_gaussians(&self) -> usize {
        DynamicGaussians::num_gaussians(self)
    }

    fn num_timesteps(&self) -> usize {
        DynamicGaussians::num_timesteps(self)
    }

    fn at(&mut self, timestep: usize) -> Result<Gaussians, Infallible> {
        Ok(DynamicGaussians::at(self, timestep))
    }
}
