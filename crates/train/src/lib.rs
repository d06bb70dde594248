//! Training of dynamic Gaussians from multi-view images, one timestep after another.
//!
//! [`Trainer`] runs the optimisation; [`Run`] stores its settings, checkpoints and metrics in a folder; [`engine`]
//! holds the two implementations of one iteration, CPU and GPU.
//!
//! What lives here: the optimiser's state, losses, schedule, density control, masks, quantisation
//! inside the optimisation, run folders. What does not: captures (they come as
//! [`tcgs_core::View`]s), rendering, the file format.

mod adam;
mod checkpoint;
mod config;
mod densify;
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
mod refine;
mod removal;
mod row;
mod run;
mod schedule;
mod sensitivity;
mod stand_ins;
mod state;
mod trainer;
mod unseen;

pub use adam::{Moments, adam};
pub use checkpoint::Checkpoint;
pub use config::{
    BirthConfig, BitMapKind, ColorConfig, ConfigError, DataConfig, DeathConfig, DensifyConfig, GateConfig, MaskConfig,
    Preset, QuantizeConfig, REFERENCE_ITERATIONS, RateConfig, RenderConfig, ScheduleConfig, TrainConfig,
};
pub use densify::{Densified, DensifyStep, densify, remove_others, reset_opacities};
pub use error::TrainError;
pub use fake_quant::{FakeQuantizers, bit_settings, fake_quant, fake_quant_vjp, step_gradient_scale};
pub use gate::{GateRecord, Trained};
pub use lifetimes::Lifetimes;
pub use losses::{Loss, LossTerms, WeightConfig};
pub use mask::{mask, mask_consistency_loss, mask_loss, mask_vjp, masked_out, mean_masks};
pub use motion::{Past, Pose, predict};
pub use neighbors::{NEIGHBOR_FALLOFF, NUM_NEIGHBORS, Neighbors};
pub use parameters::{Parameters, scene_radius};
pub use refine::{RefineConfig, Refiner, refine_order};
pub use removal::{Removal, TimestepViews, judge_stride, needed};
pub use row::Row;
pub use run::{Run, TrainedScene};
pub use schedule::{Phase, Rates, Schedule};
pub use sensitivity::sensitivity;
pub use stand_ins::StandIns;
pub use state::{GradientStatistic, Optimizer, State};
pub use trainer::{Glimpse, Glimpsed, Progress, Trainer};
pub use unseen::are_in_images;
