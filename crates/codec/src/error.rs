//! Why bytes are no scene.

/// Why decoding failed, by who is at fault.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The reader.
    #[error("read failed")]
    Io(#[from] std::io::Error),
    /// The file.
    #[error("invalid {field} in {section} at byte {offset}: {problem}")]
    Format {
        /// Part of the file.
        section: &'static str,
        /// What in it.
        field: &'static str,
        /// Where in the file; of what lies in a compressed stream, where that part starts.
        offset: u64,
        /// What was found against what was expected.
        problem: &'static str,
    },
    /// A newer file than this decoder.
    #[error("invalid version in header at byte 4: found {found}, expected {expected}")]
    Version {
        /// The file's.
        found: u16,
        /// The only one known.
        expected: u16,
    },
    /// Our policy.
    #[error("{what} needs {needed} {unit}, limit is {limit}")]
    Limit {
        /// What is too large.
        what: &'static str,
        /// What is counted: `bytes`, `Gaussians` or `timesteps`.
        unit: &'static str,
        /// By the file.
        needed: u64,
        /// By [`crate::DecodeLimits`].
        limit: u64,
    },
}
