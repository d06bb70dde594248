//! The schedule: numbers of iterations, learning rates and the start of quantisation, as functions of timestep and
//! iteration. What does not live here: when Gaussians are added and removed (`population`).

use tcgs_core::{Column, RateGroup};

use crate::adam::EPSILON;
use crate::config::{REFERENCE_ITERATIONS, TrainConfig};
use crate::dropout::Dropout;

/// Learning rate of the young for columns that are constant over time, relative to that of the newborn. These columns
/// also change how the timesteps since their birth look.
const YOUTH_RATE: f32 = 0.5;

/// Learning rates of one iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Rate of the means, in scene units.
    pub mean: f32,
    /// Rate of the stored quaternions.
    pub quat: f32,
    /// Rate of the colours.
    pub color: f32,
    /// Rate of colours that do not vary with time: the coefficients of spherical harmonics.
    pub harmonic: f32,
    /// Adam's ε of all colours.
    pub color_epsilon: f32,
    /// Rate of the logit opacities; 0 in [`Phase::Rest`].
    pub logit_opacity: f32,
    /// Rate of the log scales; 0 in [`Phase::Rest`].
    pub log_scale: f32,
    /// Rate of the cameras' gains and offsets; 0 after the first timestep.
    pub camera: f32,
    /// Whether the cameras' gains and offsets are centered after they moved.
    pub centers_cameras: bool,
    /// Rate of the mask logits.
    pub mask: f32,
    /// Rate of the quantizers' steps and offsets, as a multiple of each quantizer's initial step.
    pub step: f32,
    /// Whether columns that do not vary with time are learned: false in [`Phase::Rest`].
    pub moves_constants: bool,
}

impl Rates {
    /// The learning rate of a column; 0 if it is constant over time and already learned.
    pub fn of(&self, column: &Column) -> f32 {
        if !column.varies && !self.moves_constants {
            return 0.0;
        }
        match column.rate {
            RateGroup::Mean => self.mean,
            RateGroup::Quat => self.quat,
            RateGroup::LogScale => self.log_scale,
            RateGroup::LogitOpacity => self.logit_opacity,
            RateGroup::Color if column.varies => self.color,
            RateGroup::Color => self.harmonic,
        }
    }

    /// Adam's ε of a column.
    pub(crate) fn epsilon_of(&self, column: &Column) -> f32 {
        if column.rate == RateGroup::Color { self.color_epsilon } else { EPSILON }
    }
}

/// The phases of a run: the first timestep, all later timesteps, and after these the training of newborn and young.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Phase {
    /// The first timestep: all columns are learned, and density control adds and removes Gaussians.
    First,
    /// A later timestep: only the columns that vary with time are learned.
    Rest,
    /// After a later timestep: those born at it learn all columns, alone.
    Birth,
    /// After a later timestep: those born at the timesteps just before it learn all columns, alone.
    Youth,
}

impl Phase {
    /// The phase of a timestep, counted from the run's first.
    pub fn of(timestep: usize) -> Self {
        if timestep == 0 { Self::First } else { Self::Rest }
    }
}

/// The schedule of a configuration: the reference's events and rates, scaled to the configuration's numbers of
/// iterations.
#[derive(Clone, Debug)]
pub struct Schedule {
    config: TrainConfig,
    scene_radius: f32,
}

impl Schedule {
    /// The schedule of a run.
    ///
    /// - `scene_radius`: scene units, by which the rate of the means is multiplied; see [`crate::scene_radius`]
    pub fn new(config: &TrainConfig, scene_radius: f32) -> Self {
        Self { config: config.clone(), scene_radius }
    }

    /// Number of iterations of a timestep. The newborn take as many before they are divided, and again after it.
    pub fn iterations(&self, phase: Phase) -> usize {
        match phase {
            Phase::First => self.config.schedule.first_iterations,
            Phase::Rest => self.config.schedule.rest_iterations,
            Phase::Birth if self.config.births.gradient_threshold > 0.0 => self.config.births.iterations.div_ceil(2),
            Phase::Birth | Phase::Youth => self.config.births.iterations,
        }
    }

    /// Reference iterations / actual iterations.
    fn shortening(&self, phase: Phase) -> f32 {
        // Newborn Gaussians learn what the first timestep taught the others.
        let reference = REFERENCE_ITERATIONS[usize::from(phase == Phase::Rest)];
        reference as f32 / self.iterations(phase) as f32
    }

    /// The iteration of this schedule's first timestep that corresponds to an iteration of the reference's.
    pub fn scaled(&self, reference_iteration: usize) -> usize {
        (reference_iteration as f64 * self.iterations(Phase::First) as f64 / REFERENCE_ITERATIONS[0] as f64).round()
            as usize
    }

