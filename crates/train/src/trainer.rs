//! The loop: timesteps, iterations, and what happens between them.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tcgs_codec::{BitMapping, BitSettings, assign_bits};
use tcgs_core::{Attribute, Camera, PointCloud, View};
use tcgs_metrics::psnr;
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};

use crate::TrainError;
use crate::checkpoint::Checkpoint;
use crate::config::{BitMapKind, TrainConfig};
use crate::densify::{DensifyStep, densify, remove_others, reset_opacities};
use crate::engine::cpu::{
    CpuEngine, FakeQuantizers, LossTerms, MotionPrior, Neighbors, Optimizer, Step, Target, predict,
};
use crate::parameters::{Parameters, scene_radius};
use crate::schedule::{Phase, Schedule};
use crate::sensitivity::sensitivity;

/// What a caller hears of every iteration.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Counted from the run's first.
    pub timestep: usize,
    /// Within the timestep, from 0.
    pub iteration: usize,
    /// Iterations of this timestep.
    pub iterations: usize,
    /// Losses.
    pub terms: LossTerms,
    /// Weighted sum of the losses.
    pub loss: f64,
    /// Gaussians now.
    pub num_gaussians: usize,
}

/// Means and rotations of one timestep.
type Pose = (Vec<[f32; 3]>, Vec<[f32; 4]>);

/// A run in progress: the state after some timesteps.
#[derive(Debug)]
pub struct Trainer {
    config: TrainConfig,
    schedule: Schedule,
    scene_radius: f32,
    engine: CpuEngine,
    /// Timesteps finished.
    timestep: usize,
    /// Of the first timestep.
    first: Option<Pose>,
    /// Of the timestep before the last.
    before: Option<Pose>,
    neighbors: Option<Neighbors<f32>>,
    camera_ids: Vec<usize>,
}

impl Trainer {
    /// Starts a run.
    ///
    /// - `cameras`: of the first timestep's training views, in their order
    ///
    /// # Errors
    /// [`TrainError::Input`] if there are no points or cameras.
    pub fn new(config: &TrainConfig, cloud: &PointCloud, cameras: &[Camera]) -> Result<Self, TrainError> {
        let input = |what: &str, expected: &str| TrainError::Input {
            what: what.into(),
            found: "none".into(),
            expected: expected.into(),
        };
        if cloud.points.is_empty() {
            return Err(input("points of the initial cloud", "at least 1"));
        }
        if cameras.is_empty() {
            return Err(input("training cameras", "at least 1"));
        }
        let radius = match scene_radius(cameras) {
            // Cameras at one place say nothing of the scene's extent.
            0.0 => distance_to_points(&cameras[0], cloud),
            radius => radius,
        };
        let parameters = Parameters::from_cloud(cloud, cameras.len(), config.mask.initial_logit);
        Ok(Self {
            config: config.clone(),
            schedule: Schedule::new(config, radius),
            scene_radius: radius,
            engine: CpuEngine::new(parameters),
            timestep: 0,
            first: None,
            before: None,
            neighbors: None,
            camera_ids: Vec::new(),
        })
    }

    /// Goes on after the checkpoints of a run.
    ///
    /// - `first`, `before_last`, `last`: of the first timestep, and of the last two finished; with one
    ///   timestep finished all three are the same
    /// - `timesteps`: finished, at least 1
    pub fn resume(
        config: &TrainConfig,
        first: &Checkpoint,
        before_last: &Checkpoint,
        last: &Checkpoint,
        timesteps: usize,
    ) -> Self {
        let place = |c: &Checkpoint| (c.parameters.gaussians.means.clone(), c.parameters.gaussians.quats.clone());
        let mut engine = CpuEngine::new(last.parameters.clone());
        engine.quantizers = last.quantizers.clone();
        engine.optimizer = Optimizer::new(&engine.parameters, 0);
        let [mean, quat, mask] = last.steps;
        let [color, steps, offsets] = last.kept_moments.clone();
        engine.optimizer.attributes[Attribute::Mean.index()].step = mean;
        engine.optimizer.attributes[Attribute::Quat.index()].step = quat;
        engine.optimizer.mask.step = mask;
        engine.optimizer.attributes[Attribute::Color.index()] = color;
        engine.optimizer.quantizer_steps = steps;
        engine.optimizer.quantizer_offsets = offsets;
        Self {
            config: config.clone(),
            schedule: Schedule::new(config, first.scene_radius),
            scene_radius: first.scene_radius,
            engine,
            timestep: timesteps,
            first: Some(place(first)),
            before: Some(place(before_last)),
            neighbors: None,
            camera_ids: Vec::new(),
        }
    }

    /// Timesteps finished.
    pub fn timesteps(&self) -> usize {
        self.timestep
    }

    /// The optimisation's state.
    pub fn engine(&self) -> &CpuEngine {
        &self.engine
    }

