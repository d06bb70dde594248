//! The training loop: timesteps, iterations, and the events between iterations (densification, pruning, the start of
//! quantisation). What does not live here: when an event is due (`schedule`), and how an iteration is computed
//! (`engine`).

use std::ops::ControlFlow;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tcgs_codec::{BitMapping, BitSettings, assign_bits};
use tcgs_core::{Camera, PointCloud, View};
use tcgs_metrics::psnr;

use crate::TrainError;
use crate::checkpoint::Checkpoint;
use crate::config::{BitMapKind, TrainConfig};
use crate::densify::{DensifyStep, densify, remove_others, reset_opacities};
use crate::engine::cpu::CpuEngine;
use crate::engine::{Engine, Step, Target};
use crate::fake_quant::FakeQuantizers;
use crate::gate::{Activity, Gate, GateRecord, Pace, Shares, Trained};
use crate::losses::LossTerms;
use crate::mask::mask;
use crate::motion::{Past, Pose, predict};
use crate::parameters::{Parameters, extent};
use crate::schedule::{Phase, Schedule};
use crate::state::State;

/// The report of one iteration that [`Trainer::fit`] gives to its observer.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Index of the timestep, counted from the run's first.
    pub timestep: usize,
    /// Index of the iteration within the timestep, from 0.
    pub iteration: usize,
    /// Number of iterations of this timestep.
    pub iterations: usize,
    /// The value of each loss, before its weight.
    pub terms: LossTerms,
    /// The weighted sum of the losses.
    pub loss: f64,
    /// Number of Gaussians during the iteration.
    pub num_gaussians: usize,
}

/// A training run in progress: settings, schedule, and an engine with the state after the last finished timestep.
///
/// ```
/// use std::ops::ControlFlow;
/// use tcgs_core::{Camera, Image, PointCloud, View};
/// use tcgs_train::{Preset, TrainConfig, Trainer};
///
/// let views = [-1.0, 1.0].map(|x| View {
///     camera: Camera::look_at([x, 0.0, -2.0], [0.0; 3], [0.0, -1.0, 0.0], 14.0, 16, 12),
///     image: Image::filled(16, 12, 3, 0.5),
///     segmentation: None,
///     frame: 0,
///     camera_id: usize::from(x > 0.0),
/// });
/// let cameras = views.each_ref().map(|view| view.camera.clone());
/// let points = vec![[0.0; 3], [0.5, 0.0, 0.0]];
/// let cloud = PointCloud { points, colors: vec![[0.5; 3]; 2], foreground: vec![true; 2] };
/// let mut config = TrainConfig::preset(Preset::D3dgs);
/// config.schedule.first_iterations = 3;
///
/// let mut trainer = Trainer::new(&config, &cloud, &cameras)?;
/// let mut losses = Vec::new();
/// trainer.fit(&views, &mut |progress| {
///     losses.push(progress.loss);
///     ControlFlow::Continue(())
/// })?;
/// assert_eq!((trainer.timesteps(), losses.len()), (1, 3));
/// # Ok::<(), tcgs_train::TrainError>(())
/// ```
#[derive(Debug)]
pub struct Trainer {
    config: TrainConfig,
    schedule: Schedule,
    scene_radius: f32,
    engine: Box<dyn Engine>,
    /// As in the engine's state, which may be far away.
    num_gaussians: usize,
    /// Timesteps finished.
    timestep: usize,
    camera_ids: Vec<usize>,
    /// Whether [`Self::fit`] ended within a timestep.
    is_unfinished: bool,
    /// What later timesteps train; none if they train everything.
    gate: Option<Gate>,
    trained: Trained,
    /// Whether the run continues another one's state, so that its first timestep is trained as a later one.
    continues: bool,
}

impl Trainer {
    /// Starts a run on the CPU, from one Gaussian per point.
    ///
    /// - `cloud`: initial points, positions in scene units, colours in `[0, 1]`
    /// - `cameras`: the cameras of the first timestep's training views, in the order of the views
    ///
    /// # Errors
    /// [`TrainError::Input`] if `cloud` or `cameras` is empty.
    pub fn new(config: &TrainConfig, cloud: &PointCloud, cameras: &[Camera]) -> Result<Self, TrainError> {
        Self::with_engine(config, cloud, cameras, |state| Box::new(CpuEngine::new(state)))
    }

