//! Identity and lifetime of each Gaussian during training.
//!
//! Identities count up in the order of births. A checkpoint holds the rows of the Gaussians that live, and the lives of
//! all that ever lived. [`Lives::living`] maps rows to identities.

use tcgs_core::{Life, Lives};

use crate::row::Row;

/// A stable identity for each Gaussian of a state, and the lives of all that the run ever had.
///
/// Between timesteps rows stand in the order of identities, and thereby of births.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lifetimes {
    /// `[N]` an identity that survives reordering and removal of rows and is never reused.
    pub ids: Vec<u32>,
    /// By identity, those of the dead too.
    pub lives: Lives,
}

impl Lifetimes {
    /// `num_gaussians` that live from the first timestep on, numbered from 0 in their order.
    pub fn new(num_gaussians: usize) -> Self {
        let mut lifetimes = Self::default();
        lifetimes.append(num_gaussians, 0);
        lifetimes
    }

    /// Whether all that ever lived live from the first timestep on and have not died.
    pub fn are_whole(&self) -> bool {
        self.ids.len() == self.lives.len() && self.lives.iter().all(|&life| life == Life::since(0))
    }

    /// `[N]` timestep of birth.
    pub fn births(&self) -> Vec<u32> {
        self.ids.iter().map(|&id| self.lives[id as usize].birth).collect()
    }

    /// Number of Gaussians that were there at first.
    pub(crate) fn num_first(&self) -> usize {
        self.ids.partition_point(|&id| self.lives[id as usize].birth == 0)
    }

    /// Appends Gaussians.
    ///
    /// - `timestep`: at which they are born
    pub(crate) fn append(&mut self, count: usize, timestep: u32) {
        for _ in 0..count {
            self.ids.push(bear(&mut self.lives, timestep));
        }
    }

    /// - `timestep`: birth of new Gaussians
    pub(crate) fn gather(&mut self, rows: &[Row], timestep: u32) {
        let ids = std::mem::take(&mut self.ids);
        self.ids =
            rows.iter().map(|row| row.kept().map_or_else(|| bear(&mut self.lives, timestep), |i| ids[i])).collect();
    }

    /// Records that some rows die at a timestep; the caller then removes them.
    pub(crate) fn end(&mut self, rows: &[usize], timestep: u32) {
        rows.iter().for_each(|&row| self.lives.0[self.ids[row] as usize].death = timestep);
    }
}

/// Adds a life that begins at a timestep.
///
/// - returns: its identity
fn bear(lives: &mut Lives, timestep: u32) -> u32 {
    lives.0.push(Life::since(timestep));
    u32::try_from(lives.len() - 1).expect("fewer than 2^32 Gaussians")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identities_stay_with_their_rows_and_are_not_given_twice() {
        let mut lifetimes = Lifetimes::new(3);
        assert!(lifetimes.are_whole() && lifetimes.num_first() == 3);
        lifetimes.append(1, 5);
        assert_eq!((&lifetimes.births()[..], lifetimes.num_first()), (&[0, 0, 0, 5][..], 3));
        lifetimes.end(&[0, 3], 7);
        lifetimes.gather(&[Row::Kept(1), Row::Kept(2)], 7);
        // The last one is gone, and its identity is not reused.
        lifetimes.append(1, 8);
        assert_eq!((&lifetimes.ids[..], &lifetimes.births()[..]), (&[1, 2, 4][..], &[0, 0, 8][..]));
        let living = [4, 5, 6, 7, 8].map(|timestep| lifetimes.lives.living(timestep));
        let expected = [&[0, 1, 2][..], &[0, 1, 2, 3], &[0, 1, 2, 3], &[1, 2], &[1, 2, 4]];
        assert!(living.iter().zip(expected).all(|(a, b)| a == b), "{living:?}");
        lifetimes.gather(&[Row::Kept(2), Row::New { parent: 2 }, Row::Kept(0)], 9);
        assert_eq!(lifetimes.ids, [4, 5, 1]);
        assert!(!lifetimes.are_whole());
    }
}
