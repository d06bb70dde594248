//! What a GPU says of itself, and how it fails: the same whatever interface it is reached through.

use std::convert::Infallible;

/// What an adapter says of itself.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GpuInfo {
    /// The adapter's name.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Vulkan, Metal, …
    pub backend: String,
    /// Whether it is a program on the CPU.
    pub is_software: bool,
    /// Optional features in use, by name.
    pub features: Vec<&'static str>,
}

/// Why a GPU cannot be used, or no longer.
#[derive(Clone, Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum GpuError {
    /// No adapter as wanted.
    #[error("no GPU {wanted}, found {found}")]
    NotFound {
        /// As asked for.
        wanted: String,
        /// All adapters there are.
        found: String,
    },
    /// The adapter cannot do what the shaders need.
    #[error("the GPU {name} {problem}")]
    Unfit {
        /// The adapter's name.
        name: String,
        /// What it lacks.
        problem: String,
    },
    /// A buffer is larger than the adapter allows, or than the memory left.
    #[error("{what} needs {bytes} bytes on the GPU, {problem}")]
    Memory {
        /// Which buffer.
        what: String,
        /// Its size.
        bytes: u64,
        /// The limit it meets.
        problem: String,
    },
    /// The driver gave up, or the device was removed.
    #[error("the GPU was lost: {0}")]
    Lost(String),
    /// A call was refused.
    #[error("the GPU refused a call: {0}")]
    Refused(String),
}

/// For renderers that are chosen while the program runs, some of which never fail.
impl From<Infallible> for GpuError {
    fn from(never: Infallible) -> Self {
        match never {}
    }
}