    /// Starts a run on an engine of the caller's choice; otherwise as [`Self::new`].
    ///
    /// - `make`: makes the engine from the initial state
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_engine(
        config: &TrainConfig,
        cloud: &PointCloud,
        cameras: &[Camera],
        make: impl FnOnce(State) -> Box<dyn Engine>,
    ) -> Result<Self, TrainError> {
        if cloud.points.is_empty() {
            return Err(none("points of the initial cloud"));
        }
        let parameters = Parameters::from_cloud(cloud, cameras.len(), config.mask.initial_logit);
        Self::from_parameters(config, parameters, cameras, make)
    }

    /// Starts a run from existing Gaussians, of any layout.
    ///
    /// - `parameters`: the Gaussians in stored form, and one gain and offset for each of `cameras`
    /// - `cameras`, `make`: as for [`Self::with_engine`]
    ///
    /// # Errors
    /// [`TrainError::Input`] if there is no Gaussian or no camera.
    pub fn from_parameters(
        config: &TrainConfig,
        parameters: Parameters,
        cameras: &[Camera],
        make: impl FnOnce(State) -> Box<dyn Engine>,
    ) -> Result<Self, TrainError> {
        if parameters.num_gaussians() == 0 {
            return Err(none("Gaussians to start from"));
        }
        if cameras.is_empty() {
            return Err(none("training cameras"));
        }
        let radius = extent(cameras, parameters.gaussians.means());
        Ok(Self {
            config: config.clone(),
            schedule: Schedule::new(config, radius),
            scene_radius: radius,
            num_gaussians: parameters.num_gaussians(),
            engine: make(State::new(parameters)),
            timestep: 0,
            camera_ids: Vec::new(),
            is_unfinished: false,
            gate: gate(config, GateRecord::default()),
            trained: Trained::ALL,
            continues: false,
        })
    }

    /// Starts a run that continues the state of another one: its first timestep is trained as a later one, without
    /// density control, and the losses on motion compare with the neighbours in that state.
    ///
    /// - `start`: the state, with a gain and an offset for each training camera
    /// - `make`: makes the engine from the state
    pub fn continued(config: &TrainConfig, start: &Checkpoint, make: impl FnOnce(State) -> Box<dyn Engine>) -> Self {
        Self::restored(config, start, None, 0, true, make)
    }

    /// Resumes a run from its checkpoints. [`Run::resume_with`](crate::Run::resume_with) reads them from a run folder.
    ///
    /// - `first`, `before_last`, `last`: checkpoints of the first timestep and of the last two finished timesteps; with
    ///   one finished timestep all three are the same
    /// - `timesteps`: number of finished timesteps, at least 1
    /// - `make`: makes the engine from the resumed state
    pub fn resume(
        config: &TrainConfig,
        first: &Checkpoint,
        before_last: &Checkpoint,
        last: &Checkpoint,
        timesteps: usize,
        make: impl FnOnce(State) -> Box<dyn Engine>,
    ) -> Self {
        let past = (timesteps > 1).then_some((first, before_last));
        Self::restored(config, last, past, timesteps, false, make)
    }

    /// Resumes a run that began by [`Self::continued`]; otherwise as [`Self::resume`].
    ///
    /// - `start`: the state that the run began from
    /// - `before_last`, `last`: checkpoints of the last two finished timesteps; with one finished timestep the first of
    ///   them is `start`
    pub fn resume_continued(
        config: &TrainConfig,
        start: &Checkpoint,
        before_last: &Checkpoint,
        last: &Checkpoint,
        timesteps: usize,
        make: impl FnOnce(State) -> Box<dyn Engine>,
    ) -> Self {
        Self::restored(config, last, Some((start, before_last)), timesteps, true, make)
    }

