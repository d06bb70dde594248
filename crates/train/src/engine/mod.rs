//! Engines, which compute the iterations: the trait that every engine implements, and its inputs.
//!
//! What lives here: the interface to one iteration and to its results. What does not: the schedule and the events
//! between iterations; the trainer owns both, and changes the engine's [`State`].

pub mod cpu;
#[cfg(feature = "gpu")]
mod device;
#[cfg(feature = "gpu")]
pub mod gpu;
mod look;
mod scenery;

pub use look::LookRenderer;
pub use scenery::{Scenery, ViewScenery};

use std::fmt::Debug;
use std::sync::Arc;

use tcgs_core::{Camera, Image, Sensitivity, View};
use tcgs_render::StageTimes;

use crate::TrainError;
use crate::config::MaskConfig;
use crate::dropout::Dropout;
use crate::losses::{LossTerms, WeightConfig};
use crate::schedule::Rates;
use crate::state::State;

/// The training image that a rendering is compared with: three colour channels and, where the capture has masks, two of
/// segmentation (foreground, background).
#[derive(Clone, Debug)]
pub struct Target {
    /// The camera that took the image.
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

    /// The targets of a timestep's views, with segmentation if all views have one.
    pub(crate) fn of_all(views: &[View]) -> Arc<[Self]> {
        let with_segmentation = all_segmented(views);
        views.iter().map(|view| Self::new(view, with_segmentation)).collect()
    }
}

pub(crate) fn all_segmented(views: &[View]) -> bool {
    views.iter().all(|view| view.segmentation.is_some())
}

/// The inputs of one iteration.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// Position of the target in the timestep's list, and of its camera's gain and offset.
    pub camera: usize,
    /// The learning rates of this iteration.
    pub rates: Rates,
    /// The weights of the losses.
    pub weights: &'a WeightConfig,
    /// The settings of the learned masks.
    pub mask: &'a MaskConfig,
    /// Whether to count gradients for densification.
    pub counts_gradients: bool,
    /// The Gaussians that are left out; none where a part of the scene is trained.
    pub dropout: Dropout,
    /// Whether Gaussians and masks move; cameras and quantizers always do. False where Gaussians are
    /// replaced right after: the new ones have no gradient.
    pub moves_gaussians: bool,
}

/// Computes the iterations of a run on one device. An engine may be asynchronous: [`Self::step`] submits an iteration,
/// and its losses become known later. [`Self::state`] and every other method that reads results waits for all submitted
/// iterations.
///
/// # Errors
/// Every call that returns a result may fail with [`TrainError::Gpu`], also because of an iteration that an earlier
/// call submitted. The engine must not be used after an error. The CPU engine never fails.
pub trait Engine: Send + Debug {
    /// Name of the device, for messages: `the CPU, 2 threads`.
    fn name(&self) -> String;

    /// Takes the images of a timestep, one per camera, in the order of the cameras' gains. The state is already at the
    /// timestep's start.
    ///
    /// - `scenery`: everything that is drawn around the state, if the state holds only the rows of a timestep; none if
    ///   it holds the whole scene
    fn begin(&mut self, targets: Arc<[Target]>, scenery: Option<Scenery>) -> Result<(), TrainError>;

    /// Ends a timestep, or a part of one. The engine may free its images and scenery: no iteration follows before
    /// [`Self::begin`].
    fn end(&mut self);

    /// Computes or submits one iteration: losses and gradients on one image, then one update of the parameters. May
    /// return before the iteration is computed.
    fn step(&mut self, step: &Step<'_>) -> Result<(), TrainError>;

    /// One iteration with a clock: as [`Self::step`], with the times of its stages. Waits for it and for all before it.
    ///
    /// Engines use the same names for the same work, but may run some of it together or in another order. A GPU without
    /// timestamps reports one stage, `iteration`, by the clock of the CPU.
    fn profile(&mut self, step: &Step<'_>) -> Result<StageTimes, TrainError>;

    /// The losses that have become known since the last call of this method, in the order of the iterations.
    fn losses(&mut self) -> Result<Vec<LossTerms>, TrainError>;

    /// Waits until all iterations are computed: [`Self::losses`] is then complete.
    fn wait(&mut self) -> Result<(), TrainError>;

    /// The state after all submitted iterations.
    fn state(&mut self) -> Result<&State, TrainError>;

    /// The state after all submitted iterations, mutable; later iterations compute with the changes.
    fn state_mut(&mut self) -> Result<&mut State, TrainError>;

    /// How much each stored value moves the pictures, paper Eq. 7; see [`crate::sensitivity`].
    ///
    /// - `cameras`: one rendering each
    fn sensitivity(&mut self, cameras: &[Camera]) -> Result<Sensitivity, TrainError>;

    /// Draws for the gate's look, on the engine's device.
    fn look_renderer(&self) -> Arc<dyn LookRenderer>;

    /// Renders the current state: quantised and masked, colours alone, without the gain and offset of a training
    /// camera.
    ///
    /// - returns: `[3, H, W]`
    fn draw(&mut self, mask: &MaskConfig, camera: &Camera) -> Result<Image, TrainError>;
}