    /// Trains the next timestep on its views.
    ///
    /// # Errors
    /// [`TrainError::NotFinite`] if a loss is; [`TrainError::Input`] if there are no views, or another
    /// number of cameras than at the first timestep.
    pub fn fit(&mut self, views: &[View], progress: &mut dyn FnMut(&Progress)) -> Result<(), TrainError> {
        let num_cameras = self.engine.parameters.camera_gains.len();
        if views.len() != num_cameras {
            return Err(TrainError::Input {
                what: format!("training views of timestep {}", self.timestep),
                found: views.len().to_string(),
                expected: format!("{num_cameras}, as at the first"),
            });
        }
        self.camera_ids = views.iter().map(|v| v.camera_id).collect();
        let with_segmentation = views.iter().all(|v| v.segmentation.is_some());
        let targets: Vec<Target> = views.iter().map(|v| Target::new(v, with_segmentation)).collect();
        let phase = Phase::of(self.timestep);
        if phase == Phase::Rest {
            self.begin_timestep();
        }
        let iterations = self.schedule.iterations(phase);
        let config = self.config.clone();
        let mut order = Vec::new();
        // One stream a timestep, so that resuming needs no saved state.
        let mut random =
            Pcg64Mcg::seed_from_u64(self.config.seed ^ (self.timestep as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15));
        for iteration in 0..iterations {
            if phase == Phase::First && self.schedule.starts_quantization(iteration) {
                self.start_quantization(&targets);
            }
            if order.is_empty() {
                order = (0..targets.len()).collect();
            }
            let camera = order.swap_remove(random.random_range(0..order.len()));
            let step = Step {
                camera,
                rates: self.schedule.rates(phase, iteration),
                weights: &config.weights,
                mask: &config.mask,
                counts_gradients: phase == Phase::First && self.schedule.counts_gradients(iteration),
            };
            let (terms, grads) = self.engine.forward_backward(&targets[camera], &step);
            if let Some(&(term, value, _)) = terms.terms(&config.weights).iter().find(|t| !t.1.is_finite()) {
                return Err(TrainError::NotFinite { term, value, timestep: self.timestep, iteration });
            }
            let reshaped = phase == Phase::First && self.reshape(iteration, random.random());
            self.engine.update(&grads, &step, !reshaped);
            progress(&Progress {
                timestep: self.timestep,
                iteration,
                iterations,
                terms,
                loss: terms.total(&config.weights),
                num_gaussians: self.engine.parameters.num_gaussians(),
            });
        }
        self.check_finite(iterations)?;
        self.end_timestep();
        Ok(())
    }

    /// Densifies, removes and resets where the schedule says so; returns whether the Gaussians changed
    /// shape, so that this iteration's gradients no longer fit.
    fn reshape(&mut self, iteration: usize, seed: u64) -> bool {
        let mut reshaped = false;
        if self.schedule.densifies(iteration) {
            let step = DensifyStep {
                config: &self.config.densify,
                scene_radius: self.scene_radius,
                last: self.schedule.is_last_densification(iteration),
                removes_large: self.schedule.removes_large(iteration),
                seed,
            };
            densify(&mut self.engine, &step);
            reshaped = true;
        }
        if self.schedule.resets_opacities(iteration) {
            reset_opacities(&mut self.engine, self.config.densify.reset_opacity);
            reshaped = true;
        }
        if self.schedule.prunes_masked(iteration) {
            let threshold = self.config.mask.threshold;
            let logits = &self.engine.parameters.mask_logits;
            let keep: Vec<usize> =
                (0..logits.len()).filter(|&i| crate::engine::cpu::mask(logits[i], threshold) > 0.0).collect();
            if !keep.is_empty() && keep.len() < logits.len() {
                remove_others(&mut self.engine, &keep);
                reshaped = true;
            }
        }
        reshaped
    }

    fn start_quantization(&mut self, targets: &[Target]) {
        let cameras: Vec<Camera> = targets.iter().map(|t| t.camera.clone()).collect();
        self.engine.canonicalize_quats();
        let gaussians = &self.engine.parameters.gaussians;
        let bit_map = assign_bits(&sensitivity(gaussians, &cameras), gaussians, &bit_settings(&self.config));
        let quantizers = FakeQuantizers::new(bit_map, gaussians, self.config.quantize.learned_offset);
        self.engine.start_quantization(quantizers);
    }

