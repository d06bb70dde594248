//! Description of a GPU, and its errors: the same for every interface to it.

use std::convert::Infallible;

/// An adapter's description of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GpuInfo {
    /// Name of the adapter.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Interface to the adapter: Vulkan, Metal, …
    pub backend: String,
    /// Whether the adapter is a program on the CPU, such as Mesa's lavapipe.
    pub is_software: bool,
    /// Names of the optional features in use.
    pub features: Vec<&'static str>,
}

/// Why a GPU cannot be used, or stopped working.
#[derive(Clone, Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter matches the caller's choice.
    #[error("no GPU {wanted}, found {found}")]
    NotFound {
        /// The caller's choice.
        wanted: String,
        /// Names of all adapters.
        found: String,
    },
    /// The adapter lacks a capability that the shaders need.
    #[error("the GPU {name} {problem}")]
    Unfit {
        /// Name of the adapter.
        name: String,
        /// The missing capability.
        problem: String,
    },
    /// A buffer exceeds the adapter's limit or the free memory.
    #[error("{what} needs {bytes} bytes on the GPU, {problem}")]
    Memory {
        /// Name of the buffer.
        what: String,
        /// Size of the buffer.
        bytes: u64,
        /// The limit that the size exceeds.
        problem: String,
    },
    /// The driver gave up, or the device was removed.
    #[error("the GPU was lost: {0}")]
    Lost(String),
    /// The GPU's interface refused a call: a mistake of this program, or of a driver.
    #[error("the GPU refused a call: {0}")]
    Refused(String),
}

/// For renderers chosen at run time, some of which never fail.
impl From<Infallible> for GpuError {
    fn from(never: Infallible) -> Self {
        match never {}
    }
}
