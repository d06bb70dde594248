//! Births: Gaussians for content that no Gaussian of the first timestep can show.
//!
//! Luiten et al. 2024 and the paper move the Gaussians of the first timestep and add none. Content that enters later or
//! was hidden at first never appears. Here, after a timestep's motion is trained:
//!
//! 1. The gate finds the blocks of each view that the scene still does not explain
//!    ([`crate::gate::Gate::unexplained`]).
//! 2. `seeds` finds the places on which several views agree.
//! 3. A Gaussian is born at each place. The newborn alone learn all their attributes for a while, in the tiles that
//!    they reach; the rest of the scene is drawn and held.
//! 4. Newborn that end transparent or hidden by the mask are dropped. Newborn whose gradients stay large are cloned or
//!    split, as at the first timestep ([`crate::densify()`]). All newborn then learn for as long again.
//! 5. They join the state. From the next timestep on they move like all others.
//!
//! An entering object is first seen by few views, or from one side. For some timesteps the young therefore go on
//! learning all their attributes after each timestep that trained them. Then they settle: opacity, scales and harmonics
//! stay, like those of all others. A checkpoint holds the values learned at its timestep. A scene has the settled
//! values at all timesteps ([`crate::StandIns`]).
//!
//! Newborn Gaussians are neighbours of those born with them, by the poses of their first timestep. The sensitivity of
//! their parameters is not measured: each column has the largest bit width of the first timestep.
//!
//! Two variants did not help. Moving everything again with the newborn had the same PSNR in more time. Removing
//! Gaussians whose removal lowers the error to first order gained nothing on the demo. It lost where the scene is
//! blurred, because each Gaussian of a blur by itself increases the error.

mod seeds;

use std::ops::ControlFlow;

use tcgs_core::{BaseColumns, Gaussians, View, sigmoid};

use self::seeds::{Seed, seeds};
use super::glimpse::Part;
use super::{Trainer, all_segmented};
use crate::TrainError;
use crate::config::DensifyConfig;
use crate::densify::{DensifyStep, densify, remove_others};
use crate::engine::Target;
use crate::gate::{Activity, Blocks, Nursery, Pace, Shares};
use crate::mask::mask;
use crate::parameters::Parameters;
use crate::schedule::Phase;
use crate::state::State;

/// Largest scale of a Gaussian that is kept, in distances between the rays that found its place.
const MAX_GROWTH: f32 = 3.0;
/// Opacity below which a newborn Gaussian is dropped after its iterations.
pub(crate) const MIN_OPACITY: f32 = 0.1;

impl Trainer {
    /// Gives birth to content that a timestep shows and the trained scene does not, then trains the young.
    ///
    /// - `activity`: what the timestep trained; the pictures are redrawn there
    ///
    /// # Errors
    /// As [`Trainer::fit`].
    pub(super) fn give_birth(&mut self, views: &[View], activity: &Activity) -> Result<(), TrainError> {
        // Chapters of one scene have the same Gaussians.
        if !self.config.births.enabled || self.timestep == 0 || self.continues {
            return Ok(());
        }
        self.add_newborn(views, activity)?;
        self.raise_young(views, activity)
    }

    fn add_newborn(&mut self, views: &[View], activity: &Activity) -> Result<(), TrainError> {
        let config = self.config.births.clone();
        let Some(gate) = &self.gate else { return Ok(()) };
        let state = self.engine.state()?;
        let unexplained = gate.unexplained(state, views, activity);
        let most = (f64::from(config.share) * state.parameters.num_gaussians() as f64).ceil() as usize;
        let seeds = seeds(views, &unexplained, state.parameters.gaussians.means(), most);
        let mut born = alone(newborn(&seeds, &state.parameters, self.config.mask.initial_logit), state);
        let mut spacings: Vec<f32> = seeds.iter().map(|seed| seed.spacing).collect();
        self.grow(&mut born, &mut spacings, views, &unexplained)?;
        if config.gradient_threshold > 0.0 && self.divide(&mut born, &mut spacings) {
            self.grow(&mut born, &mut spacings, views, &unexplained)?;
        }
        if spacings.is_empty() {
            return Ok(());
        }
        self.engine.state_mut()?.append(&born.parameters);
        let state = self.engine.state()?;
        self.num_gaussians = state.parameters.num_gaussians();
        if let Some(gate) = &mut self.gate {
            gate.welcome(state, views, born.parameters.num_gaussians());
        }
        Ok(())
    }

