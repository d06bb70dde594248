//! The command line, as users call it.

// Helpers of tests may unwrap, as tests may.
#![allow(clippy::unwrap_used)]

#[cfg(feature = "gpu")]
mod bench;
mod bounds;
mod chapters;
#[cfg(target_os = "linux")]
mod faults;
mod footage;
mod force;
mod foreign;
#[cfg(target_os = "linux")]
mod hostile;
mod interchange;
mod layouts;
mod make;
#[cfg(target_os = "linux")]
mod memory;
mod next;
mod params;
mod pipeline;
mod ply;
mod prepare;
mod raw;
mod recover;
#[cfg(feature = "gpu")]
mod refusals;
mod resume;
mod scenes;
mod support;
mod targets;
mod train_view;
mod verify;
#[cfg(unix)]
mod video;
mod view;
