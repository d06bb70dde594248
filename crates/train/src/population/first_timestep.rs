//! The first timestep: when Gaussians are cloned, split, removed and reset, and by which rule.
//!
//! Constants count iterations of the reference's schedule and scale with the run's ([`Schedule::scaled`]).

use tcgs_core::{Gaussians, Pinhole, View, distance};

use super::densify::{DensifyStep, densify, remove_others, reset_opacities};
use super::free_space::FreeSpace;
use super::removal::{Needed, Removal, TimestepViews, needed};
use crate::config::TrainConfig;
use crate::mask::{mask, masked_out};
use crate::schedule::{Phase, Schedule};
use crate::solver::Asked;
use crate::state::State;

/// Iteration of the last densification. Reference.
pub(crate) const DENSIFY_END: usize = 5000;

/// Iterations between removals of masked Gaussians. Compact-3DGS.
pub(crate) const MASK_PRUNE_INTERVAL: usize = 1000;

/// Number of times that Gaussians are removed that the training images hardly need.
const NUM_PRUNINGS: usize = 3;

/// Fewest iterations of a first timestep that makes up for the error of such a removal. Not scaled.
const RECOVERY: f32 = 1000.0;

/// Factor of the error that a removal may add if training views are sparse: their images are fitted more closely than
/// the scene. A fifth of the Gaussians is not missed.
const SPARSE_SHARE: f32 = 3.0;

/// Largest share of the Gaussians that one removal by error takes. The others need iterations to take over.
const MOST_REMOVED: f32 = 0.4;

/// Least opacity, as its logit, of what only cameras around the training cameras show, and of what stands in no image.
/// A wall of points at the initial opacity of 0.5 shows what lies behind it.
const OPAQUE: f32 = 3.0;

/// Growth of the scales of what only cameras around show, at each removal, as its logarithm. It closes gaps. Gaussians
/// in no image do not grow: they may stand close to other cameras, and would veil them.
const GROWTH: f32 = 0.3;

/// Largest scale of a Gaussian, in spacings of as many Gaussians that lie evenly in all directions around the nearest
/// camera. Larger ones veil whole pictures.
const LARGEST: f32 = 16.0;

/// The rules of the first timestep.
#[derive(Clone, Debug)]
pub(super) struct FirstTimestep {
    config: TrainConfig,
    schedule: Schedule,
    scene_radius: f32,
    /// The space around the training cameras.
    pub free_space: FreeSpace,
}

impl FirstTimestep {
    /// - `scene_radius`: scene units, to which scales are compared
    pub fn new(config: &TrainConfig, scene_radius: f32) -> Self {
        let schedule = Schedule::new(config, scene_radius);
        Self { config: config.clone(), schedule, scene_radius, free_space: FreeSpace::default() }
    }

    /// Asks for a statistic of gradients until the last densification. Gaussians do not move in an iteration before a
    /// reshaping: new Gaussians have no gradient.
    pub fn asks(&self, iteration: usize) -> Asked {
        Asked { counts_gradients: self.counts_gradients(iteration), moves_gaussians: !self.reshapes(iteration) }
    }

    /// Whether Gaussians are replaced, removed or reset after this iteration.
    pub fn reshapes(&self, iteration: usize) -> bool {
        self.densifies(iteration)
            || self.resets_opacities(iteration)
            || self.prunes_masked(iteration)
            || self.prunes_unneeded(iteration)
            || self.bounds_scales(iteration)
    }

