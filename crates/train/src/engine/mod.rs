//! What computes the iterations: the contract that every engine keeps, and what passes through it.
//!
//! What lives here: one iteration, and looking at its outcome. What does not: when something happens and
//! what happens between iterations; that is the trainer's, which changes the engine's [`State`].

pub mod cpu;
#[cfg(feature = "gpu")]
mod device;
#[cfg(feature = "gpu")]
pub mod gpu;

use std::fmt::Debug;

use tcgs_core::{Camera, Image, Sensitivity, View};
use tcgs_render::StageTimes;

use crate::TrainError;
use crate::config::MaskConfig;
use crate::losses::{LossTerms, WeightConfig};
use crate::schedule::Rates;
use crate::state::State;

/// What one image is compared with: three colour channels and, where the capture has masks, two of
/// segmentation (foreground, background).
#[derive(Clone, Debug)]
pub struct Target {
    /// Where it was taken from.
    pub camera: Camera,
    /// `[3 or 5, H, W]`
    pub image: Image,
}

impl Target {
    /// - `with_segmentation`: whether to compare the segmentation as well; the view must have one
    pub fn new(view: &View, with_segmentation: bool) -> Self {
        let mut image = view.image.clone();
        if let Some(segmentation) = view.segmentation.as_ref().filter(|_| with_segmentation) {
            image.num_channels = 5;
            image.data.extend(segmentation.foreground.iter().map(|&f| f32::from(u8::from(f))));
            image.data.extend(segmentation.foreground.iter().map(|&f| f32::from(u8::from(!f))));
        }
        Self { camera: view.camera.clone(), image }
    }
}

/// What one iteration is asked for.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// Position of the target in the timestep's list, and of its camera's gain and offset.
    pub camera: usize,
    /// Learning rates.
    pub rates: Rates,
    /// Weights of the losses.
    pub weights: &'a WeightConfig,
    /// Masks.
    pub mask: &'a MaskConfig,
    /// Whether to count gradients for densification.
    pub counts_gradients: bool,
    /// Whether Gaussians and masks move; cameras and quantizers always do. False where Gaussians are
    /// replaced right after: the new ones have no gradient.
    pub moves_gaussians: bool,
}

/// What computes. It may run behind: [`Self::step`] asks for an iteration, and what came of it is known
/// later. [`Self::state`] and whatever else looks at the outcome waits for it.
///
/// # Errors
/// Every call may fail with [`TrainError::Gpu`], also for what an earlier one asked for. The engine is then
/// of no further use. The one on the CPU never fails.
pub trait Engine: Send + Debug {
    /// What computes, for messages: `the CPU, 2 threads`.
    fn name(&self) -> String;

    /// Takes the images of a timestep, one a camera, in the order of the cameras' gains. The state has
    /// been brought to the timestep's start.
    fn begin(&mut self, targets: Vec<Target>) -> Result<(), TrainError>;

    /// One iteration: losses and gradients on one image, then the parameters move. It may return before
    /// it is computed.
    fn step(&mut self, step: &Step<'_>) -> Result<(), TrainError>;

    /// One iteration with a clock: what [`Self::step`] does, with the times of its stages. Waits for it and for all
    /// before it.
    ///
    /// Engines name the same work by the same names, but may run some of it together or in another order. Where a GPU
    /// has no timestamps there is one stage, `iteration`, by the clock of the CPU.
    fn profile(&mut self, step: &Step<'_>) -> Result<StageTimes, TrainError>;

    /// Losses of the iterations that have become known since this was last asked, in order.
    fn losses(&mut self) -> Result<Vec<LossTerms>, TrainError>;

    /// Waits until all iterations are computed: [`Self::losses`] is then complete.
    fn wait(&mut self) -> Result<(), TrainError>;

    /// The state after all iterations so far.
    fn state(&mut self) -> Result<&State, TrainError>;

    /// The same, to be changed; what comes next computes with the changes.
    fn state_mut(&mut self) -> Result<&mut State, TrainError>;

    /// How much each stored value moves the pictures, paper Eq. 7; see [`crate::sensitivity`].
    ///
    /// - `cameras`: one rendering each
    fn sensitivity(&mut self, cameras: &[Camera]) -> Result<Sensitivity, TrainError>;

    /// What the model draws now: quantised and masked, the colours alone, before a camera's gain and offset.
    ///
    /// - returns: `[3, H, W]`
    fn draw(&mut self, mask: &MaskConfig, camera: &Camera) -> Result<Image, TrainError>;
}
