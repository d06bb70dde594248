//! Deaths: a later timestep removes Gaussians that no camera has seen for long.

use tcgs_core::{Life, View, distance};

use crate::TrainError;
use crate::config::{DeathConfig, MaskConfig};
use crate::gate::{Activity, Gate};
use crate::mask::mask;
use crate::solver::Solver;
use crate::state::State;

/// The rules of deaths, and a record of unseen Gaussians.
#[derive(Clone, Debug)]
pub(super) struct Deaths {
    config: DeathConfig,
    mask: MaskConfig,
    /// `[N]` timestep since which no camera has seen the Gaussian; [`Life::NEVER`] if one saw it last. Empty if deaths
    /// are off.
    unseen: Vec<u32>,
}

impl Deaths {
    /// - `unseen`: from the checkpoint that the run resumes from
    pub fn new(config: &DeathConfig, mask: &MaskConfig, unseen: Vec<u32>) -> Self {
        // A resumed run may have deaths switched off.
        let unseen = if config.patience > 0 { unseen } else { Vec::new() };
        Self { config: config.clone(), mask: mask.clone(), unseen }
    }

    pub fn unseen(&self) -> &[u32] {
        &self.unseen
    }

    /// Notes which Gaussians are seen. All count as seen if a timestep trains everything.
    ///
    /// - `state`: after the previous timestep
    /// - `activity`: what the timestep trains; none if everything
    pub fn look(&mut self, state: &State, activity: Option<&Activity>) {
        let Some(activity) = activity else { return self.unseen.clear() };
        if self.config.patience > 0 {
            self.unseen.resize(state.parameters.num_gaussians(), Life::NEVER);
            let timestep = state.timestep as u32;
            for (unseen, share) in self.unseen.iter_mut().zip(&activity.pixels) {
                *unseen = if *share >= self.config.share { Life::NEVER } else { (*unseen).min(timestep) };
            }
        }
    }

    /// Notes newborn Gaussians as seen.
    pub fn welcome(&mut self, num_born: usize) {
        if self.config.patience > 0 {
            self.unseen.resize(self.unseen.len() + num_born, Life::NEVER);
        }
    }

    /// Removes the Gaussians that die.
    pub fn bury(&mut self, solver: &mut Solver, gate: &mut Gate, views: &[View]) -> Result<(), TrainError> {
        let state = solver.engine.state()?;
        let dead = self.dying(state);
        if dead.is_empty() {
            return Ok(());
        }
        let before = gate.drawn(state).activated().select(&dead);
        solver.reshape(|state| state.bury(&dead))?;
        let mut row = 0..;
        self.unseen.retain(|_| row.next().is_some_and(|row| dead.binary_search(&row).is_err()));
        gate.redraw_rows(solver.engine.state()?, views, &[], &before);
        Ok(())
    }

    /// Gaussians that die: no camera has seen them for long, and their masks hide them or they are away from their
    /// place of birth. A Gaussian at rest at its place of birth lives on, because it may be uncovered or the cameras
    /// may move.
    ///
    /// Visibility is measured at the positions at the start of the timestep. A Gaussian that comes into view during
    /// this very timestep therefore dies, and births replace it.
    ///
    /// - `state`: after the timestep
    /// - returns: indices, ascending
    fn dying(&self, state: &State) -> Vec<usize> {
        let (patience, timestep) = (self.config.patience, state.timestep);
        let Some(past) = state.past.as_ref().filter(|_| patience > 0 && timestep.is_multiple_of(patience)) else {
            return Vec::new();
        };
        let p = &state.parameters;
        let (means, log_scales) = (p.gaussians.means(), p.gaussians.log_scales());
        let is_away = |i: usize| {
            distance(means[i], past.first.means[i]) > log_scales[i].into_iter().fold(f32::MIN, f32::max).exp()
        };
        let is_masked = |i: usize| self.mask.enabled && mask(p.mask_logits[i], self.mask.threshold) == 0.0;
        let is_due = |&i: &usize| timestep.checked_sub(self.unseen[i] as usize).is_some_and(|t| t >= patience);
        let dies = |i: &usize| is_due(i) && (is_masked(*i) || is_away(*i));
        let dying: Vec<usize> = (0..self.unseen.len()).filter(dies).collect();
        // A scene has at least one Gaussian.
        if dying.len() < means.len() { dying } else { Vec::new() }
    }
}

#[cfg(test)]
mod tests {
    use tcgs_core::{BaseColumns, Gaussians};

    use super::*;
    use crate::config::{Preset, TrainConfig};
    use crate::motion::{Past, Pose};
    use crate::parameters::Parameters;

    #[test]
    fn who_dies_is_unseen_for_long_and_masked_or_elsewhere_than_where_it_was_born() {
        let n = 5;
        let gaussians = Gaussians::from(BaseColumns {
            means: (0..n).map(|i| [i as f32, 0.0, 0.0]).collect(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
            log_scales: vec![[-3.0, -4.0, -5.0]; n],
            logit_opacities: vec![2.0; n],
            colors: vec![[0.5; 3]; n],
        });
        let mut born = gaussians.clone();
        // The first two have moved, the third by less than its size, and the last one is masked.
        born.means_mut()[0][1] = 1.0;
        born.means_mut()[1][1] = 0.06;
        born.means_mut()[2][1] = 0.04;
        let mut state = State::new(Parameters {
            gaussians: gaussians.clone(),
            mask_logits: vec![1.0, 1.0, 1.0, 1.0, -9.0],
            foreground: vec![true; n],
            camera_gains: vec![[0.0; 3]; 2],
            camera_offsets: vec![[0.0; 3]; 2],
        });
        state.past = Some(Past::new(Pose::of(&born), gaussians, &vec![true; n]));
        let mut config = TrainConfig::preset(Preset::Fast);
        config.mask.enabled = true;
        let dying = |config: &TrainConfig, timestep: usize, unseen: [u32; 5]| {
            let mut state = state.clone();
            state.timestep = timestep;
            Deaths::new(&config.deaths, &config.mask, unseen.to_vec()).dying(&state)
        };
        config.deaths.patience = 4;
        assert_eq!(dying(&config, 8, [4, 4, 4, 4, 4]), [0, 1, 4]);
        // The first was seen at the last timestep, the second is unseen for three; no Gaussian dies between two
        // burials.
        assert_eq!(dying(&config, 8, [Life::NEVER, 5, 1, 1, 1]), [4]);
        assert!(dying(&config, 9, [1; 5]).is_empty());
        config.mask.enabled = false;
        assert_eq!(dying(&config, 8, [4, 5, 4, 4, 4]), [0]);
        config.deaths.patience = 0;
        assert!(dying(&config, 8, [1; 5]).is_empty());
    }
}