    /// Trains the newborn and drops those not worth keeping.
    ///
    /// - `born`: the newborn alone
    /// - `spacings`: `[born]` distance between the rays that found each, scene units
    fn grow(
        &mut self,
        born: &mut State,
        spacings: &mut Vec<f32>,
        views: &[View],
        unexplained: &[Blocks],
    ) -> Result<(), TrainError> {
        let Some(gate) = self.gate.as_ref().filter(|_| !spacings.is_empty()) else { return Ok(()) };
        let state = self.engine.state()?;
        let mut all = gate.drawn(state);
        all.extend(&gate.drawn(born));
        let num_before = state.parameters.num_gaussians();
        let rows: Vec<usize> = (num_before..num_before + spacings.len()).collect();
        let nursery = Nursery::new(gate, &all, &rows, views, Some(unexplained));
        *born = self.nurse(Phase::Birth, nursery, born.clone(), None, views)?;
        let mask_threshold = self.config.mask.enabled.then_some(self.config.mask.threshold);
        let keep = viable(&born.parameters, spacings, mask_threshold);
        remove_others(born, &keep);
        *spacings = keep.iter().map(|&i| spacings[i]).collect();
        Ok(())
    }

    /// Clones and splits the newborn whose gradients stayed large, by the rules of the first timestep.
    ///
    /// - returns: whether there were any
    fn divide(&self, born: &mut State, spacings: &mut Vec<f32>) -> bool {
        let gradient_threshold = self.config.births.gradient_threshold;
        let step = DensifyStep {
            config: &DensifyConfig { gradient_threshold, ..self.config.densify.clone() },
            scene_radius: self.scene_radius,
            last: false,
            removes_large: false,
            seed: self.config.seed ^ self.timestep as u64,
        };
        let done = densify(born, &step);
        *spacings = done.sources.iter().map(|&i| spacings[i]).collect();
        done.cloned + done.split > 0
    }

    /// Trains all attributes of the young, Gaussians born at the timesteps just before, if this timestep trained them.
    fn raise_young(&mut self, views: &[View], activity: &Activity) -> Result<(), TrainError> {
        let config = &self.config.births;
        let Some(gate) = &self.gate else { return Ok(()) };
        let state = self.engine.state()?;
        let births = state.lifetimes.births();
        let is_young = |&i: &usize| births[i] > 0 && births[i] as usize + config.youth >= self.timestep;
        let young: Vec<usize> = activity.active.iter().copied().filter(is_young).collect();
        if young.is_empty() {
            return Ok(());
        }
        let small = alone(state.parameters.select(&young), state);
        let all = gate.drawn(state);
        let before = all.activated().select(&young);
        let nursery = Nursery::new(gate, &all, &young, views, None);
        let raised = self.nurse(Phase::Youth, nursery, small, Some(&young), views)?;
        self.engine.state_mut()?.parameters.put(&young, &raised.parameters);
        let state = self.engine.state()?;
        if let Some(gate) = &mut self.gate {
            gate.redraw_rows(state, views, &young, &before);
        }
        Ok(())
    }

    /// Trains all attributes of a few Gaussians, and leaves the engine's state as it was.
    ///
    /// - `small`: these Gaussians alone
    /// - `rows`: their indices in the scene; empty if they have not joined it
    /// - returns: their trained values
    fn nurse(
        &mut self,
        phase: Phase,
        nursery: Nursery,
        small: State,
        rows: Option<&[usize]>,
        views: &[View],
    ) -> Result<State, TrainError> {
        let shares = Shares::of(&small.parameters.foreground, &self.engine.state()?.parameters.foreground);
        let whole = std::mem::replace(self.engine.state_mut()?, small);
        let part = Part { shares, of: rows.map(|rows| (&whole.parameters, rows)) };
        let with_segmentation = all_segmented(views);
        let targets: Vec<Target> = views.iter().map(|view| Target::new(view, with_segmentation)).collect();
        self.engine.begin(targets, Some(nursery.scenery))?;
        let length = (self.schedule.iterations(phase) * nursery.cameras.len()).div_ceil(views.len());
        let pace = Pace::even(length, nursery.cameras.len());
        self.iterate(phase, nursery.cameras, pace, Some(&part), &[], &mut |_| ControlFlow::Continue(()))?;
        Ok(std::mem::replace(self.engine.state_mut()?, whole))
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

/// A state of the newborn or the young without the scene.
fn alone(few: Parameters, scene: &State) -> State {
    let count = few.num_gaussians();
    let quantizers = scene.quantizers.clone().map(|mut quantizers| {
        let before = quantizers.bit_map.num_gaussians();
        quantizers.append(count);
        quantizers.select(&(before..before + count).collect::<Vec<_>>());
        quantizers
    });
    let mut state = State::new(few);
    state.timestep = scene.timestep;
    if let Some(quantizers) = quantizers {
        state.start_quantization(quantizers);
    }
    state
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