    /// - `past`: where everything stood at first, and before `last`; none before the first motion
    fn restored(
        config: &TrainConfig,
        last: &Checkpoint,
        past: Option<(&Checkpoint, &Checkpoint)>,
        timesteps: usize,
        continues: bool,
        make: impl FnOnce(State) -> Box<dyn Engine>,
    ) -> Self {
        let mut state = State::new(last.parameters.clone());
        state.quantizers = last.quantizers.clone();
        state.lifetimes = last.lifetimes.clone();
        state.optimizer = last.optimizer.clone();
        state.timestep = timesteps.saturating_sub(1);
        state.past = past.map(|(first, before_last)| {
            let first = Pose::of(&first.parameters.gaussians);
            Past::new(first, before_last.parameters.gaussians.clone(), &state.parameters.foreground)
        });
        Self {
            config: config.clone(),
            schedule: Schedule::new(config, last.scene_radius),
            scene_radius: last.scene_radius,
            num_gaussians: state.parameters.num_gaussians(),
            engine: make(state),
            timestep: timesteps,
            camera_ids: Vec::new(),
            is_unfinished: false,
            gate: gate(config, last.gate.clone()),
            trained: Trained::ALL,
            continues,
        }
    }

    /// How the next timestep is trained.
    pub fn phase(&self) -> Phase {
        if self.continues { Phase::Rest } else { Phase::of(self.timestep) }
    }

    /// Number of finished timesteps.
    pub fn timesteps(&self) -> usize {
        self.timestep
    }

    /// Current number of Gaussians.
    pub fn num_gaussians(&self) -> usize {
        self.num_gaussians
    }

    /// The state of the optimisation, in the host's memory. A GPU engine first finishes and downloads its iterations.
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the engine failed.
    pub fn state(&mut self) -> Result<&State, TrainError> {
        self.engine.state()
    }

    /// How much of the scene and of its views the timestep that was finished last trained.
    pub fn trained(&self) -> Trained {
        self.trained
    }

    /// Whether a resumed run needs [`Self::recall`] to go on as if it had never stopped: whether its gate compares the
    /// next images with those before.
    pub fn needs_recall(&self) -> bool {
        self.timestep > 0 && self.gate.as_ref().is_some_and(Gate::forgot)
    }

    /// Takes the views of the timestep that was finished last, after a run was resumed. Without it the next timestep
    /// trains everything, which is slower and gives other bytes than a run that never stopped.
    ///
    /// - `views`: as [`Self::fit`] was given them for that timestep
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the engine failed.
    pub fn recall(&mut self, views: &[View]) -> Result<(), TrainError> {
        if let Some(gate) = &mut self.gate {
            gate.recall(self.engine.state()?, views, all_segmented(views));
        }
        Ok(())
    }

