//! How files of other programs are read: harmonics, axes, and limits of memory.

use std::path::Path;

use crate::{Axes, InterchangeError};

/// How a file of another program is read.
///
/// ```
/// use tcgs_interchange::{Axes, HigherHarmonics, ReadSettings};
/// let settings = ReadSettings { axes: Some(Axes::RUB), ..ReadSettings::default() };
/// assert_eq!(settings.higher_harmonics, HigherHarmonics::Keep);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReadSettings {
    /// Whether spherical harmonics above degree 0 are read. Default: they are.
    pub higher_harmonics: HigherHarmonics,
    /// Axes of the Gaussians in the file. Default: those that the file declares, else those of its format: LUF for
    /// glTF, RDF for all others. Scenes are in RDF.
    pub axes: Option<Axes>,
    /// Limits of memory and of timesteps.
    pub limits: ReadLimits,
}

/// Whether spherical harmonics above degree 0 are read. They make colours depend on the direction of view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HigherHarmonics {
    /// They become the columns of [`Layout::with_harmonics`](tcgs_core::Layout::with_harmonics).
    #[default]
    Keep,
    /// They are ignored: each Gaussian keeps its colour of degree 0.
    Drop,
}

/// Limits of a reader's allocations for a file, whatever the file claims. Readers compare before they allocate.
///
/// Real files expand little: an SPZ file to ten times its length, a compressed npz to four. Files made to exhaust
/// memory expand a thousandfold. A file of 1 MB takes at most 131 MB with the default.
///
/// ```
/// use tcgs_interchange::ReadLimits;
/// assert_eq!(ReadLimits::default().bytes(1_000_000), 131_108_864);
/// assert_eq!(ReadLimits::NONE.bytes(1), u64::MAX);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadLimits {
    /// Bytes of memory that any file may take.
    pub base_bytes: u64,
    /// Bytes of memory for each byte of the file, above [`Self::base_bytes`].
    pub expansion: u64,
    /// Timesteps that a scene in one file may have.
    pub max_timesteps: u64,
}

impl ReadLimits {
    /// No limit: for files of a known source.
    pub const NONE: Self = Self { base_bytes: u64::MAX, expansion: 0, max_timesteps: u64::MAX };

    /// Bytes of memory that a file may take.
    ///
    /// - `file_bytes`: length of the file
    pub fn bytes(self, file_bytes: u64) -> u64 {
        self.base_bytes.saturating_add(self.expansion.saturating_mul(file_bytes))
    }

    /// Refuses a file before it takes too much memory.
    ///
    /// - `file_bytes`: length of the file
    /// - `needed`: bytes of all that is held at once
    ///
    /// # Errors
    /// [`InterchangeError::Limit`].
    pub(crate) fn check_bytes(self, path: &Path, file_bytes: u64, needed: u64) -> Result<(), InterchangeError> {
        check(path, "bytes of memory", needed, self.bytes(file_bytes))
    }

    /// Refuses a scene of too many timesteps.
    ///
    /// # Errors
    /// [`InterchangeError::Limit`].
    pub(crate) fn check_timesteps(self, path: &Path, needed: u64) -> Result<(), InterchangeError> {
        check(path, "timesteps", needed, self.max_timesteps)
    }
}

fn check(path: &Path, unit: &'static str, needed: u64, limit: u64) -> Result<(), InterchangeError> {
    if needed > limit {
        return Err(InterchangeError::Limit { path: path.into(), unit, needed, limit });
    }
    Ok(())
}

impl Default for ReadLimits {
    /// 64 MiB, 64 bytes for each byte of the file, and 65,536 timesteps, the most that a `.tcgs` file holds.
    fn default() -> Self {
        Self { base_bytes: 64 << 20, expansion: 64, max_timesteps: 1 << 16 }
    }
}

impl From<HigherHarmonics> for ReadSettings {
    fn from(higher_harmonics: HigherHarmonics) -> Self {
        Self { higher_harmonics, ..Self::default() }
    }
}
