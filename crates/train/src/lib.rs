//! Training of dynamic Gaussians from multi-view images, one timestep after another.
//!
//! [`Trainer`] runs the optimisation; `population` adds and removes Gaussians; [`Run`] stores settings, checkpoints and
//! metrics in a folder; [`engine`] holds the two implementations of one iteration, CPU and GPU.
//!
//! What lives here: the optimiser's state, losses, schedule, population, masks, quantisation
//! inside the optimisation, run folders. What does not: captures (they come as
//! [`tcgs_core::View`]s), rendering, the file format.

mod adam;
mod checkpoint;
mod config;
mod dropout;
pub mod engine;
mod error;
mod fake_quant;
mod gate;
mod lifetimes;
mod losses;
mod mask;
mod motion;
mod neighbors;
mod parameters;
mod population;
mod refine;
mod row;
mod run;
mod schedule;
mod sensitivity;
mod solver;
mod sparsity;
mod stand_ins;
mod state;
mod trainer;

pub use adam::{Moments, adam};
pub use checkpoint::Checkpoint;
pub use config::{
    BirthConfig, BitMapKind, ColorConfig, ConfigError, DataConfig, DeathConfig, DensifyConfig, GateConfig, MaskConfig,
    Preset, QuantizeConfig, REFERENCE_ITERATIONS, RateConfig, RenderConfig, ScheduleConfig, TrainConfig,
};
pub use dropout::Dropout;
pub use error::TrainError;
pub use fake_quant::{FakeQuantizers, bit_settings, fake_quant, fake_quant_vjp, step_gradient_scale};
pub use gate::{GateRecord, Trained};
pub use lifetimes::Lifetimes;
pub use losses::{Loss, LossTerms, WeightConfig};
pub use mask::{mask, mask_consistency_loss, mask_loss, mask_vjp, masked_out, mean_masks};
pub use motion::{Past, Pose, predict};
pub use neighbors::{NEIGHBOR_FALLOFF, NUM_NEIGHBORS, Neighbors};
pub use parameters::{Parameters, scene_radius};
pub use population::{
    Densified, DensifyStep, Needed, Removal, TimestepViews, are_in_images, densify, judge_stride, needed,
    remove_others, reset_opacities,
};
pub use refine::{RefineConfig, Refiner, refine_order};
pub use row::Row;
pub use run::{Run, TrainedScene};
pub use schedule::{Phase, Rates, Schedule};
pub use sensitivity::sensitivity;
pub use solver::{Glimpse, Glimpsed, Progress};
pub use sparsity::view_sparsity;
pub use stand_ins::StandIns;
pub use state::{GradientStatistic, Optimizer, State};
pub use trainer::Trainer;
