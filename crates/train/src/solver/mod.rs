//! Iterations on an engine, one after another: views in random order, learning rates, losses.
//!
//! What does not live here: the timesteps of a run (`trainer`), the number of Gaussians (`population`), and the
//! computation of an iteration (`engine`).

mod glimpse;

use std::ops::ControlFlow;
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

pub(crate) use self::glimpse::Part;
pub use self::glimpse::{Glimpse, Glimpsed};
use crate::TrainError;
use crate::config::TrainConfig;
use crate::engine::{Engine, Step, Target};
use crate::gate::{Pace, Trained};
use crate::losses::{LossTerms, WeightConfig};
use crate::parameters::{DIFFERENT, spread_of_cameras};
use crate::schedule::{Phase, Schedule};
use crate::state::State;

/// Factor of the rate of the cameras' gains and offsets, if cameras differ in brightness.
const DIFFERENT_CAMERAS: f32 = 10.0;

/// Spread of the cameras' brightness that noise alone may reach, in steps of their rate. It matters in first timesteps
/// of less than 1500 iterations, which have higher rates.
const NOISE: f32 = 30.0;

/// The report of one iteration that [`Trainer::fit`](crate::Trainer::fit) gives to its observer.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Index of the timestep, counted from the run's first.
    pub timestep: usize,
    /// Index of the iteration within the timestep, from 0.
    pub iteration: usize,
    /// Number of iterations of this timestep if its losses go on falling; it may take fewer.
    pub iterations: usize,
    /// The value of each loss, before its weight.
    pub terms: LossTerms,
    /// The weighted sum of the losses.
    pub loss: f64,
    /// Number of Gaussians during the iteration.
    pub num_gaussians: usize,
    /// The trained share of the scene and of its views.
    pub trained: Trained,
}

/// Receives the report of every iteration, and ends the training by [`ControlFlow::Break`].
pub(crate) type Observer<'a> = &'a mut dyn FnMut(&Progress) -> ControlFlow<()>;

/// Computes iterations on an engine, by a schedule.
#[derive(Debug)]
pub(crate) struct Solver {
    pub config: TrainConfig,
    pub schedule: Schedule,
    pub engine: Box<dyn Engine>,
    /// The images of the timestep that is trained; else none.
    pub targets: Arc<[Target]>,
    /// Sparsity of the first timestep's views ([`view_sparsity`](crate::view_sparsity)).
    pub sparsity: f32,
    /// Timesteps finished.
    pub timestep: usize,
    /// The trained share of the scene and of its views.
    pub trained: Trained,
    /// As in the engine's state, which may be on another device.
    num_gaussians: usize,
    /// Spread of the training cameras' brightness, as learned by the last change of the Gaussians.
    spread_of_cameras: f32,
    /// The channel through which other threads ask for the scene.
    pub glimpse: Option<Arc<Glimpse>>,
}

/// Progress of some iterations on the same views.
pub(crate) struct Iterations<'a> {
    phase: Phase,
    /// Positions of the views.
    cameras: Vec<usize>,
    pace: Pace,
    /// The part of the scene in the engine's state; none if the state holds all of it.
    part: Option<Part<'a>>,
    weights: WeightConfig,
    /// The views that are left of a pass through all of them.
    order: Vec<usize>,
    random: Pcg64Mcg,
    /// Iterations whose losses are known.
    reported: usize,
}

/// Requests of the population to an iteration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Asked {
    /// Whether gradients count for densification.
    pub counts_gradients: bool,
    /// Whether Gaussians move. False where Gaussians are replaced right after.
    pub moves_gaussians: bool,
}

impl Asked {
    pub const NOTHING: Self = Self { counts_gradients: false, moves_gaussians: true };
}

impl Iterations<'_> {
    /// A random number of the timestep's stream.
    pub fn random_number(&mut self) -> u64 {
        self.random.random()
    }
}

impl Solver {
    /// - `num_gaussians`: of the engine's state
    /// - `scene_radius`: scene units
    /// - `timestep`: number of finished timesteps
    pub fn new(
        config: &TrainConfig,
        scene_radius: f32,
        engine: Box<dyn Engine>,
        num_gaussians: usize,
        timestep: usize,
    ) -> Self {
        let (config, schedule) = (config.clone(), Schedule::new(config, scene_radius));
        Self {
            config,
            schedule,
            engine,
            targets: Arc::default(),
            sparsity: 0.0,
            timestep,
            trained: Trained::ALL,
            num_gaussians,
            spread_of_cameras: 0.0,
            glimpse: None,
        }
    }

    /// Number of Gaussians of the scene.
    pub fn num_gaussians(&self) -> usize {
        self.num_gaussians
    }

    /// Changes the Gaussians of the scene, which the engine's state holds.
    pub fn reshape(&mut self, change: impl FnOnce(&mut State)) -> Result<(), TrainError> {
        let state = self.engine.state_mut()?;
        change(state);
        self.num_gaussians = state.parameters.num_gaussians();
        self.spread_of_cameras = spread_of_cameras(&state.parameters.corrections());
        Ok(())
    }