    /// Predicts where everything goes, and prepares what the losses compare with.
    fn begin_timestep(&mut self) {
        let (first_means, first_quats) = self.first.clone().expect("a first timestep is finished");
        let p = &mut self.engine.parameters;
        let neighbors = self.neighbors.take().unwrap_or_else(|| Neighbors::new(&first_means, &p.foreground));
        let g = &mut p.gaussians;
        self.engine.prior =
            Some(MotionPrior::new(neighbors, &p.foreground, &first_means, &first_quats, &g.means, &g.quats, &g.colors));
        let now = (g.means.clone(), g.quats.clone());
        let (means_before, quats_before) = self.before.take().unwrap_or_else(|| now.clone());
        for i in 0..g.means.len() {
            (g.means[i], g.quats[i]) = predict(g.means[i], means_before[i], g.quats[i], quats_before[i]);
        }
        self.before = Some(now);
        if self.config.mask.enabled {
            // Paper Eq. 5 compares with the timestep before.
            self.engine.previous_mask_logits = Some(p.mask_logits.clone());
            if self.config.mask.reset {
                p.mask_logits.fill(self.config.mask.initial_logit);
            }
        }
        let o = &mut self.engine.optimizer;
        for attribute in [Attribute::Mean, Attribute::Quat] {
            o.attributes[attribute.index()].clear(self.config.rates.reset_steps);
        }
        o.mask.clear(self.config.rates.reset_steps);
    }

    /// A Gaussian that is not finite is culled by the renderer, so that no loss tells.
    fn check_finite(&self, iteration: usize) -> Result<(), TrainError> {
        for attribute in Attribute::ALL {
            let values = self.engine.parameters.gaussians.values(attribute);
            if let Some(value) = values.iter().find(|x| !x.is_finite()) {
                let (term, value) = (attribute.name(), f64::from(*value));
                return Err(TrainError::NotFinite { term, value, timestep: self.timestep, iteration });
            }
        }
        Ok(())
    }

    fn end_timestep(&mut self) {
        if let Some(prior) = self.engine.prior.take() {
            self.neighbors = Some(prior.into_neighbors());
        }
        let g = &self.engine.parameters.gaussians;
        if self.timestep == 0 {
            self.first = Some((g.means.clone(), g.quats.clone()));
            // No motion is known yet.
            self.before = Some((g.means.clone(), g.quats.clone()));
        }
        self.timestep += 1;
    }

    /// What is to be remembered of the timestep just finished.
    pub fn checkpoint(&self) -> Checkpoint {
        let o = &self.engine.optimizer;
        let [mean, quat, _, _, color] = &o.attributes;
        Checkpoint {
            parameters: self.engine.parameters.clone(),
            quantizers: self.engine.quantizers.clone(),
            kept_moments: [color.clone(), o.quantizer_steps.clone(), o.quantizer_offsets.clone()],
            steps: [mean.step, quat.step, o.mask.step],
            scene_radius: self.scene_radius,
        }
    }

    /// Mean PSNR over views of the timestep just finished, masks and quantisation applied, in dB. A
    /// training camera's own gain and offset apply to it.
    pub fn mean_psnr(&self, views: &[View]) -> f64 {
        let drawn = self.engine.drawn(&self.config.mask, false);
        let sum: f64 = views
            .iter()
            .map(|view| {
                let (mut output, _) = CpuRasterizer.forward(&drawn, &view.camera, &RenderSettings::default());
                if let Some(camera) = self.camera_ids.iter().position(|&id| id == view.camera_id) {
                    let (gain, offset) =
                        (self.engine.parameters.camera_gains[camera], self.engine.parameters.camera_offsets[camera]);
                    for channel in 0..3 {
                        for value in output.image.plane_mut(channel) {
                            *value = gain[channel].exp() * *value + offset[channel];
                        }
                    }
                }
                psnr(&output.image, &view.image)
            })
            .sum();
        sum / views.len().max(1) as f64
    }
}

/// Root mean squared distance of a camera to the points, scene units.
fn distance_to_points(camera: &Camera, cloud: &PointCloud) -> f32 {
    let center = camera.center();
    let squared = |p: &[f32; 3]| (0..3).map(|i| (f64::from(p[i]) - center[i]).powi(2)).sum::<f64>();
    (cloud.points.iter().map(squared).sum::<f64>() / cloud.points.len() as f64).sqrt() as f32
}

/// A run's settings in the codec's words.
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
    mask_logits.iter().map(|&m| crate::engine::cpu::mask(m, threshold) == 0.0).collect()
}

/// Mean over time of each Gaussian's mask value `σ(m_{n,t})`, paper Eq. 6.
///
/// - `mask_logits`: `[T][N]`
/// - returns: `[N]`, in (0, 1)
///
/// ```
/// assert_eq!(tcgs_train::mean_masks(&[vec![0.0, 40.0], vec![0.0, 40.0]]), [0.5, 1.0]);
/// ```
pub fn mean_masks(mask_logits: &[Vec<f32>]) -> Vec<f32> {
    let n = mask_logits.first().map_or(0, Vec::len);
    (0..n)
        .map(|i| mask_logits.iter().map(|m| tcgs_core::sigmoid(m[i])).sum::<f32>() / mask_logits.len() as f32)
        .collect()
}
