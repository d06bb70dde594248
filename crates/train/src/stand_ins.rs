//! Gaussians that do not live at all timesteps, in a scene that has all of them at every timestep.
//!
//! The codec sees tracks of one length. Before its birth a Gaussian therefore stands as it was born, and after its
//! death as it died. At all timesteps it has the opacity, scales and harmonics with which it settled. The codec then
//! cuts the tracks to the lives.

use std::collections::BTreeSet;
use std::sync::Arc;

use tcgs_core::{Gaussians, Layout, Life, Lives};

/// Stand-ins for the Gaussians of a run at timesteps at which they do not live. Before its birth a Gaussian stands as
/// it is born; after its death, as it was at the last timestep of its life.
#[derive(Clone, Debug)]
pub struct StandIns {
    /// None if all live at all timesteps.
    lives: Option<Lives>,
    /// Gaussians born after the first timestep, by identity, each with its pose at birth. Columns that do not vary over
    /// time have the values with which the Gaussian settled.
    newborn: Gaussians,
    /// Identities of the Gaussians that died, in the order of their deaths.
    dead: Vec<usize>,
    /// `[dead]` these Gaussians at the last timestep of their lives.
    departed: Gaussians,
}

impl StandIns {
    /// No stand-ins: all Gaussians of the scene live at all timesteps.
    pub fn none(layout: &Arc<Layout>) -> Self {
        let nobody = Gaussians::zeros_of(layout, 0);
        Self { lives: None, newborn: nobody.clone(), dead: Vec::new(), departed: nobody }
    }

    /// The stand-ins of a run.
    ///
    /// - `lives`: up to timestep `last`
    /// - `at`: returns the Gaussians that live at a timestep, in the order of identities
    ///
    /// # Errors
    /// As `at`.
    pub(crate) fn gather<E>(
        lives: Lives,
        layout: &Arc<Layout>,
        last: usize,
        at: impl Fn(usize, &Lives) -> Result<Gaussians, E>,
    ) -> Result<Self, E> {
        // A selection of the Gaussians that live at a timestep.
        let some = |timestep: u32, of: &dyn Fn(usize) -> bool| -> Result<Gaussians, E> {
            let living = lives.living(timestep as usize);
            let rows: Vec<usize> = (0..living.len()).filter(|&row| of(living[row])).collect();
            Ok(at(timestep as usize, &lives)?.select(&rows))
        };
        let mut newborn = Vec::new();
        for birth in distinct(lives.iter().map(|life| life.birth)).filter(|&birth| birth > 0) {
            newborn.push(some(birth, &|id| lives[id].birth == birth)?);
        }
        let (mut dead, mut departed) = (Vec::new(), Vec::new());
        for death in distinct(lives.iter().map(|life| life.death)).filter(|&death| death != Life::NEVER) {
            dead.extend((0..lives.len()).filter(|&id| lives[id].death == death));
            departed.push(some(death - 1, &|id| lives[id].death == death)?);
        }
        let now = at(last, &lives)?;
        let [newborn, departed] = [newborn, departed].map(|of| Gaussians::concat(layout, &of));
        let mut stand_ins = Self { lives: Some(lives), newborn, dead, departed };
        stand_ins.settle(&now, last);
        Ok(stand_ins)
    }

    /// Lifetimes of the Gaussians; none if all live at all timesteps.
    pub fn lives(&self) -> Option<&Lives> {
        self.lives.as_ref()
    }

    /// Sets the constant columns of the newborn to their values at the last timestep of their lives.
    ///
    /// - `now`: Gaussians that live at timestep `last`
    fn settle(&mut self, now: &Gaussians, last: usize) {
        let Some(lives) = &self.lives else { return };
        let living = lives.living(last);
        let num_first = lives.len() - self.newborn.num_gaussians();
        let mut settled = vec![None; self.newborn.num_gaussians()];
        for (ids, of) in [(&living, now), (&self.dead, &self.departed)] {
            for (row, &id) in ids.iter().enumerate().filter(|(_, id)| **id >= num_first) {
                settled[id - num_first] = Some((of, row));
            }
        }
        for column in now.layout().columns().iter().filter(|column| !column.varies) {
            let components = column.components();
            let values = self.newborn.values_mut(column.attribute).chunks_mut(components);
            for (values, settled) in values.zip(&settled) {
                let (of, row) = settled.expect("who was born lives, or has died");
                values.copy_from_slice(&of.values(column.attribute)[row * components..][..components]);
            }
        }
    }

    /// All Gaussians of the scene at a timestep. Columns of born Gaussians that do not vary over time have the values
    /// with which these settled.
    ///
    /// - `gaussians`: those that live at the timestep
    ///
    /// # Panics
    /// If their number is not that of the living, or their layout differs.
    pub fn complete(&self, gaussians: Gaussians, timestep: usize) -> Gaussians {
        let Some(lives) = &self.lives else { return gaussians };
        let layout = Arc::clone(gaussians.layout());
        let living = lives.living(timestep);
        assert_eq!(gaussians.num_gaussians(), living.len(), "Gaussians that live at timestep {timestep}");
        let num_first = lives.len() - self.newborn.num_gaussians();
        let mut all = gaussians;
        if living.len() < lives.len() {
            // Position of each among the living, the newborn and the dead.
            let unborn = living.len()..living.len() + self.newborn.num_gaussians();
            let mut rows: Vec<usize> = (0..num_first).chain(unborn.clone()).collect();
            for (row, &id) in self.dead.iter().enumerate().filter(|(_, id)| lives[**id].death as usize <= timestep) {
                rows[id] = unborn.end + row;
            }
            living.iter().enumerate().for_each(|(row, &id)| rows[id] = row);
            all = Gaussians::concat(&layout, &[all, self.newborn.clone(), self.departed.clone()]).select(&rows);
        }
        for column in layout.columns().iter().filter(|column| !column.varies) {
            let born = &mut all.values_mut(column.attribute)[num_first * column.components()..];
            born.copy_from_slice(self.newborn.values(column.attribute));
        }
        all
    }
}

/// Each timestep once, ascending.
fn distinct(timesteps: impl Iterator<Item = u32>) -> impl Iterator<Item = u32> {
    timesteps.collect::<BTreeSet<u32>>().into_iter()
}
