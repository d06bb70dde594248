//! A training run in progress: its start, its resumption, and its storage. What does not live here: a timestep
//! (`timestep`), its iterations (`solver`), the number of Gaussians (`population`), and the computation of an iteration
//! (`engine`).

mod timestep;

use std::sync::Arc;

use tcgs_core::{Camera, Layout, PointCloud, View};
use tcgs_metrics::psnr;

use crate::TrainError;
use crate::checkpoint::Checkpoint;
use crate::config::TrainConfig;
use crate::engine::cpu::CpuEngine;
use crate::engine::{Engine, Target};
use crate::gate::{Gate, GateRecord, Trained};
use crate::motion::{Past, Pose};
use crate::parameters::{Parameters, extent};
use crate::population::{self, Population};
use crate::schedule::Phase;
use crate::solver::{Glimpse, Solver};
use crate::state::State;

/// A training run in progress: settings, schedule, population, and an engine with the state after the last finished
/// timestep.
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
    /// The engine, and the iterations on it.
    solver: Solver,
    /// Adds and removes Gaussians.
    population: Population,
    /// Finds what later timesteps train; none if they train everything.
    gate: Option<Gate>,
    scene_radius: f32,
    camera_ids: Vec<usize>,
    /// Whether [`Self::fit`] ended within a timestep.
    is_unfinished: bool,
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

    /// Starts a run on an engine of the caller's choice; otherwise as [`Self::new`]. The Gaussians carry spherical
    /// harmonics up to `color.degree`, which begin at 0, and are antialiased if `render.antialiased` is set.
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
        let (cloud, num_fixed) = population::initial_points(config, cloud, cameras);
        let mut parameters = Parameters::from_cloud(&cloud, cameras.len(), config.mask.initial_logit);
        let layout = Layout::with_harmonics(config.color.degree).antialiased(config.render.antialiased);
        parameters.gaussians = std::mem::take(&mut parameters.gaussians).extended(&layout);
        population::keep_out(&mut parameters.gaussians, num_fixed, cameras);
        let mut trainer = Self::begun(config, parameters, num_fixed, cameras, make)?;
        trainer.population.keep_clear(cameras, &cloud.points);
        Ok(trainer)
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
        Self::begun(config, parameters, 0, cameras, make)
    }

    /// - `num_fixed`: number of Gaussians, the last ones, that the first timestep does not train
    fn begun(
        config: &TrainConfig,
        parameters: Parameters,
        num_fixed: usize,
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
        let num_gaussians = parameters.num_gaussians();
        let engine = make(State { num_fixed, ..State::new(parameters) });
        Ok(Self {
            solver: Solver::new(config, radius, engine, num_gaussians, 0),
            population: Population::new(config, radius, Vec::new()),
            gate: gate(config, GateRecord::default()),
            scene_radius: radius,
            camera_ids: Vec::new(),
            is_unfinished: false,
            continues: false,
        })
    }

    /// Starts a run that continues the state of another one. Its first timestep is trained as a later one, without
    /// density control. The losses on motion compare with the neighbours in that state.
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
    ///
    /// # Panics
    /// If the checkpoints are not of one run, so that a Gaussian that lives on is missing before.
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
    ///
    /// # Panics
    /// As [`Self::resume`].
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

    /// - `past`: the first checkpoint, and the one before `last`; none before the first motion
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
        state.past = past.map(|(first, before_last)| past_of(first, before_last, last));
        let num_gaussians = state.parameters.num_gaussians();
        let (radius, engine) = (last.scene_radius, make(state));
        Self {
            solver: Solver::new(config, radius, engine, num_gaussians, timesteps),
            // Chapters of one scene have the same Gaussians.
            population: match continues {
                true => Population::closed(config, radius),
                false => Population::new(config, radius, last.unseen.clone()),
            },
            gate: gate(config, last.gate.clone()),
            scene_radius: radius,
            camera_ids: Vec::new(),
            is_unfinished: false,
            continues,
        }
    }

    /// Sets the colour behind all Gaussians, black without it. `render.background` asks the caller to do so, with the
    /// colour of the images' borders.
    ///
    /// - `background`: red, green and blue, sRGB of 255
    ///
    /// # Errors
    /// [`TrainError::Input`] after the first timestep, and if the run continues another one's state;
    /// [`TrainError::Gpu`] if the engine failed.
    pub fn set_background(&mut self, background: [u8; 3]) -> Result<(), TrainError> {
        if self.phase() != Phase::First {
            return Err(TrainError::Input {
                what: "the background".into(),
                found: format!("a new one at timestep {}", self.timesteps()),
                expected: "one before the first timestep".into(),
            });
        }
        let gaussians = &mut self.solver.engine.state_mut()?.parameters.gaussians;
        *gaussians = std::mem::take(gaussians).with_background(background);
        Ok(())
    }

    /// The phase of the next timestep.
    pub fn phase(&self) -> Phase {
        if self.continues { Phase::Rest } else { Phase::of(self.solver.timestep) }
    }

    /// Number of finished timesteps.
    pub fn timesteps(&self) -> usize {
        self.solver.timestep
    }

    /// Current number of Gaussians.
    pub fn num_gaussians(&self) -> usize {
        self.solver.num_gaussians()
    }

    /// The state of the optimisation, in the host's memory. A GPU engine first finishes and downloads its iterations.
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the engine failed.
    pub fn state(&mut self) -> Result<&State, TrainError> {
        self.solver.engine.state()
    }

    /// Shows the scene between iterations to threads that ask `glimpse`.
    pub fn show_to(&mut self, glimpse: Arc<Glimpse>) {
        self.solver.glimpse = Some(glimpse);
    }

    /// The trained share of the scene and of its views at the last finished timestep.
    pub fn trained(&self) -> Trained {
        self.solver.trained
    }

    /// Whether a resumed run needs [`Self::recall`] to go on as if it had never stopped: its gate then compares the
    /// next images with the previous ones.
    pub fn needs_recall(&self) -> bool {
        self.solver.timestep > 0 && self.gate.as_ref().is_some_and(Gate::forgot)
    }

    /// Takes the views of the last finished timestep, after a run was resumed. Without them the next timestep trains
    /// everything, which is slower and gives other bytes than an uninterrupted run.
    ///
    /// - `views`: those that [`Self::fit`] was given for that timestep
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the engine failed.
    pub fn recall(&mut self, views: &[View]) -> Result<(), TrainError> {
        if let Some(gate) = &mut self.gate {
            gate.recall(self.solver.engine.state()?, Target::of_all(views));
        }
        Ok(())
    }

    fn check_finished(&self) -> Result<(), TrainError> {
        if self.is_unfinished {
            return Err(TrainError::Input {
                what: format!("timestep {} of the trainer", self.solver.timestep),
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
        let state = self.solver.engine.state()?;
        Ok(Checkpoint {
            parameters: state.parameters.clone(),
            lifetimes: state.lifetimes.clone(),
            quantizers: state.quantizers.clone(),
            optimizer: state.optimizer.carried_over(),
            scene_radius: self.scene_radius,
            gate: self.gate.as_ref().map(|gate| gate.record().clone()).unwrap_or_default(),
            unseen: self.population.unseen().to_vec(),
            born: state.born(),
        })
    }

    /// Mean PSNR in dB over views of the last finished timestep, with masks and quantisation applied. The learned gain
    /// and offset of a training camera are applied to the rendering of that camera.
    ///
    /// - `views`: training or test views; 0 dB is returned for no views
    ///
    /// # Errors
    /// [`TrainError::Gpu`] if the engine failed.
    pub fn mean_psnr(&mut self, views: &[View]) -> Result<f64, TrainError> {
        let mut sum = 0.0;
        for view in views {
            let mut image = self.solver.engine.draw(&self.solver.config.mask, &view.camera)?;
            if let Some(camera) = self.camera_ids.iter().position(|&id| id == view.camera_id) {
                image = self.solver.engine.state()?.parameters.seen_by_camera(camera, image);
            }
            sum += psnr(&image, &view.image);
        }
        Ok(sum / views.len().max(1) as f64)
    }
}

/// The past of a resumed state. Gaussians born after the first timestep join it in groups born together.
fn past_of(first: &Checkpoint, before_last: &Checkpoint, last: &Checkpoint) -> Past {
    let (now, ids) = (&last.parameters, &last.lifetimes.ids);
    let rows_of = |of: &Checkpoint, ids: &[u32]| -> Option<Vec<usize>> {
        ids.iter().map(|id| of.lifetimes.ids.binary_search(id).ok()).collect()
    };
    let num_first = ids.partition_point(|&id| (id as usize) < first.lifetimes.lives.len());
    let select = |of: &Checkpoint, ids: &[u32]| rows_of(of, ids).map(|rows| of.parameters.gaussians.select(&rows));
    let known = "who lives on was there before";
    let of_first = Pose::of(&select(first, &ids[..num_first]).expect(known));
    let previous = select(before_last, &ids[..num_first]).expect(known);
    let mut past = Past::new(of_first, previous, &now.foreground[..num_first]);
    for together in last.lifetimes.births()[num_first..].chunk_by(|a, b| a == b) {
        let begin = past.first.means.len();
        let all = begin..begin + together.len();
        let born = last.born.range(begin - num_first..all.end - num_first);
        // Gaussians born at the last timestep have not moved yet.
        let previous = select(before_last, &ids[all.clone()])
            .unwrap_or_else(|| now.gaussians.select(&all.clone().collect::<Vec<_>>()));
        past.append(&born, &previous, &now.foreground[all]);
    }
    past
}

/// The gate of a run; none if it is off.
fn gate(config: &TrainConfig, record: GateRecord) -> Option<Gate> {
    config.gate.enabled.then(|| Gate::new(&config.gate, &config.mask, record))
}

/// An error for a missing input.
fn none(what: &str) -> TrainError {
    TrainError::Input { what: what.into(), found: "none".into(), expected: "at least 1".into() }
}