    /// Trains the next timestep on its views.
    ///
    /// - `views`: one view per training camera, in the same order at every timestep
    /// - `observe`: receives every iteration's report, and ends the training by [`ControlFlow::Break`]. The CPU engine
    ///   reports an iteration before the next one begins; the GPU engine reports up to 64 iterations later.
    ///
    /// A timestep is the unit of a run: a checkpoint holds the state between two timesteps, not the moments of Adam and
    /// the order of views that only matter within one. So a trainer that ended within a timestep, by
    /// `ControlFlow::Break` or by an error, gives no checkpoint and trains no further;
    /// [`Run::resume`](crate::Run::resume) goes on after the last finished timestep, with the same bytes as a run that
    /// was never stopped.
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
            if let Some(gate) = self.gate.as_mut().filter(|_| self.engine.takes_scenery()) {
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
                self.iterate(phase, cameras, pace, Shares::WHOLE, views, observe)?;
            }
        }
        if let Some(gate) = &mut self.gate {
            let state = self.engine.state()?;
            match &activity {
                Some(activity) => gate.end(state, views, activity),
                None => gate.begin(state, views, with_segmentation),
            }
        }
        self.end_timestep()
    }

    /// Trains what is active of a timestep, and leaves the whole state in the engine.
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
        self.iterate(Phase::Rest, activity.cameras.clone(), pace, shares, &[], observe)?;
        activity.put_back(self.engine.state()?, &mut whole);
        *self.engine.state_mut()? = whole;
        Ok(())
    }

    /// The iterations of a timestep.
    ///
    /// - `cameras`: positions of the views that they go round
    /// - `shares`: of the scene that the engine's state holds
    /// - `views`: all views, for what the first timestep does between iterations
    fn iterate(
        &mut self,
        phase: Phase,
        cameras: Vec<usize>,
        mut pace: Pace,
        shares: Shares,
        views: &[View],
        observe: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<(), TrainError> {
        let config = self.config.clone();
        let weights = shares.weights(&config.weights);
        let mut report = Report { iterations: pace.length(), shares, reported: 0 };
        let mut order = Vec::new();
        // One stream a timestep, so that resuming needs no saved state.
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
            if shares != Shares::WHOLE {
                // Quantizers are shared with what is locked.
                rates.step = 0.0;
            }
            let step = Step {
                camera,
                rates,
                weights: &weights,
                mask: &config.mask,
                counts_gradients: phase == Phase::First && self.schedule.counts_gradients(iteration),
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
            if phase == Phase::First {
                let seed = random.random();
                if reshapes {
                    self.reshape(iteration, seed)?;
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
        let (timestep, num_gaussians, iterations) = (self.timestep, self.num_gaussians, report.iterations);
        for terms in self.engine.losses()? {
            let iteration = report.reported;
            let terms = report.shares.terms(terms);
            if let Some(&(term, value, _)) = terms.terms(weights).iter().find(|t| !t.1.is_finite()) {
                return Err(TrainError::NotFinite { term: term.into(), value, timestep, iteration });
            }
            let loss = terms.total(weights);
            pace.hear(loss);
            report.reported += 1;
            if observe(&Progress { timestep, iteration, iterations, terms, loss, num_gaussians }).is_break() {
                return Err(TrainError::Stopped { timestep, iteration });
            }
        }
        Ok(())
    }

    /// Densifies, removes and resets where the schedule says so.
    fn reshape(&mut self, iteration: usize, seed: u64) -> Result<(), TrainError> {
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
            reset_opacities(state, self.config.densify.reset_opacity);
        }
        if self.schedule.prunes_masked(iteration) {
            let threshold = self.config.mask.threshold;
            let logits = &state.parameters.mask_logits;
            let keep: Vec<usize> = (0..logits.len()).filter(|&i| mask(logits[i], threshold) > 0.0).collect();
            if !keep.is_empty() && keep.len() < logits.len() {
                remove_others(state, &keep);
            }
        }
        // Until the first timestep is finished nobody is told apart.
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

    /// Predicts where what is trained goes, and prepares what the losses compare with.
    ///
    /// - `activity`: what the timestep trains; none for everything
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

    /// A Gaussian that is not finite is culled by the renderer, so that no loss tells.
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

    fn end_timestep(&mut self) -> Result<(), TrainError> {
        self.timestep += 1;
        self.is_unfinished = false;
        Ok(())
    }

    fn check_finished(&self) -> Result<(), TrainError> {
        if self.is_unfinished {
            return Err(TrainError::Input {
                what: format!("timestep {} of the trainer", self.timestep),
                found: "a timestep that ended half-way".into(),
                expected: "a trainer resumed from the last checkpoint".into(),
            });
        }
        Ok(())
    }

    /// The checkpoint of the timestep that [`Self::fit`] finished last.
    ///
    /// # Errors
    /// [`TrainError::Input`] if the last timestep was interrupted; [`TrainError::Gpu`] if the engine failed.
    pub fn checkpoint(&mut self) -> Result<Checkpoint, TrainError> {
        self.check_finished()?;
        let state = self.engine.state()?;
        Ok(Checkpoint {
            parameters: state.parameters.clone(),
            lifetimes: state.lifetimes.clone(),
            quantizers: state.quantizers.clone(),
            optimizer: state.optimizer.carried_over(),
            scene_radius: self.scene_radius,
            gate: self.gate.as_ref().map(|gate| gate.record().clone()).unwrap_or_default(),
        })
    }

    /// Mean PSNR in dB over views of the timestep that was finished last, with masks and quantisation applied. The
    /// learned gain and offset of a training camera are applied to the rendering of that camera.
    ///
    /// - `views`: training or test views; 0 dB is returned for no views
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the engine failed.
    pub fn mean_psnr(&mut self, views: &[View]) -> Result<f64, TrainError> {
        let mut sum = 0.0;
        for view in views {
            let mut image = self.engine.draw(&self.config.mask, &view.camera)?;
            if let Some(camera) = self.camera_ids.iter().position(|&id| id == view.camera_id) {
                let p = &self.engine.state()?.parameters;
                let (gain, offset) = (p.camera_gains[camera], p.camera_offsets[camera]);
                for channel in 0..3 {
                    for value in image.plane_mut(channel) {
                        *value = gain[channel].exp() * *value + offset[channel];
                    }
                }
            }
            sum += psnr(&image, &view.image);
        }
        Ok(sum / views.len().max(1) as f64)
    }
}

/// How far the reports of a timestep's iterations have come.
struct Report {
    /// Iterations of the timestep, if it takes all of them.
    iterations: usize,
    /// Of the scene that the engine's state holds.
    shares: Shares,
    /// Iterations whose losses are known.
    reported: usize,
}

fn gate(config: &TrainConfig, record: GateRecord) -> Option<Gate> {
    config.gate.enabled.then(|| Gate::new(&config.gate, &config.mask, record))
}

fn all_segmented(views: &[View]) -> bool {
    views.iter().all(|view| view.segmentation.is_some())
}

/// That something is missing.
fn none(what: &str) -> TrainError {
    TrainError::Input { what: what.into(), found: "none".into(), expected: "at least 1".into() }
}

/// The settings of a run's mixed-precision quantisation ([`TrainConfig::quantize`]) as the codec takes them.
pub fn bit_settings(config: &TrainConfig) -> BitSettings {
    let q = &config.quantize;
    BitSettings {
        min_bits: q.min_bits,
        max_bits: q.max_bits,
        mean_bits: q.mean_bits,
        position_bits: q.position_bits,
        mapping: match q.bit_map {
            BitMapKind::Log => BitMapping::Log,
            BitMapKind::Linear => BitMapping::Linear,
        },
    }
}

/// Which Gaussians of a checkpoint are not drawn: those whose mask (paper Eq. 1) is 0.
///
/// - `mask_logits`: `[N]`
/// - `threshold`: `ε`, in `[0, 1)`
/// - returns: `[N]`
pub fn masked_out(mask_logits: &[f32], threshold: f32) -> Vec<bool> {
    mask_logits.iter().map(|&m| mask(m, threshold) == 0.0).collect()
}

/// Mean over time of each Gaussian's mask value `σ(m_{n,t})`, paper Eq. 6.
///
/// - `mask_logits`: of every timestep `[N]`; taken one after another, so that none but the last has to be in memory
/// - returns: `[N]`, in (0, 1); empty of no timesteps
///
/// # Panics
/// If the timesteps have different numbers of Gaussians.
///
/// ```
/// assert_eq!(tcgs_train::mean_masks([vec![0.0, 40.0], vec![0.0, 40.0]]), [0.5, 1.0]);
/// ```
pub fn mean_masks<L: AsRef<[f32]>>(mask_logits: impl IntoIterator<Item = L>) -> Vec<f32> {
    let (mut sums, mut num_timesteps) = (Vec::new(), 0_usize);
    for logits in mask_logits {
        let logits = logits.as_ref();
        if num_timesteps == 0 {
            sums = vec![0.0; logits.len()];
        }
        assert_eq!(logits.len(), sums.len(), "mask logits: [{}] after [{}]", logits.len(), sums.len());
        sums.iter_mut().zip(logits).for_each(|(sum, &logit)| *sum += tcgs_core::sigmoid(logit));
        num_timesteps += 1;
    }
    sums.into_iter().map(|sum: f32| sum / num_timesteps as f32).collect()
}
