//! Errors of both directions: [`DecodeError`] for bytes that are not a scene, [`CompressError`] for scenes and settings
//! that cannot become bytes.
//!
//! A caller's mistake in an argument that no file controls, such as a timestep beyond the last, panics instead.

/// Error of decoding a `.tcgs` file. The variants differ in who is at fault.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// The source of the bytes failed. Reading again may help.
    #[error("read failed")]
    Io(#[from] std::io::Error),
    /// The bytes break a rule of the format: the file is damaged, truncated, or no `.tcgs` file.
    #[error("invalid {field} in {section} at byte {offset}: {problem}")]
    Format {
        /// Section of the file, such as `header` or an attribute's name.
        section: &'static str,
        /// Field of the section.
        field: &'static str,
        /// Byte of the file at which the field was read; for entropy-coded symbols the first byte of the section's
        /// symbols; 0 for a disagreement between segments.
        offset: u64,
        /// The rule that is broken.
        problem: &'static str,
    },
    /// The file has a version of the format that this decoder does not know. A newer program may read it.
    #[error("invalid version in header at byte 4: found {found}, expected {expected}")]
    Version {
        /// Version of the file.
        found: u16,
        /// The newest version known, [`FORMAT_VERSION`](crate::FORMAT_VERSION).
        expected: u16,
    },
    /// Decoding would exceed [`DecodeLimits`](crate::DecodeLimits). A caller who trusts the file may raise the limit.
    #[error("{what} needs {needed} {unit}, limit is {limit}")]
    Limit {
        /// The quantity that exceeds the limit, such as `scene` or `keypoints`.
        what: &'static str,
        /// Unit of `needed` and `limit`: `bytes`, `Gaussians` or `timesteps`.
        unit: &'static str,
        /// Amount that the file needs, in `unit`.
        needed: u64,
        /// Amount that the limits allow, in `unit`.
        limit: u64,
    },
}

/// Problem of a file that was cut.
pub(crate) const ENDS_EARLY: &str = "the file ends early";
/// Problem of a value that a later addition to the format may define.
pub(crate) const NEWER: &str = "not known to this decoder; a newer one may read the file";

impl DecodeError {
    /// Whether the file ends before the end of its last section. [`SceneFile::recover`](crate::SceneFile::recover)
    /// reads the intact part of such a file.
    pub fn is_cut(&self) -> bool {
        matches!(self, Self::Format { problem: ENDS_EARLY, .. })
    }

    /// Whether the file has an unknown version, or an unknown addition to a known one: a newer decoder may read it.
    pub fn is_newer(&self) -> bool {
        matches!(self, Self::Version { .. } | Self::Format { problem: NEWER, .. })
    }
}

/// Error of compressing or writing a scene. The variants differ in which argument is at fault.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CompressError {
    /// A number is outside its legal range, or not finite.
    #[error("invalid {what}: found {found}, expected {expected}")]
    Value {
        /// Name of the number.
        what: &'static str,
        /// The illegal number.
        found: f64,
        /// Legal range.
        expected: &'static str,
    },
    /// A value of a Gaussian is not finite, or negative where it must not be.
    #[error("invalid {what} of Gaussian {gaussian}{}: found {found}, expected {expected}", at(*.timestep))]
    Gaussian {
        /// Name of the attribute, or of the quantity that belongs to it, such as its sensitivity.
        what: String,
        /// Index of the Gaussian.
        gaussian: usize,
        /// Timestep of the value; `None` if the value holds for all timesteps.
        timestep: Option<usize>,
        /// The illegal value.
        found: f64,
        /// Legal range.
        expected: &'static str,
    },
    /// Two arguments disagree in a count.
    #[error("invalid number of {what}: found {found}, expected {expected}")]
    Count {
        /// Name of the counted things.
        what: String,
        /// Count in the argument at fault.
        found: usize,
        /// Count in the other argument, or the largest that the format holds.
        expected: usize,
    },
    /// A step, an offset and a width do not make a quantizer: see [`Quantizer::problem`](crate::Quantizer::problem).
    #[error("invalid quantizer of step {step}, offset {offset} and {bits} bits: {problem}")]
    Quantizer {
        /// Step of the quantizer, in the unit of the attribute.
        step: f32,
        /// Value of code 0, in the unit of the attribute.
        offset: f32,
        /// Width of a code, in bits.
        bits: u8,
        /// The rule that is broken.
        problem: &'static str,
    },
    /// A [`CompactScene`](crate::CompactScene) breaks a rule of the format.
    #[error("invalid {field} in {section}: {problem}")]
    Scene {
        /// The name of an attribute, or `info`.
        section: &'static str,
        /// Field of the section.
        field: &'static str,
        /// The rule that is broken.
        problem: &'static str,
    },
    /// The [`SceneReader`](tcgs_core::SceneReader) failed at a timestep.
    #[error("cannot read timestep {timestep}: {error}")]
    Read {
        /// Timestep that was read.
        timestep: usize,
        /// Error of the reader.
        error: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A timestep has other columns than the scene.
    #[error("invalid columns at timestep {timestep}: found {found}, expected {expected}")]
    Layout {
        /// Timestep that was read.
        timestep: usize,
        /// Columns of the timestep.
        found: String,
        /// Columns of the scene.
        expected: String,
    },
    /// The scene has a column that the version of the format does not hold, or Gaussians with lives, or antialiased
    /// Gaussians.
    #[error(
        "version {version} of the format holds means, quats, log_scales, logit_opacities and colors of Gaussians that \
         live in all timesteps and are drawn without antialiasing; found {found}"
    )]
    Unsupported {
        /// Version of the format.
        version: u16,
        /// Name of the first column that the version does not hold, or another unsupported property in words.
        found: String,
    },
    /// The destination of the bytes failed.
    #[error("write failed")]
    Io(#[from] std::io::Error),
}

fn at(timestep: Option<usize>) -> String {
    timestep.map_or(String::new(), |timestep| format!(" at timestep {timestep}"))
}
