//! Births: Gaussians for content that no Gaussian of the first timestep can show.
//!
//! Luiten et al. 2024 and the paper move the Gaussians of the first timestep and add none. Content that enters later or
//! was hidden at first never appears. Here, after a timestep's motion is trained:
//!
//! 1. The gate finds the blocks of each view that the scene still does not explain
//!    ([`crate::gate::Gate::unexplained`]).
//! 2. [`seeds`] finds the places on which several views agree.
//! 3. A Gaussian is born at each place. The newborn alone learn all their attributes for a while, in the tiles that
//!    they reach; the rest of the scene is drawn and held.
//! 4. Newborn that end transparent or hidden by the mask are dropped. Newborn whose gradients stay large are cloned or
//!    split, as at the first timestep ([`densify`]). All newborn then learn for as long again.
//! 5. They join the state. From the next timestep on they move like all others.
//!
//! Newborn Gaussians are neighbours of those born with them, by the poses of their first timestep. The sensitivity of
//! their parameters is not measured: each column has the largest bit width of the first timestep.
//!
//! Two variants did not help. Moving everything again with the newborn had the same PSNR in more time. Removing
//! Gaussians whose removal lowers the error to first order gained nothing on the demo. It lost where the scene is
//! blurred, because each Gaussian of a blur by itself increases the error.

use tcgs_core::{BaseColumns, Gaussians, View, sigmoid};

use super::densify::{DensifyStep, densify, remove_others};
use super::nursery::{Nursery, alone};
use super::seeds::{Seed, seeds};
use crate::TrainError;
use crate::config::{DensifyConfig, TrainConfig};
use crate::gate::{Activity, Blocks, Gate};
use crate::mask::mask;
use crate::parameters::Parameters;
use crate::schedule::Phase;
use crate::solver::{Asked, Solver};
use crate::state::State;

/// Largest scale of a Gaussian that is kept, in distances between the rays that found its place.
const MAX_GROWTH: f32 = 3.0;
/// Opacity below which a newborn Gaussian is dropped after its iterations.
pub(crate) const MIN_OPACITY: f32 = 0.1;

/// The rules of births.
#[derive(Clone, Debug)]
pub(super) struct Births {
    config: TrainConfig,
    scene_radius: f32,
}

impl Births {
    /// - `scene_radius`: scene units, to which scales are compared
    pub fn new(config: &TrainConfig, scene_radius: f32) -> Self {
        Self { config: config.clone(), scene_radius }
    }

    /// Gives birth to content that a timestep shows and the trained scene does not.
    ///
    /// - `activity`: what the timestep trained; the gate's pictures are redrawn there
    /// - returns: number of Gaussians born
    ///
    /// # Errors
    /// As [`Trainer::fit`](crate::Trainer::fit).
    pub fn give_birth(
        &self,
        solver: &mut Solver,
        gate: &mut Gate,
        views: &[View],
        activity: &Activity,
    ) -> Result<usize, TrainError> {
        let state = solver.engine.state()?;
        let unexplained = gate.unexplained(state, views, activity);
        let most = (f64::from(self.config.births.share) * state.parameters.num_gaussians() as f64).ceil() as usize;
        let seeds = seeds(views, &unexplained, state.parameters.gaussians.means(), most);
        let mut born = alone(newborn(&seeds, &state.parameters, self.config.mask.initial_logit), state);
        let mut spacings: Vec<f32> = seeds.iter().map(|seed| seed.spacing).collect();
        self.grow(&mut born, &mut spacings, solver, gate, views, &unexplained)?;
        if self.divides() && self.divide(&mut born, &mut spacings, solver.timestep) {
            self.grow(&mut born, &mut spacings, solver, gate, views, &unexplained)?;
        }
        let num_born = born.parameters.num_gaussians();
        if num_born > 0 {
            solver.reshape(|state| state.append(&born.parameters))?;
            gate.welcome(solver.engine.state()?, views, num_born);
        }
        Ok(num_born)
    }