    /// The learning rates of an iteration.
    ///
    /// - `iteration`: within the timestep, from 0
    pub fn rates(&self, phase: Phase, iteration: usize) -> Rates {
        let r = &self.config.rates;
        let progress = iteration as f32 / self.iterations(phase) as f32;
        let cosine = |end: f32| cosine(end, progress);
        let mask = r.mask * self.shortening(phase);
        let mean = r.mean * self.scene_radius;
        match phase {
            Phase::First | Phase::Birth | Phase::Youth => {
                let constant = if phase == Phase::Youth { YOUTH_RATE } else { 1.0 };
                let scale = if r.first_scale == 0.0 { self.shortening(phase).sqrt() } else { r.first_scale };
                let decay = cosine(r.first_decay);
                Rates {
                    mean: mean * scale * decay,
                    quat: r.quat * scale * decay,
                    color: r.color * decay,
                    harmonic: r.harmonic * decay * constant,
                    color_epsilon: EPSILON,
                    logit_opacity: r.logit_opacity * decay * constant,
                    log_scale: r.log_scale * scale * decay * constant,
                    // All Gaussians share the cameras.
                    camera: if phase == Phase::First { r.camera * scale * decay } else { 0.0 },
                    centers_cameras: r.camera_centered,
                    // The timesteps to come vote on which Gaussians are needed.
                    mask: if phase == Phase::First { mask } else { 0.0 },
                    step: r.step * decay,
                    moves_constants: true,
                }
            }
            Phase::Rest => {
                let scale = if r.motion_scale == 0.0 { self.shortening(phase).max(1.0) } else { r.motion_scale };
                // Decays towards `motion_decay` times the initial rate.
                let motion = scale * cosine(r.motion_decay);
                Rates {
                    mean: mean * motion,
                    quat: r.quat * motion,
                    color: r.color_rest * cosine(r.motion_decay),
                    harmonic: 0.0,
                    color_epsilon: EPSILON,
                    logit_opacity: 0.0,
                    log_scale: 0.0,
                    camera: 0.0,
                    centers_cameras: r.camera_centered,
                    mask,
                    step: r.step * cosine(r.motion_decay),
                    moves_constants: false,
                }
            }
        }
    }

    /// The dropout of an iteration. In the first timestep of sparse views the share rises linearly; else it is 0.
    ///
    /// - `sparsity`: of the views ([`view_sparsity`](crate::view_sparsity))
    pub fn dropout(&self, phase: Phase, iteration: usize, sparsity: f32) -> Dropout {
        if phase != Phase::First || sparsity == 0.0 {
            return Dropout::default();
        }
        let progress = iteration as f32 / self.iterations(phase) as f32;
        Dropout { share: sparsity * self.config.densify.dropout * progress, draw: iteration as u32 }
    }

    /// Adam's ε of the colours: [`EPSILON`], but larger in the first timestep of sparse views. A gradient of any size
    /// makes whole steps of Adam, and a Gaussian that hardly shows would take any colour.
    ///
    /// - `sparsity`: of the views ([`view_sparsity`](crate::view_sparsity))
    /// - `num_pixels`: of an image, over whose three channels the loss is a mean
    pub(crate) fn color_epsilon(&self, phase: Phase, sparsity: f32, num_pixels: usize) -> f32 {
        let damping = if phase == Phase::First { sparsity * self.config.rates.color_damping } else { 0.0 };
        EPSILON.max(damping / (3 * num_pixels) as f32)
    }

    /// Whether quantisation starts at this iteration.
    pub fn starts_quantization(&self, iteration: usize) -> bool {
        self.config.quantize.enabled
            && iteration == self.scaled(self.config.quantize.start).min(self.iterations(Phase::First) - 1)
    }
}

/// Half a cosine from 1 to `end`.
///
/// - `progress`: 0 to 1
pub(crate) fn cosine(end: f32, progress: f32) -> f32 {
    end + (1.0 - end) * 0.5 * (1.0 + (std::f32::consts::PI * progress).cos())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Preset;

    fn schedule(first: usize, rest: usize, preset: Preset) -> Schedule {
        let mut config = TrainConfig::preset(preset);
        config.schedule.first_iterations = first;
        config.schedule.rest_iterations = rest;
        Schedule::new(&config, 2.0)
    }

    #[test]
    fn the_reference_schedule_is_the_reference() {
        let s = schedule(10_000, 2_000, Preset::D3dgs);
        let rates = s.rates(Phase::First, 9000);
        assert_eq!((rates.mean, rates.color, rates.quat), (3.2e-4, 2.5e-3, 1e-3));
        assert_eq!(s.rates(Phase::Rest, 1999).mean, 3.2e-4);
        assert_eq!((s.rates(Phase::Rest, 0).log_scale, s.rates(Phase::Rest, 0).mask), (0.0, 0.01));
    }

    #[test]
    fn a_short_schedule_scales() {
        let s = schedule(1500, 300, Preset::Default);
        assert!(s.starts_quantization(900));
        assert!((s.rates(Phase::First, 0).mask - 0.01 * 10.0 / 1.5).abs() < 1e-6);
        assert!((s.rates(Phase::Rest, 0).mean - 3.2e-4 * 20.0 / 3.0).abs() < 1e-8);
        assert_eq!(s.dropout(Phase::First, 750, 1.0), Dropout { share: 0.2, draw: 750 });
        assert_eq!(s.dropout(Phase::First, 750, 0.5), Dropout { share: 0.1, draw: 750 });
        for (phase, sparsity) in [(Phase::First, 0.0), (Phase::Rest, 1.0), (Phase::Birth, 1.0)] {
            assert_eq!(s.dropout(phase, 100, sparsity), Dropout::default());
            assert_eq!(s.color_epsilon(phase, sparsity, 1000), EPSILON);
        }
        assert_eq!(s.color_epsilon(Phase::First, 1.0, 1000), 0.3 / 3000.0);
        assert!(s.rates(Phase::Rest, 299).mean < 0.05 * s.rates(Phase::Rest, 0).mean);
    }
}
