//! The population: adds and removes Gaussians, from the initial points to the last death.
//!
//! - **First timestep** (`first_timestep`): clones, splits and removes Gaussians by gradient and opacity (`densify`).
//!   Prunes Gaussians that masks hide, Gaussians close to cameras (`free_space`), and Gaussians that the images hardly
//!   need, by a measured error (`removal`).
//! - **Births** (`births`): a later timestep adds Gaussians where the scene does not explain the images (`seeds`).
//! - **Youth** (`youth`): a Gaussian goes on learning all its attributes for some timesteps after its birth.
//! - **Deaths** (`deaths`): a later timestep removes Gaussians that no camera has seen for long.
//!
//! The trainer calls a [`Population`] at four places: at the start of a later timestep, before an iteration, after it,
//! and at the end of a later timestep. Another strategy replaces this one struct.
//!
//! What does not live here: the choice of what a timestep trains ([`crate::gate`]), the data of a Gaussian
//! ([`crate::state`]), and its identity ([`crate::lifetimes`]).

mod births;
mod deaths;
mod densify;
mod first_timestep;
mod free_space;
mod nursery;
mod removal;
mod seeds;
mod unseen;
mod youth;

use tcgs_core::{Camera, PointCloud, View};

use self::births::Births;
#[cfg(test)]
pub(crate) use self::births::MIN_OPACITY;
use self::deaths::Deaths;
#[cfg(test)]
pub(crate) use self::densify::{CLONE_SCALE, PRUNE_SCALE, RESET_OPACITY, SPLIT_CHILDREN, SPLIT_SHRINK};
pub use self::densify::{Densified, DensifyStep, densify, remove_others, reset_opacities};
use self::first_timestep::FirstTimestep;
#[cfg(test)]
pub(crate) use self::first_timestep::{DENSIFY_END, MASK_PRUNE_INTERVAL};
use self::free_space::FreeSpace;
pub use self::removal::{Needed, Removal, TimestepViews, judge_stride, needed};
pub use self::unseen::are_in_images;
pub(crate) use self::unseen::keep_out;
use self::unseen::unseen_last;
use self::youth::raise_young;
use crate::TrainError;
use crate::config::{DeathConfig, TrainConfig};
use crate::gate::{Activity, Gate};
use crate::schedule::Phase;
use crate::solver::{Asked, Solver};
use crate::state::State;

/// The points at which a run's first Gaussians stand.
///
/// - `cameras`: of the first timestep's training views
/// - returns: also how many of them, the last ones, are not trained in the first timestep. These are in no image. All
///   are trained if all are in no image, and where no Gaussian is removed by a measured error.
pub(crate) fn initial_points(config: &TrainConfig, cloud: &PointCloud, cameras: &[Camera]) -> (PointCloud, usize) {
    if config.densify.prune_error == 0.0 {
        return (cloud.clone(), 0);
    }
    let (cloud, num_unseen) = unseen_last(cloud, cameras);
    let num_fixed = if num_unseen < cloud.points.len() { num_unseen } else { 0 };
    (cloud, num_fixed)
}

/// Adds and removes the Gaussians of a run.
#[derive(Debug)]
pub(crate) struct Population {
    first: FirstTimestep,
    /// None if no Gaussian is born after the first timestep.
    births: Option<Births>,
    /// Timesteps after its birth in which a Gaussian is young.
    youth: usize,
    deaths: Deaths,
}

impl Population {
    /// - `scene_radius`: scene units
    /// - `unseen`: from the checkpoint that the run resumes from; empty at the start of a run
    pub fn new(config: &TrainConfig, scene_radius: f32, unseen: Vec<u32>) -> Self {
        // The gate measures which Gaussians are seen.
        let deaths = if config.gate.enabled { &config.deaths } else { &DeathConfig::OFF };
        Self {
            first: FirstTimestep::new(config, scene_radius),
            births: config.births.enabled.then(|| Births::new(config, scene_radius)),
            youth: config.births.youth,
            deaths: Deaths::new(deaths, &config.mask, unseen),
        }
    }

    /// A population without births and deaths after the first timestep.
    pub fn closed(config: &TrainConfig, scene_radius: f32) -> Self {
        let deaths = Deaths::new(&DeathConfig::OFF, &config.mask, Vec::new());
        Self { births: None, deaths, ..Self::new(config, scene_radius, Vec::new()) }
    }

    /// Keeps Gaussians of the first timestep out of the space around the cameras, where Gaussians are removed by a
    /// measured error.
    ///
    /// - `points`: the initial points, `[P, 3]`, at least one
    pub fn keep_clear(&mut self, cameras: &[Camera], points: &[[f32; 3]]) {
        self.first.free_space = FreeSpace::around(cameras, points);
    }

    /// `[N]` timestep since which no camera has seen a Gaussian: part of a checkpoint.
    pub fn unseen(&self) -> &[u32] {
        self.deaths.unseen()
    }

    /// At the start of a later timestep.
    ///
    /// - `state`: after the previous timestep
    /// - `activity`: what the timestep trains; none if everything
    pub fn begin_timestep(&mut self, state: &State, activity: Option<&Activity>) {
        self.deaths.look(state, activity);
    }

    /// Before an iteration: tells what the engine does in it for the population.
    ///
    /// - `iteration`: within the timestep's schedule, from 0
    pub fn asks(&self, phase: Phase, iteration: usize) -> Asked {
        if phase == Phase::First { self.first.asks(iteration) } else { Asked::NOTHING }
    }

    /// After an iteration of the first timestep.
    ///
    /// - `seed`: of the iteration's random choices
    pub fn after_iteration(
        &mut self,
        solver: &mut Solver,
        iteration: usize,
        seed: u64,
        views: &[View],
    ) -> Result<(), TrainError> {
        if self.first.reshapes(iteration) {
            let sparsity = solver.sparsity;
            solver.reshape(|state| self.first.reshape(state, iteration, seed, views, sparsity))?;
        }
        Ok(())
    }

    /// At the end of a later timestep, after its iterations.
    ///
    /// - `gate`: with pictures of the scene as it is now
    /// - `activity`: what the timestep trained
    pub fn end_timestep(
        &mut self,
        solver: &mut Solver,
        gate: &mut Gate,
        views: &[View],
        activity: &Activity,
    ) -> Result<(), TrainError> {
        if let Some(births) = &self.births {
            let num_born = births.give_birth(solver, gate, views, activity)?;
            self.deaths.welcome(num_born);
            raise_young(self.youth, solver, gate, views, activity)?;
        }
        self.deaths.bury(solver, gate, views)
    }
}