    /// Densifies, resets and removes after an iteration.
    ///
    /// - `seed`: of the random choices
    /// - `sparsity`: of the views
    pub fn reshape(&self, state: &mut State, iteration: usize, seed: u64, views: &[View], sparsity: f32) {
        if self.densifies(iteration) {
            let step = DensifyStep {
                config: &self.config.densify,
                scene_radius: self.scene_radius,
                last: self.is_last_densification(iteration),
                removes_large: self.removes_large(iteration),
                seed,
            };
            densify(state, &step);
        }
        if self.resets_opacities(iteration) {
            reset_opacities(state);
        }
        if self.prunes_masked(iteration) {
            let threshold = self.config.mask.threshold;
            let logits = &state.parameters.mask_logits;
            let keep: Vec<usize> = (0..logits.len()).filter(|&i| mask(logits[i], threshold) > 0.0).collect();
            if !keep.is_empty() && keep.len() < logits.len() {
                remove_others(state, &keep);
            }
        }
        if self.prunes_unneeded(iteration) {
            let threshold = if self.config.mask.enabled { self.config.mask.threshold } else { -1.0 };
            let is_hidden = masked_out(&state.parameters.mask_logits, threshold);
            let timestep = TimestepViews {
                gaussians: &state.parameters.gaussians,
                is_hidden: &is_hidden,
                views,
                corrections: &state.parameters.corrections(),
            };
            let removal = Removal { share: self.prune_error(sparsity), most: MOST_REMOVED, costs: None, seed };
            let Needed { rows, around } = needed(&[timestep], &removal);
            let num_trained = state.num_trained();
            let fixed = num_trained..state.parameters.num_gaussians();
            let v = state.parameters.gaussians.views_mut();
            for &i in around.iter().filter(|&&i| i < num_trained) {
                v.log_scales[i].iter_mut().for_each(|log_scale| *log_scale += GROWTH);
            }
            for i in around.into_iter().chain(fixed) {
                v.logit_opacities[i] = v.logit_opacities[i].max(OPAQUE);
            }
            remove_others(state, &rows);
        }
        if self.bounds_scales(iteration) || self.prunes_unneeded(iteration) {
            self.clear_space(state);
            bound_scales(&mut state.parameters.gaussians, views);
        }
        // Identities matter only once the first timestep is finished.
        state.number_anew();
    }

    /// Removes trained Gaussians in the space around cameras. If all stand there, all stay.
    fn clear_space(&self, state: &mut State) {
        let num_trained = state.num_trained();
        let is_held = self.free_space.holds(state.parameters.gaussians.means());
        let keep: Vec<usize> = (0..is_held.len()).filter(|&i| i >= num_trained || !is_held[i]).collect();
        if !keep.is_empty() && keep.len() < is_held.len() {
            remove_others(state, &keep);
        }
    }

    /// Whether gradients count for densification: until the last one.
    fn counts_gradients(&self, iteration: usize) -> bool {
        iteration <= self.schedule.scaled(DENSIFY_END)
    }

    /// Whether Gaussians are cloned, split and removed after this iteration.
    fn densifies(&self, iteration: usize) -> bool {
        let d = &self.config.densify;
        iteration >= self.schedule.scaled(d.start)
            && self.counts_gradients(iteration)
            && iteration > 0
            && iteration.is_multiple_of(d.interval)
    }

    /// Whether this is the last densification, which removes far more.
    fn is_last_densification(&self, iteration: usize) -> bool {
        self.densifies(iteration) && iteration + self.config.densify.interval > self.schedule.scaled(DENSIFY_END)
    }

    /// Whether large Gaussians are removed by now.
    fn removes_large(&self, iteration: usize) -> bool {
        let from = self.config.densify.prune_large;
        from > 0 && iteration >= self.schedule.scaled(from)
    }

    /// Whether opacities are reset after this iteration. A schedule without a whole interval between reset and last
    /// event has no reset: Gaussians that have not recovered by then would be removed.
    fn resets_opacities(&self, iteration: usize) -> bool {
        let d = &self.config.densify;
        let reset = self.schedule.scaled(d.reset);
        let recovers = self.schedule.scaled(DENSIFY_END) >= reset + d.interval;
        d.reset > 0 && iteration > 0 && iteration == reset && recovers
    }

    /// Whether scales are bounded after this iteration.
    fn bounds_scales(&self, iteration: usize) -> bool {
        let interval = self.config.densify.interval;
        self.config.densify.prune_error > 0.0 && iteration > 0 && iteration.is_multiple_of(interval)
    }

    /// Whether masked Gaussians are removed after this iteration.
    fn prunes_masked(&self, iteration: usize) -> bool {
        let interval = self.schedule.scaled(MASK_PRUNE_INTERVAL).max(1);
        let ended = iteration > self.schedule.scaled(self.config.mask.prune_end);
        self.config.mask.enabled && iteration > 0 && iteration.is_multiple_of(interval) && !ended
    }

