//! Lives of Gaussians: the timesteps of each in a scene in which Gaussians are born and die.
//!
//! An identity is the number of a Gaussian in its scene. It is given once, and is the same at all timesteps.

use std::ops::{Deref, Range};

/// The timesteps at which a Gaussian lives: from its birth up to its death, without the death itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Life {
    /// First timestep at which it lives.
    pub birth: u32,
    /// First timestep at which it no longer lives; [`Self::NEVER`] if it has not died.
    pub death: u32,
}

impl Life {
    /// The value of [`Self::death`] of a Gaussian that has not died.
    pub const NEVER: u32 = u32::MAX;

    /// A life that has not ended.
    pub fn since(birth: u32) -> Self {
        Self { birth, death: Self::NEVER }
    }

    /// Whether it lives at a timestep.
    pub fn contains(self, timestep: usize) -> bool {
        (self.birth as usize..self.death as usize).contains(&timestep)
    }

    /// The part of this life within a range of timesteps, counted from the start of the range.
    ///
    /// ```
    /// use tcgs_core::Life;
    /// assert_eq!(Life { birth: 3, death: Life::NEVER }.within(2..7), Life { birth: 1, death: 5 });
    /// ```
    pub fn within(self, timesteps: Range<u32>) -> Self {
        let [birth, death] = [self.birth, self.death].map(|t| t.clamp(timesteps.start, timesteps.end));
        Self { birth: birth - timesteps.start, death: death - timesteps.start }
    }
}

/// `[identities]` the life of each Gaussian of a scene.
///
/// ```
/// use tcgs_core::{Life, Lives};
/// let lives: Lives = [(0, 2), (0, Life::NEVER), (1, 3)].map(|(birth, death)| Life { birth, death }).into();
/// assert_eq!((lives.len(), lives.living(2), lives.num_living(0)), (3, vec![1, 2], 2));
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lives(pub Vec<Life>);

impl Lives {
    /// Identities of the Gaussians that live at a timestep, ascending.
    pub fn living(&self, timestep: usize) -> Vec<usize> {
        (0..self.len()).filter(|&identity| self[identity].contains(timestep)).collect()
    }

    /// Number of Gaussians that live at a timestep.
    pub fn num_living(&self, timestep: usize) -> usize {
        self.iter().filter(|life| life.contains(timestep)).count()
    }

    /// The lives of some Gaussians, in the order of `identities`.
    pub fn select(&self, identities: &[usize]) -> Self {
        identities.iter().map(|&identity| self[identity]).collect()
    }
}

impl Deref for Lives {
    type Target = [Life];

    fn deref(&self) -> &[Life] {
        &self.0
    }
}

impl FromIterator<Life> for Lives {
    fn from_iter<I: IntoIterator<Item = Life>>(lives: I) -> Self {
        Self(lives.into_iter().collect())
    }
}

impl<const N: usize> From<[Life; N]> for Lives {
    fn from(lives: [Life; N]) -> Self {
        Self(lives.into())
    }
}
