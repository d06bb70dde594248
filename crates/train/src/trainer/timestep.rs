//! One timestep: what it trains, where its Gaussians start, its iterations, and the start of quantisation.

use std::ops::ControlFlow;
use std::sync::Arc;

use tcgs_codec::assign_bits;
use tcgs_core::{Camera, View};

use super::Trainer;
use crate::TrainError;
use crate::engine::Target;
use crate::fake_quant::{FakeQuantizers, bit_settings};
use crate::gate::{Activity, Pace, Trained};
use crate::motion::predict;
use crate::schedule::Phase;
use crate::solver::{Iterations, Observer, Part, Progress};
use crate::sparsity::view_sparsity;

impl Trainer {
    /// Trains the next timestep on its views.
    ///
    /// - `views`: one view per training camera, in the same order at every timestep
    /// - `observe`: receives every iteration's report, and ends the training by [`ControlFlow::Break`]. The CPU engine
    ///   reports an iteration before the next one begins; the GPU engine reports up to 64 iterations later.
    ///
    /// A timestep is the unit of a run. A checkpoint holds the state between two timesteps, without the moments of Adam
    /// and the order of views that only matter within one. A trainer that ended within a timestep, by
    /// `ControlFlow::Break` or by an error, therefore gives no checkpoint and trains no further.
    /// [`Run::resume`](crate::Run::resume) goes on after the last finished timestep, with the same bytes as an
    /// uninterrupted run.
    ///
    /// # Errors
    /// [`TrainError::Stopped`] if `observe` broke off; [`TrainError::NotFinite`] if a loss is; [`TrainError::Input`] if
    /// there are no views, another number of cameras than at the first timestep, or an unfinished timestep before;
    /// [`TrainError::Gpu`] if the engine failed.
    pub fn fit(
        &mut self,
        views: &[View],
        observe: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<(), TrainError> {
        let num_cameras = self.solver.engine.state()?.parameters.camera_gains.len();
        if views.len() != num_cameras {
            return Err(TrainError::Input {
                what: format!("training views of timestep {}", self.solver.timestep),
                found: views.len().to_string(),
                expected: format!("{num_cameras}, as at the first"),
            });
        }
        self.check_finished()?;
        self.is_unfinished = true;
        self.camera_ids = views.iter().map(|v| v.camera_id).collect();
        self.solver.targets = Target::of_all(views);
        let phase = self.phase();
        if phase == Phase::First {
            let cameras: Vec<Camera> = views.iter().map(|view| view.camera.clone()).collect();
            self.solver.sparsity = view_sparsity(self.solver.engine.state()?.parameters.gaussians.means(), &cameras);
        }
        let mut activity = None;
        if phase == Phase::Rest {
            self.solver.engine.state_mut()?.begin_past();
            if let Some(gate) = &mut self.gate {
                let renderer = self.solver.engine.look_renderer();
                let state = self.solver.engine.state()?;
                activity = gate.look(&*renderer, state, &self.solver.targets)?;
                self.population.begin_timestep(state, activity.as_ref());
            }
            self.begin_timestep(activity.as_ref())?;
        }
        let num_gaussians = self.solver.num_gaussians();
        self.solver.trained = activity.as_ref().map_or(Trained::ALL, |a| a.trained(num_gaussians));
        match &mut activity {
            Some(activity) => self.fit_activity(activity, observe)?,
            None => {
                self.solver.engine.begin(Arc::clone(&self.solver.targets), None)?;
                let pace = Pace::even(self.solver.schedule.iterations(phase), views.len());
                let iterations = self.solver.iterations(phase, (0..views.len()).collect(), pace, None);
                self.iterate(phase, iterations, views, observe)?;
            }
        }
        if let Some(gate) = &mut self.gate {
            match &activity {
                Some(activity) => {
                    gate.redraw(self.solver.engine.state()?, views, activity);
                    self.population.end_timestep(&mut self.solver, gate, views, activity)?;
                    gate.end(self.solver.engine.state()?, Arc::clone(&self.solver.targets), activity);
                }
                None => gate.begin(self.solver.engine.state()?, Arc::clone(&self.solver.targets)),
            }
        }
        self.solver.engine.end();
        self.solver.targets = Arc::default();
        self.solver.timestep += 1;
        self.is_unfinished = false;
        Ok(())
    }

    /// Trains the active part of a timestep, and leaves the whole state in the engine.
    fn fit_activity(&mut self, activity: &mut Activity, observe: Observer<'_>) -> Result<(), TrainError> {
        let Some(scenery) = activity.scenery.take() else { return Ok(()) };
        let targets = Arc::clone(&self.solver.targets);
        let num_views = targets.len();
        let state = self.solver.engine.state_mut()?;
        let shares = activity.shares(state);
        let small = activity.excerpt(state);
        let mut whole = std::mem::replace(state, small);
        self.solver.engine.begin(targets, Some(scenery))?;
        // Every view has as many iterations as it would have if all views changed.
        let length = (self.solver.schedule.iterations(Phase::Rest) * activity.cameras.len()).div_ceil(num_views);
        let pace = Pace::new(&self.solver.config.gate, length, activity.cameras.len());
        let part = Part { shares, of: Some((&whole.parameters, &activity.active)) };
        let iterations = self.solver.iterations(Phase::Rest, activity.cameras.clone(), pace, Some(part));
        self.iterate(Phase::Rest, iterations, &[], observe)?;
        activity.put_back(self.solver.engine.state()?, &mut whole);
        *self.solver.engine.state_mut()? = whole;
        self.solver.engine.end();
        Ok(())
    }

    /// The iterations of a timestep.
    ///
    /// - `views`: all views, for the events between iterations of the first timestep
    fn iterate(
        &mut self,
        phase: Phase,
        mut iterations: Iterations<'_>,
        views: &[View],
        observe: Observer<'_>,
    ) -> Result<(), TrainError> {
        while let Some(iteration) = self.solver.next(&mut iterations) {
            if phase == Phase::First && self.solver.schedule.starts_quantization(iteration) {
                self.start_quantization(views)?;
            }
            let asked = self.population.asks(phase, iteration);
            self.solver.step(&mut iterations, iteration, asked, observe)?;
            if phase == Phase::First {
                let seed = iterations.random_number();
                self.population.after_iteration(&mut self.solver, iteration, seed, views)?;
            }
        }
        self.solver.finish(iterations, observe)
    }

    fn start_quantization(&mut self, views: &[View]) -> Result<(), TrainError> {
        let cameras: Vec<Camera> = views.iter().map(|view| view.camera.clone()).collect();
        let (engine, config) = (&mut self.solver.engine, &self.solver.config);
        engine.state_mut()?.canonicalize_quats();
        let sensitivity = engine.sensitivity(&cameras)?;
        let state = engine.state_mut()?;
        let gaussians = &state.parameters.gaussians;
        let bit_map = assign_bits(&sensitivity, gaussians, &bit_settings(config))?;
        state.start_quantization(FakeQuantizers::new(bit_map, gaussians, config.quantize.learned_offset)?);
        Ok(())
    }

    /// Predicts the poses of the trained Gaussians, and prepares the reference of the losses.
    ///
    /// - `activity`: the trained part; none if everything is trained
    fn begin_timestep(&mut self, activity: Option<&Activity>) -> Result<(), TrainError> {
        let config = &self.solver.config;
        let state = self.solver.engine.state_mut()?;
        state.timestep = self.solver.timestep;
        let p = &mut state.parameters;
        let past = state.past.as_mut().expect("made before");
        let before = std::mem::replace(&mut past.previous, p.gaussians.clone());
        let (before_means, before_quats) = (before.means(), before.quats());
        let v = p.gaussians.views_mut();
        let mut goes_on = |i: usize| {
            (v.means[i], v.quats[i]) = predict(v.means[i], before_means[i], v.quats[i], before_quats[i]);
        };
        match activity {
            Some(activity) => activity.active.iter().for_each(|&i| goes_on(i)),
            None => (0..before_means.len()).for_each(goes_on),
        }
        for (&i, correction) in activity.iter().flat_map(|activity| activity.active.iter().zip(&activity.corrections)) {
            v.means[i] = std::array::from_fn(|axis| v.means[i][axis] + correction[axis]);
        }
        if config.mask.enabled {
            // Paper Eq. 5 compares with the timestep before.
            past.previous_mask_logits = Some(p.mask_logits.clone());
            if config.mask.reset {
                p.mask_logits.fill(config.mask.initial_logit);
            }
        }
        state.optimizer.begin_timestep(config.rates.reset_steps);
        Ok(())
    }
}