    /// Share by which each removal of Gaussians that the images hardly need may increase the squared error. A schedule
    /// too short to make up for the error has a smaller share, one of sparse views a larger share.
    fn prune_error(&self, sparsity: f32) -> f32 {
        let iterations = self.schedule.iterations(Phase::First) as f32;
        let sparse = 1.0 + sparsity * (SPARSE_SHARE - 1.0);
        self.config.densify.prune_error * (iterations / RECOVERY).min(1.0) * sparse
    }

    /// Whether Gaussians that the training images hardly need are removed after this iteration.
    fn prunes_unneeded(&self, iteration: usize) -> bool {
        let span = self.config.quantize.start.saturating_sub(DENSIFY_END);
        let is_due = |event| iteration == self.schedule.scaled(DENSIFY_END + event * span / (NUM_PRUNINGS + 1));
        self.config.densify.prune_error > 0.0 && iteration > 0 && (1..=NUM_PRUNINGS).any(is_due)
    }
}

/// The largest scale of one of so many Gaussians, as a share of its distance from the nearest camera.
fn largest_share(num_gaussians: usize) -> f32 {
    LARGEST * (4.0 * std::f32::consts::PI / num_gaussians as f32).sqrt()
}

/// Bounds the scales of all Gaussians by their number and by their distances from the nearest camera.
fn bound_scales(gaussians: &mut Gaussians, views: &[View]) {
    let centers: Vec<[f32; 3]> = views.iter().map(|view| Pinhole::<f32>::new(&view.camera).center).collect();
    let share = largest_share(gaussians.num_gaussians());
    let v = gaussians.views_mut();
    for (log_scale, &mean) in v.log_scales.iter_mut().zip(v.means.iter()) {
        let nearest = centers.iter().map(|&center| distance(center, mean)).fold(f32::INFINITY, f32::min);
        let most = (share * nearest).ln();
        *log_scale = log_scale.map(|s| s.min(most));
    }
}

#[cfg(test)]
mod tests {
    use tcgs_core::{BaseColumns, Camera, Gaussians, Image};

    use super::*;
    use crate::config::Preset;
    use crate::parameters::Parameters;

    fn first_timestep(iterations: usize, preset: Preset) -> FirstTimestep {
        let mut config = TrainConfig::preset(preset);
        config.schedule.first_iterations = iterations;
        FirstTimestep::new(&config, 2.0)
    }

    #[test]
    fn the_events_of_the_reference_are_the_reference() {
        let s = first_timestep(10_000, Preset::D3dgs);
        let events: Vec<usize> = (0..10_000).filter(|&i| s.densifies(i)).collect();
        assert_eq!((events[0], events[1], events[events.len() - 1]), (500, 600, 5000));
        assert_eq!((0..10_000).filter(|&i| s.is_last_densification(i)).collect::<Vec<_>>(), [5000]);
        assert_eq!((0..10_000).filter(|&i| s.resets_opacities(i)).collect::<Vec<_>>(), [3000]);
    }

    #[test]
    fn a_short_first_timestep_keeps_the_interval_and_scales_the_rest() {
        let s = first_timestep(1500, Preset::Default);
        let events: Vec<usize> = (0..1500).filter(|&i| s.densifies(i)).collect();
        assert_eq!(events, [100, 200, 300, 400, 500, 600, 700]);
        assert!(s.is_last_densification(700) && !s.is_last_densification(600));
        assert_eq!((0..1500).filter(|&i| s.prunes_unneeded(i)).collect::<Vec<_>>(), [788, 825, 863]);
        let short = first_timestep(60, Preset::Fast);
        assert_eq!([s.prune_error(0.0), s.prune_error(1.0), short.prune_error(0.0)], [1.0, 3.0, 0.06]);
        assert!((0..1500).all(|i| !s.resets_opacities(i) && !s.removes_large(i) && !s.prunes_masked(i)));
        let (long, short) = (first_timestep(1500, Preset::Paper), first_timestep(250, Preset::Paper));
        assert!(long.resets_opacities(450) && long.removes_large(450) && long.reshapes(450));
        assert!(long.prunes_masked(150) && (0..1500).all(|i| !long.prunes_unneeded(i)));
        assert!((0..250).all(|i| !short.resets_opacities(i)));
        assert!(s.reshapes(100) && s.reshapes(825) && s.reshapes(900) && !s.reshapes(1050));
        assert!(s.reshapes(1400) && !long.reshapes(1400), "scales are bounded until the end, where the preset does");
    }

