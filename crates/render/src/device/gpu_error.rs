//! What a GPU says of itself, and how it fails: the same whatever interface it is reached through.

use std::convert::Infallible;

/// What an adapter says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GpuInfo {
    /// Name of the adapter.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Interface through which the adapter is reached: Vulkan, Metal, …
    pub backend: String,
    /// Whether the adapter is a program on the CPU, such as Mesa's lavapipe.
    pub is_software: bool,
    /// Names of the optional features in use.
    pub features: Vec<&'static str>,
}

/// Why a GPU cannot be used, or no longer.
#[derive(Clone, Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum GpuError {
    /// There is no adapter as the caller wants it.
    #[error("no GPU {wanted}, found {found}")]
    NotFound {
        /// What the caller asked for.
        wanted: String,
        /// Names of all adapters that there are.
        found: String,
    },
    /// The adapter cannot do what the shaders need.
    #[error("the GPU {name} {problem}")]
    Unfit {
        /// Name of the adapter.
        name: String,
        /// What the adapter lacks.
        problem: String,
    },
    /// A buffer is larger than the adapter allows, or than the memory left.
    #[error("{what} needs {bytes} bytes on the GPU, {problem}")]
    Memory {
        /// Which buffer.
        what: String,
        /// Size of the buffer.
        bytes: u64,
        /// The limit that the size meets.
        problem: String,
    },
    /// The driver gave up, or the device was removed.
    #[error("the GPU was lost: {0}")]
    Lost(String),
    /// The GPU's interface refused a call: a mistake of this program, or of a driver.
    #[error("the GPU refused a call: {0}")]
    Refused(String),
}

/// For renderers that are chosen while the program runs, some of which never fail.
impl From<Infallible> for GpuError {
    fn from(never: Infallible) -> Self {
        match never {}
    }
}
