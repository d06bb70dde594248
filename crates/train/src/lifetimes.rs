//! Identity and lifetime of each Gaussian, as columns of integers.

use crate::row::Row;

/// A stable identity, the timestep of birth and the timestep of death of each Gaussian.
///
/// What the first timestep leaves was born at 0. Gaussians born later follow in the order of their births; none dies.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lifetimes {
    /// `[N]` an identity that stays while rows are reordered and removed, and is not given twice.
    pub ids: Vec<u32>,
    /// `[N]` first timestep at which it lives.
    pub births: Vec<u32>,
    /// `[N]` first timestep at which it lives no more; [`Self::NEVER`] of one that has not died.
    pub deaths: Vec<u32>,
    /// The next identity to give.
    next_id: u32,
}

impl Lifetimes {
    /// The value in [`deaths`](Self::deaths) of a Gaussian that has not died.
    pub const NEVER: u32 = u32::MAX;

    /// `num_gaussians` that live from the first timestep on, numbered from 0 in their order.
    pub fn new(num_gaussians: usize) -> Self {
        let next_id = u32::try_from(num_gaussians).expect("fewer than 2^32 Gaussians");
        let (births, deaths) = (vec![0; num_gaussians], vec![Self::NEVER; num_gaussians]);
        Self { ids: (0..next_id).collect(), births, deaths, next_id }
    }

    /// Lifetimes as a file holds them.
    ///
    /// - `ids`, `births`, `deaths`: `[N]`; see the fields
    ///
    /// # Panics
    /// If lengths differ.
    pub fn from_columns(ids: Vec<u32>, births: Vec<u32>, deaths: Vec<u32>) -> Self {
        assert_eq!([births.len(), deaths.len()], [ids.len(); 2], "births and deaths against identities");
        let next_id = ids.iter().max().map_or(0, |&id| id.saturating_add(1));
        Self { ids, births, deaths, next_id }
    }

    /// Whether all live from the first timestep on, have not died, and are numbered in their order.
    pub fn are_whole(&self) -> bool {
        let whole = |(i, ((&id, &birth), &death)): (usize, ((&u32, &u32), &u32))| {
            id as usize == i && birth == 0 && death == Self::NEVER
        };
        self.ids.iter().zip(&self.births).zip(&self.deaths).enumerate().all(whole)
    }

    /// Number of Gaussians that were born by a timestep, where rows stand in the order of births.
    pub(crate) fn born_by(&self, timestep: u32) -> usize {
        self.births.partition_point(|&birth| birth <= timestep)
    }

    /// Appends Gaussians.
    ///
    /// - `timestep`: at which they are born
    pub(crate) fn append(&mut self, count: usize, timestep: u32) {
        let ids = self.next_id..self.next_id + u32::try_from(count).expect("fewer than 2^32 Gaussians");
        self.next_id = ids.end;
        self.ids.extend(ids);
        self.births.resize(self.births.len() + count, timestep);
        self.deaths.resize(self.deaths.len() + count, Self::NEVER);
    }

    /// - `timestep`: at which what is new is born
    pub(crate) fn gather(&mut self, rows: &[Row], timestep: u32) {
        let old = std::mem::take(self);
        self.next_id = old.next_id;
        for row in rows {
            let (id, birth, death) = match row.kept() {
                Some(i) => (old.ids[i], old.births[i], old.deaths[i]),
                None => {
                    self.next_id += 1;
                    (self.next_id - 1, timestep, Self::NEVER)
                }
            };
            self.ids.push(id);
            self.births.push(birth);
            self.deaths.push(death);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn identities_stay_with_their_rows_and_are_not_given_twice() {
        let mut lifetimes = Lifetimes::new(3);
        lifetimes.gather(&[Row::Kept(2), Row::New { parent: 2 }, Row::Kept(0)], 5);
        assert_eq!((&lifetimes.ids[..], &lifetimes.births[..]), (&[2, 3, 0][..], &[0, 5, 0][..]));
        assert!(!lifetimes.are_whole() && lifetimes.deaths == [Lifetimes::NEVER; 3]);
        // The last one is removed, and its number is not used again.
        lifetimes.gather(&[Row::Kept(0)], 6);
        lifetimes.gather(&[Row::New { parent: 0 }], 6);
        assert_eq!((&lifetimes.ids[..], &lifetimes.births[..]), (&[4][..], &[6][..]));
        assert!(Lifetimes::new(2).are_whole());
    }
}
