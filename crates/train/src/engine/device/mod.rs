//! The parts of a device engine that depend on no device's interface. `packing` places a layout's columns in memory,
//! `step` is an iteration's request as `repr(C)`, `mirror` knows where the newest state is, and `in_flight` which
//! iterations are under way.
//!
//! [`super::gpu`] is the only engine on a device. Nothing here knows `wgpu`; the shaders' text is WGSL, since
//! [`tcgs_render::device::Wgsl`] composes it.

mod in_flight;
mod mirror;
mod neighbor_lists;
mod packing;
mod quantizer_lists;
mod scenery_lists;
mod step;

pub(crate) use in_flight::InFlight;
pub(crate) use mirror::Mirror;
pub(crate) use neighbor_lists::{NeighborLists, constants as neighbor_constants};
pub use packing::Packing;
pub(crate) use quantizer_lists::{QuantizerLists, quantizer_rows};
pub(crate) use scenery_lists::{ListedView, NO_SLOT, SceneryLists, target_word};
pub use step::StepUniform;
#[cfg(test)]
pub(crate) use step::adam_rates;
pub(crate) use step::{LOSS_VALUES, PartPlace, ViewPlace, count_updates, losses_of, source};
