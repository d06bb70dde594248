//! Scenes that are read one timestep at a time.

use std::convert::Infallible;
use std::ops::Range;
use std::sync::Arc;

use crate::{DynamicGaussians, Gaussians, Layout};

/// A scene over time that is read one timestep at a time: a run, one file per timestep, a `.tcgs` file, or floats in
/// memory. A user of this trait needs memory for some timesteps, not for all.
pub trait SceneReader {
    /// The error of reading; [`Infallible`] for a scene in memory.
    type Error: std::error::Error + Send + Sync + 'static;

    /// The columns of its Gaussians.
    fn layout(&self) -> &Arc<Layout>;

    /// `N`: at every timestep, or where [`Self::num_gaussians_at`] says otherwise the most at any.
    fn num_gaussians(&self) -> usize;

    /// `T`.
    fn num_timesteps(&self) -> usize;

    /// Number of Gaussians at one timestep.
    ///
    /// # Panics
    /// If `timestep` is not below [`Self::num_timesteps`], where the number changes.
    fn num_gaussians_at(&self, timestep: usize) -> usize {
        let _ = timestep;
        self.num_gaussians()
    }

    /// Whether all timesteps have the same number of Gaussians. If they do not, the Gaussians of different timesteps
    /// have no known correspondence.
    fn has_constant_number(&self) -> bool {
        (0..self.num_timesteps()).all(|timestep| self.num_gaussians_at(timestep) == self.num_gaussians())
    }

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

#[cfg(test)]
mod tests {
    use super::*;

    /// As many Gaussians at each timestep as the numbers say.
    struct Changing(Vec<usize>, Arc<Layout>);

    impl SceneReader for Changing {
        type Error = Infallible;

        fn layout(&self) -> &Arc<Layout> {
            &self.1
        }

        fn num_gaussians(&self) -> usize {
            self.0.iter().copied().max().unwrap_or(0)
        }

        fn num_gaussians_at(&self, timestep: usize) -> usize {
            self.0[timestep]
        }

        fn num_timesteps(&self) -> usize {
            self.0.len()
        }

        fn at(&mut self, timestep: usize) -> Result<Gaussians, Infallible> {
            Ok(Gaussians::zeros_of(&self.1, self.0[timestep]))
        }
    }

    #[test]
    fn a_number_is_constant_if_all_timesteps_have_it() {
        let changing = |numbers: &[usize]| Changing(numbers.to_vec(), Layout::base());
        assert!(changing(&[3, 3]).has_constant_number() && changing(&[]).has_constant_number());
        assert!(!changing(&[3, 2]).has_constant_number() && !changing(&[2, 3, 3]).has_constant_number());
        let mut scene = DynamicGaussians::default();
        scene.push(Gaussians::zeros(4));
        assert_eq!(((&scene).num_gaussians_at(0), (&scene).has_constant_number()), (4, true));
    }
}
