//! One timestep: its iterations, and the events between them (densification, pruning, the start of quantisation).

use std::ops::ControlFlow;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tcgs_codec::assign_bits;
use tcgs_core::{Camera, View};

use super::glimpse::Part;
use super::{Trainer, all_segmented};
use crate::TrainError;
use crate::densify::{DensifyStep, densify, remove_others, reset_opacities};
use crate::engine::{Step, Target};
use crate::fake_quant::{FakeQuantizers, bit_settings};
use crate::gate::{Activity, Pace, Shares, Trained};
use crate::losses::LossTerms;
use crate::mask::{mask, masked_out};
use crate::motion::predict;
use crate::removal::{Removal, TimestepViews, needed};
use crate::schedule::Phase;

/// Largest share of the Gaussians that one removal by error takes. The others need iterations to take over.
const MOST_REMOVED: f32 = 0.4;

/// The report of one iteration that [`Trainer::fit`] gives to its observer.
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

/// Progress of the reports of a timestep's iterations.
struct Report {
    /// As [`Progress::iterations`].
    iterations: usize,
    /// Share of the scene in the engine's state; none if the state holds all of it.
    shares: Option<Shares>,
    /// Iterations whose losses are known.
    reported: usize,
}

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
        let num_cameras = self.engine.state()?.parameters.camera_gains.len();
        if views.len() != num_cameras {
            return Err(TrainError::Input {
                what: format!("training views of timestep {}", self.timestep),
                found: views.len().to_string(),
                expected: format!("{num_cameras}, as at the first"),
            });
        }
        self.check_finished()?;
        self.is_unfinished = true;
        self.camera_ids = views.iter().map(|v| v.camera_id).collect();
        let with_segmentation = all_segmented(views);
        let targets: Vec<Target> = views.iter().map(|v| Target::new(v, with_segmentation)).collect();
        let phase = self.phase();
        let mut activity = None;
        if phase == Phase::Rest {
            let state = self.engine.state_mut()?;
            state.begin_past();
            if let Some(gate) = &mut self.gate {
                activity = gate.look(self.engine.state()?, &targets);
            }
            self.begin_timestep(activity.as_ref())?;
        }
        self.trained = activity.as_ref().map_or(Trained::ALL, |a| a.trained(self.num_gaussians));
        match &mut activity {
            Some(activity) => self.fit_activity(targets, activity, observe)?,
            None => {
                self.engine.begin(targets, None)?;
                let pace = Pace::even(self.schedule.iterations(phase), views.len());
                let cameras = (0..views.len()).collect();
                self.iterate(phase, cameras, pace, None, views, observe)?;
            }
        }
        if let (Some(gate), Some(activity)) = (&mut self.gate, &activity) {
            gate.redraw(self.engine.state()?, views, activity);
            self.give_birth(views, activity)?;
            self.bury(views)?;
        }
        if let Some(gate) = &mut self.gate {
            let state = self.engine.state()?;
            match &activity {
                Some(activity) => gate.end(state, views, activity),
                None => gate.begin(state, views, with_segmentation),
            }
        }
        self.timestep += 1;
        self.is_unfinished = false;
        Ok(())
    }

    /// Removes Gaussians that no camera has seen for long.
    fn bury(&mut self, views: &[View]) -> Result<(), TrainError> {
        let Some(gate) = &mut self.gate else { return Ok(()) };
        let state = self.engine.state()?;
        let dead = gate.dying(state);
        if dead.is_empty() {
            return Ok(());
        }
        let before = gate.drawn(state).activated().select(&dead);
        self.engine.state_mut()?.bury(&dead);
        let state = self.engine.state()?;
        self.num_gaussians = state.parameters.num_gaussians();
        gate.forget(state, views, &dead, &before);
        Ok(())
    }

    /// Trains the active part of a timestep, and leaves the whole state in the engine.
    fn fit_activity(
        &mut self,
        targets: Vec<Target>,
        activity: &mut Activity,
        observe: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<(), TrainError> {
        let Some(scenery) = activity.scenery.take() else { return Ok(()) };
        let num_views = targets.len();
        let state = self.engine.state_mut()?;
        let shares = activity.shares(state);
        let small = activity.excerpt(state);
        let mut whole = std::mem::replace(state, small);
        self.engine.begin(targets, Some(scenery))?;
        // Every view has as many iterations as it would have if all views changed.
        let length = (self.schedule.iterations(Phase::Rest) * activity.cameras.len()).div_ceil(num_views);
        let pace = Pace::new(&self.config.gate, length, activity.cameras.len());
        let part = Part { shares, of: Some((&whole.parameters, &activity.active)) };
        self.iterate(Phase::Rest, activity.cameras.clone(), pace, Some(&part), &[], observe)?;
        activity.put_back(self.engine.state()?, &mut whole);
        *self.engine.state_mut()? = whole;
        Ok(())
    }

    /// The iterations of a timestep.
    ///
    /// - `cameras`: positions of the views to iterate over
    /// - `part`: the part of the scene in the engine's state; none if it holds all of it
    /// - `views`: all views, for the events between iterations of the first timestep
    pub(super) fn iterate(
        &mut self,
        phase: Phase,
        cameras: Vec<usize>,
        mut pace: Pace,
        part: Option<&Part>,
        views: &[View],
        observe: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<(), TrainError> {
        let config = self.config.clone();
        let shares = part.map(|part| part.shares);
        let weights = shares.map_or(config.weights, |shares| shares.weights(&config.weights));
        let mut report = Report { iterations: pace.length(), shares, reported: 0 };
        let mut order = Vec::new();
        // One random stream per timestep, so that resuming needs no saved state.
        let mut random =
            Pcg64Mcg::seed_from_u64(self.config.seed ^ (self.timestep as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        while let Some(place) = pace.next() {
            let iteration = place * self.schedule.iterations(phase) / pace.length();
            if phase == Phase::First && self.schedule.starts_quantization(iteration) {
                self.start_quantization(views)?;
            }
            if order.is_empty() {
                order.clone_from(&cameras);
            }
            let camera = order.swap_remove(random.random_range(0..order.len()));
            let reshapes = phase == Phase::First && self.schedule.reshapes(iteration);
            let mut rates = self.schedule.rates(phase, iteration);
            if shares.is_some() {
                // Locked Gaussians share the quantizers.
                rates.step = 0.0;
            }
            let step = Step {
                camera,
                rates,
                weights: &weights,
                mask: &config.mask,
                counts_gradients: self.schedule.counts_gradients(phase, iteration),
                moves_gaussians: !reshapes,
            };
            self.engine.step(&step)?;
            if reshapes {
                self.engine.wait()?;
            }
            self.report(&mut report, &mut pace, observe)?;
            if pace.is_decision_due() {
                if !pace.can_decide() {
                    self.engine.wait()?;
                    self.report(&mut report, &mut pace, observe)?;
                }
                pace.decide();
            }
            self.give_glimpse(part, pace.begun())?;
            if phase == Phase::First {
                let seed = random.random();
                if reshapes {
                    self.reshape(iteration, seed, views)?;
                }
            }
        }
        self.engine.wait()?;
        self.report(&mut report, &mut pace, observe)?;
        assert_eq!(report.reported, pace.begun(), "iterations that the engine reported");
        self.check_finite(report.reported)
    }

    /// Checks and passes on the losses that have become known.
    fn report(
        &mut self,
        report: &mut Report,
        pace: &mut Pace,
        observe: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<(), TrainError> {
        let weights = &self.config.weights;
        let (timestep, num_gaussians, trained) = (self.timestep, self.num_gaussians, self.trained);
        let iterations = report.iterations;
        for terms in self.engine.losses()? {
            let iteration = report.reported;
            let terms = report.shares.map_or(terms, |shares| shares.terms(terms));
            if let Some(&(term, value, _)) = terms.terms(weights).iter().find(|t| !t.1.is_finite()) {
                return Err(TrainError::NotFinite { term: term.into(), value, timestep, iteration });
            }
            let loss = terms.total(weights);
            pace.hear(loss);
            report.reported += 1;
            if observe(&Progress { timestep, iteration, iterations, terms, loss, num_gaussians, trained }).is_break() {
                return Err(TrainError::Stopped { timestep, iteration });
            }
        }
        Ok(())
    }

    /// Densifies, removes and resets according to the schedule.
    fn reshape(&mut self, iteration: usize, seed: u64, views: &[View]) -> Result<(), TrainError> {
        let state = self.engine.state_mut()?;
        if self.schedule.densifies(iteration) {
            let step = DensifyStep {
                config: &self.config.densify,
                scene_radius: self.scene_radius,
                last: self.schedule.is_last_densification(iteration),
                removes_large: self.schedule.removes_large(iteration),
                seed,
            };
            densify(state, &step);
        }
        if self.schedule.resets_opacities(iteration) {
            reset_opacities(state);
        }
        if self.schedule.prunes_masked(iteration) {
            let threshold = self.config.mask.threshold;
            let logits = &state.parameters.mask_logits;
            let keep: Vec<usize> = (0..logits.len()).filter(|&i| mask(logits[i], threshold) > 0.0).collect();
            if !keep.is_empty() && keep.len() < logits.len() {
                remove_others(state, &keep);
            }
        }
        if self.schedule.prunes_unneeded(iteration) {
            let threshold = if self.config.mask.enabled { self.config.mask.threshold } else { -1.0 };
            let is_hidden = masked_out(&state.parameters.mask_logits, threshold);
            let timestep = TimestepViews {
                gaussians: &state.parameters.gaussians,
                is_hidden: &is_hidden,
                views,
                corrections: &state.parameters.corrections(),
            };
            let share = self.schedule.prune_error();
            let keep = needed(&[timestep], &Removal { share, most: MOST_REMOVED, costs: None, seed });
            remove_others(state, &keep);
        }
        // Identities matter only once the first timestep is finished.
        state.number_anew();
        self.num_gaussians = state.parameters.num_gaussians();
        Ok(())
    }

    fn start_quantization(&mut self, views: &[View]) -> Result<(), TrainError> {
        let cameras: Vec<Camera> = views.iter().map(|view| view.camera.clone()).collect();
        self.engine.state_mut()?.canonicalize_quats();
        let sensitivity = self.engine.sensitivity(&cameras)?;
        let state = self.engine.state_mut()?;
        let gaussians = &state.parameters.gaussians;
        let bit_map = assign_bits(&sensitivity, gaussians, &bit_settings(&self.config))?;
        state.start_quantization(FakeQuantizers::new(bit_map, gaussians, self.config.quantize.learned_offset)?);
        Ok(())
    }

    /// Predicts the poses of the trained Gaussians, and prepares the reference of the losses.
    ///
    /// - `activity`: the trained part; none if everything is trained
    fn begin_timestep(&mut self, activity: Option<&Activity>) -> Result<(), TrainError> {
        let timestep = self.timestep;
        let state = self.engine.state_mut()?;
        state.timestep = timestep;
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
        if self.config.mask.enabled {
            // Paper Eq. 5 compares with the timestep before.
            past.previous_mask_logits = Some(p.mask_logits.clone());
            if self.config.mask.reset {
                p.mask_logits.fill(self.config.mask.initial_logit);
            }
        }
        state.optimizer.begin_timestep(self.config.rates.reset_steps);
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
