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

    /// `T`.
    fn num_timesteps(&self) -> usize;

    /// Number of Gaussians at one timestep. A `.tcgs` file gives an upper bound if Gaussians are born or die in it.
    ///
    /// # Panics
    /// If `timestep` is not below [`Self::num_timesteps`], where the number changes.
    fn num_gaussians_at(&self, timestep: usize) -> usize;

    /// Number of identities: of all Gaussians that live at some timestep. None if it is unknown which Gaussian of one
    /// timestep is which of another.
    ///
    /// A reader without own lives takes rows for identities if all timesteps have the same number of Gaussians.
    fn num_identities(&self) -> Option<usize> {
        let mut counts = (0..self.num_timesteps()).map(|timestep| self.num_gaussians_at(timestep));
        let first = counts.next().unwrap_or(0);
        counts.all(|count| count == first).then_some(first)
    }

    /// The largest number of Gaussians at any timestep.
    fn max_gaussians(&self) -> usize {
        (0..self.num_timesteps()).map(|timestep| self.num_gaussians_at(timestep)).max().unwrap_or(0)
    }

    /// Whether all Gaussians live at all timesteps.
    fn all_live(&self) -> bool {
        let identities = self.num_identities();
        (0..self.num_timesteps()).all(|timestep| identities == Some(self.num_gaussians_at(timestep)))
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

    fn num_timesteps(&self) -> usize {
        DynamicGaussians::num_timesteps(self)
    }

    fn num_gaussians_at(&self, _: usize) -> usize {
        self.num_gaussians()
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
    fn all_live_if_all_timesteps_have_all_identities() {
        let changing = |numbers: &[usize]| Changing(numbers.to_vec(), Layout::base());
        assert!(changing(&[3, 3]).all_live() && changing(&[]).all_live());
        assert!(!changing(&[3, 2]).all_live() && !changing(&[2, 3, 3]).all_live());
        assert_eq!([&[3, 3][..], &[3, 2]].map(|numbers| changing(numbers).num_identities()), [Some(3), None]);
        let mut scene = DynamicGaussians::default();
        scene.push(Gaussians::zeros(4));
        assert_eq!(((&scene).num_gaussians_at(0), (&scene).all_live()), (4, true));
    }
}
