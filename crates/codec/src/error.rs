//! Why bytes are no scene, and why floats cannot become one.

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

/// Why a scene cannot be compressed or written, by which argument is at fault.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CompressError {
    /// A number is outside what is legal for it, or not finite.
    #[error("invalid {what}: found {found}, expected {expected}")]
    Value {
        /// Which number.
        what: &'static str,
        /// The number.
        found: f64,
        /// What is legal.
        expected: &'static str,
    },
    /// A value of a Gaussian is not finite, or negative where it must not be.
    #[error("invalid {what} of Gaussian {gaussian}{}: found {found}, expected {expected}", at(*.timestep))]
    Gaussian {
        /// Which values: the name of an attribute, or what belongs to each Gaussian of it.
        what: String,
        /// Index of the Gaussian.
        gaussian: usize,
        /// At which timestep, where the values belong to one.
        timestep: Option<usize>,
        /// The value.
        found: f64,
        /// What is legal.
        expected: &'static str,
    },
    /// Two arguments disagree in a count.
    #[error("invalid number of {what}: found {found}, expected {expected}")]
    Count {
        /// What is counted.
        what: String,
        /// In the one argument.
        found: usize,
        /// By the other, or by what the format holds at most.
        expected: usize,
    },
    /// A step, an offset and a width that make no quantizer.
    #[error("invalid quantizer of step {step}, offset {offset} and {bits} bits: {problem}")]
    Quantizer {
        /// Units of the attribute.
        step: f32,
        /// Units of the attribute.
        offset: f32,
        /// Width of a code.
        bits: u8,
        /// What is wrong with them.
        problem: &'static str,
    },
    /// A [`CompactScene`](crate::CompactScene) breaks a rule of the format.
    #[error("invalid {field} in {section}: {problem}")]
    Scene {
        /// The name of an attribute, or `info`.
        section: &'static str,
        /// What in it.
        field: &'static str,
        /// What was found against what was expected.
        problem: &'static str,
    },
    /// A timestep cannot be read.
    #[error("cannot read timestep {timestep}: {error}")]
    Read {
        /// Which one.
        timestep: usize,
        /// Why.
        error: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A timestep has other columns than the scene.
    #[error("invalid columns at timestep {timestep}: found {found}, expected {expected}")]
    Layout {
        /// Which one.
        timestep: usize,
        /// Its columns.
        found: String,
        /// Those of the scene.
        expected: String,
    },
    /// The format does not hold a column of the scene.
    #[error("format {version} holds means, quats, log_scales, logit_opacities and colors; found {found}")]
    Unsupported {
        /// Of the format.
        version: u16,
        /// Name of the column.
        found: String,
    },
    /// The file cannot be written.
    #[error("write failed")]
    Io(#[from] std::io::Error),
}

fn at(timestep: Option<usize>) -> String {
    timestep.map_or(String::new(), |timestep| format!(" at timestep {timestep}"))
}