    /// Trains the newborn and drops those not worth keeping.
    ///
    /// - `born`: the newborn alone
    /// - `spacings`: `[born]` distance between the rays that found each, scene units
    fn grow(
        &self,
        born: &mut State,
        spacings: &mut Vec<f32>,
        solver: &mut Solver,
        gate: &Gate,
        views: &[View],
        unexplained: &[Blocks],
    ) -> Result<(), TrainError> {
        if spacings.is_empty() {
            return Ok(());
        }
        let state = solver.engine.state()?;
        let mut all = gate.drawn(state);
        all.extend(&gate.drawn(born));
        let num_before = state.parameters.num_gaussians();
        let rows: Vec<usize> = (num_before..num_before + spacings.len()).collect();
        let nursery = Nursery::new(gate, &all, &rows, views, Some(unexplained));
        // Gradients count in the last half of the iterations, for the division after them.
        let length = solver.schedule.iterations(Phase::Birth);
        let asks = |iteration| Asked { counts_gradients: self.divides() && 2 * iteration >= length, ..Asked::NOTHING };
        *born = nursery.train(solver, Phase::Birth, born.clone(), None, asks)?;
        let mask_threshold = self.config.mask.enabled.then_some(self.config.mask.threshold);
        let keep = viable(&born.parameters, spacings, mask_threshold);
        remove_others(born, &keep);
        *spacings = keep.iter().map(|&i| spacings[i]).collect();
        Ok(())
    }

    /// Whether newborn Gaussians are cloned and split.
    fn divides(&self) -> bool {
        self.config.births.gradient_threshold > 0.0
    }

    /// Clones and splits the newborn whose gradients stayed large, by the rules of the first timestep.
    ///
    /// - `timestep`: of their birth
    /// - returns: whether there were any
    fn divide(&self, born: &mut State, spacings: &mut Vec<f32>, timestep: usize) -> bool {
        let gradient_threshold = self.config.births.gradient_threshold;
        let step = DensifyStep {
            config: &DensifyConfig { gradient_threshold, ..self.config.densify.clone() },
            scene_radius: self.scene_radius,
            last: false,
            removes_large: false,
            seed: self.config.seed ^ timestep as u64,
        };
        let done = densify(born, &step);
        *spacings = done.sources.iter().map(|&i| spacings[i]).collect();
        done.cloned + done.split > 0
    }
}

/// A Gaussian at each seed: round, as large as its distance from the next, half opaque.
fn newborn(seeds: &[Seed], scene: &Parameters, mask_logit: f32) -> Parameters {
    let n = seeds.len();
    let base = BaseColumns {
        means: seeds.iter().map(|seed| seed.position).collect(),
        quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
        log_scales: seeds.iter().map(|seed| [(0.5 * seed.spacing).ln(); 3]).collect(),
        logit_opacities: vec![0.0; n],
        colors: seeds.iter().map(|seed| seed.color).collect(),
    };
    Parameters {
        gaussians: Gaussians::from(base).extended(scene.gaussians.layout()),
        mask_logits: vec![mask_logit; n],
        foreground: seeds.iter().map(|seed| seed.foreground).collect(),
        camera_gains: scene.camera_gains.clone(),
        camera_offsets: scene.camera_offsets.clone(),
    }
}

/// Indices of the Gaussians worth keeping: neither transparent nor hidden, and not far larger than their ray spacing.
///
/// - `spacings`: `[grown]` distance between the rays that found each, scene units
fn viable(grown: &Parameters, spacings: &[f32], mask_threshold: Option<f32>) -> Vec<usize> {
    let (opacities, scales) = (grown.gaussians.logit_opacities(), grown.gaussians.log_scales());
    let is_viable = |&i: &usize| {
        let shown = mask_threshold.is_none_or(|threshold| mask(grown.mask_logits[i], threshold) > 0.0);
        let largest = scales[i].into_iter().fold(f32::MIN, f32::max).exp();
        shown && sigmoid(opacities[i]) >= MIN_OPACITY && largest <= MAX_GROWTH * spacings[i]
    };
    (0..grown.num_gaussians()).filter(is_viable).collect()
}