    /// The state of these Gaussians, of which the last is not trained.
    fn state_of(gaussians: Gaussians) -> State {
        let count = gaussians.num_gaussians();
        let mut state = State::new(Parameters {
            gaussians,
            mask_logits: vec![1.0; count],
            foreground: vec![true; count],
            camera_gains: vec![[0.0; 3]; 2],
            camera_offsets: vec![[0.0; 3]; 2],
        });
        state.num_fixed = 1;
        state
    }

    fn two_views() -> [View; 2] {
        [-2.0, 2.0].map(|x| {
            let camera = Camera::look_at([x, 0.0, -4.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], 60.0, 72, 54);
            View { image: Image::filled(72, 54, 3, 0.5), camera, segmentation: None, frame: 0, camera_id: 0 }
        })
    }

    #[test]
    fn what_no_image_shows_becomes_opaque() {
        // Each camera has one of the first two before the third; the fourth stands beside the images.
        let gaussians = Gaussians::from(BaseColumns {
            means: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 4.0], [50.0, 0.0, 0.0]],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 4],
            log_scales: vec![[-0.7; 3], [-0.7; 3], [-2.5; 3], [-1.0; 3]],
            logit_opacities: vec![9.0, 2.0, 0.0, 0.0],
            colors: vec![[0.9, 0.3, 0.2], [0.2, 0.5, 0.9], [0.9, 0.8, 0.3], [0.5; 3]],
        });
        let views = two_views();
        let mut state = state_of(gaussians);
        let rules = first_timestep(1500, Preset::Default);
        rules.reshape(&mut state, 789, 0, &views, 0.0);
        assert_eq!(state.parameters.gaussians.logit_opacities(), [9.0, 2.0, 0.0, 0.0], "no event");
        rules.reshape(&mut state, 788, 0, &views, 0.0);
        assert_eq!(state.parameters.gaussians.logit_opacities(), [9.0, 2.0, OPAQUE, OPAQUE]);
        let log_scales = [[-0.7; 3], [-0.7; 3], [-2.5 + GROWTH; 3], [-1.0; 3]];
        assert_eq!(state.parameters.gaussians.log_scales(), log_scales);
        state.parameters.gaussians.log_scales_mut()[3] = [-1.0, 9.0, 2.0];
        rules.reshape(&mut state, 900, 0, &views, 0.0);
        let distance = (48.0_f32 * 48.0 + 16.0).sqrt();
        assert_eq!(state.parameters.gaussians.log_scales()[3], [-1.0, (largest_share(4) * distance).ln(), 2.0]);
    }

    #[test]
    fn the_space_around_cameras_is_cleared() {
        let near = [2.0, 0.5, -3.0];
        let gaussians = Gaussians::from(BaseColumns {
            means: vec![[-1.0, 0.0, 0.0], near, [0.0, 0.0, 4.0], near],
            quats: vec![[1.0, 0.0, 0.0, 0.0]; 4],
            log_scales: vec![[-2.0; 3]; 4],
            logit_opacities: vec![2.0; 4],
            colors: vec![[0.5; 3]; 4],
        });
        let views = two_views();
        let cameras = [views[0].camera.clone(), views[1].camera.clone()];
        let mut state = state_of(gaussians);
        let mut rules = first_timestep(1500, Preset::Default);
        rules.free_space = FreeSpace::around(&cameras, &[[0.0, 0.0, 2.0]]);
        rules.reshape(&mut state, 950, 0, &views, 0.0);
        assert_eq!(state.parameters.num_gaussians(), 4, "no event");
        rules.reshape(&mut state, 1000, 0, &views, 0.0);
        let means = [[-1.0, 0.0, 0.0], [0.0, 0.0, 4.0], near];
        assert_eq!(state.parameters.gaussians.means(), means, "fixed ones stay");
        rules.free_space = FreeSpace::around(&cameras, &[[0.0, 0.0, 40.0]]);
        state.num_fixed = 0;
        rules.reshape(&mut state, 1100, 0, &views, 0.0);
        assert_eq!(state.parameters.num_gaussians(), 3, "never all of them");
    }
}
