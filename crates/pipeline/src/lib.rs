//! From a capture to a compressed scene and its quality: what the command line does, for programs.
//!
//! What lives here: opening a scene of any kind ([`OpenScene`]), and the steps that need several crates at once. What
//! does not: arguments, progress bars and words for people (the command line), and the maths of each step (the crates
//! below).
//!
//! Every input that is wrong is a [`PipelineError`]; [`HasFault::fault`] says whether the input or the machine failed.

mod backend;
mod error;
mod observe;
mod scene;
mod train;

pub use backend::Backend;
pub use error::{Fault, HasFault, PipelineError};
pub use observe::{Event, Observer, Unobserved, Work};
pub use scene::{OpenScene, OpenSettings, SceneContent};
pub use train::{TimestepSummary, fit, new_trainer, settings_for};