    /// Iterations on the engine's state.
    ///
    /// - `cameras`: positions of the views to iterate over
    /// - `part`: the part of the scene in the engine's state; none if it holds all of it
    pub fn iterations<'a>(
        &self,
        phase: Phase,
        cameras: Vec<usize>,
        pace: Pace,
        part: Option<Part<'a>>,
    ) -> Iterations<'a> {
        let weights = self.config.weights;
        Iterations {
            phase,
            cameras,
            pace,
            weights: part.as_ref().map_or(weights, |part| part.shares.weights(&weights)),
            part,
            order: Vec::new(),
            // One random stream per timestep, so that resuming needs no saved state.
            random: Pcg64Mcg::seed_from_u64(
                self.config.seed ^ (self.timestep as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15),
            ),
            reported: 0,
        }
    }

    /// The place in the phase's schedule of the next iteration, which [`Self::step`] then takes; none at the end.
    pub fn next(&self, iterations: &mut Iterations<'_>) -> Option<usize> {
        let place = iterations.pace.next()?;
        Some(place * self.schedule.iterations(iterations.phase) / iterations.pace.length())
    }

    /// One iteration on a random view.
    ///
    /// - `iteration`: from [`Self::next`]
    pub fn step(
        &mut self,
        iterations: &mut Iterations<'_>,
        iteration: usize,
        asked: Asked,
        observe: Observer<'_>,
    ) -> Result<(), TrainError> {
        let order = &mut iterations.order;
        if order.is_empty() {
            order.clone_from(&iterations.cameras);
        }
        let camera = order.swap_remove(iterations.random.random_range(0..order.len()));
        let mut rates = self.schedule.rates(iterations.phase, iteration);
        if iterations.part.is_some() {
            // Locked Gaussians share the quantizers.
            rates.step = 0.0;
        }
        let image = &self.targets[camera].image;
        let num_pixels = image.width * image.height;
        rates.color_epsilon = self.schedule.color_epsilon(iterations.phase, self.sparsity, num_pixels);
        if rates.centers_cameras && self.spread_of_cameras > DIFFERENT.max(NOISE * rates.camera) {
            rates.camera *= DIFFERENT_CAMERAS;
        }
        let step = Step {
            camera,
            rates,
            weights: &iterations.weights,
            mask: &self.config.mask,
            counts_gradients: asked.counts_gradients,
            dropout: self.schedule.dropout(iterations.phase, iteration, self.sparsity),
            moves_gaussians: asked.moves_gaussians,
        };
        self.engine.step(&step)?;
        if !asked.moves_gaussians {
            self.engine.wait()?;
        }
        self.report(iterations, observe)?;
        if iterations.pace.is_decision_due() {
            if !iterations.pace.can_decide() {
                self.engine.wait()?;
                self.report(iterations, observe)?;
            }
            iterations.pace.decide();
        }
        self.give_glimpse(iterations.part.as_ref(), iterations.pace.begun())
    }

    /// Waits for all iterations, and checks their result.
    pub fn finish(&mut self, mut iterations: Iterations<'_>, observe: Observer<'_>) -> Result<(), TrainError> {
        self.engine.wait()?;
        self.report(&mut iterations, observe)?;
        assert_eq!(iterations.reported, iterations.pace.begun(), "iterations that the engine reported");
        self.check_finite(iterations.reported)
    }

    /// Checks and passes on the losses that have become known.
    fn report(&mut self, iterations: &mut Iterations<'_>, observe: Observer<'_>) -> Result<(), TrainError> {
        let weights = &self.config.weights;
        let (timestep, num_gaussians, trained) = (self.timestep, self.num_gaussians, self.trained);
        let length = iterations.pace.length();
        for terms in self.engine.losses()? {
            let iteration = iterations.reported;
            let terms = iterations.part.as_ref().map_or(terms, |part| part.shares.terms(terms));
            if let Some(&(term, value, _)) = terms.terms(weights).iter().find(|t| !t.1.is_finite()) {
                return Err(TrainError::NotFinite { term: term.into(), value, timestep, iteration });
            }
            let loss = terms.total(weights);
            iterations.pace.hear(loss);
            iterations.reported += 1;
            let progress = Progress { timestep, iteration, iterations: length, terms, loss, num_gaussians, trained };
            if observe(&progress).is_break() {
                return Err(TrainError::Stopped { timestep, iteration });
            }
        }
        Ok(())
    }

    /// The renderer culls Gaussians that are not finite, so that no loss shows them.
    fn check_finite(&mut self, iteration: usize) -> Result<(), TrainError> {
        let gaussians = &self.engine.state()?.parameters.gaussians;
        for column in gaussians.layout().columns() {
            if let Some(value) = gaussians.values(column.attribute).iter().find(|x| !x.is_finite()) {
                let (term, value) = (column.name.clone().into(), f64::from(*value));
                return Err(TrainError::NotFinite { term, value, timestep: self.timestep, iteration });
            }
        }
        Ok(())
    }
}
