//! How files of other programs are read: what is taken from them, in which axes they are, and how much memory they may take.

use crate::Axes;

/// How a file of another program is read.
///
/// ```
/// use tcgs_interchange::{Axes, HigherHarmonics, ReadSettings};
/// let settings = ReadSettings { axes: Some(Axes::RUB), ..ReadSettings::default() };
/// assert_eq!(settings.higher_harmonics, HigherHarmonics::Keep);
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReadSettings {
    /// What to do with spherical harmonics above degree 0. Default: keep.
    pub higher_harmonics: HigherHarmonics,
    /// Axes of the Gaussians in the file. Default: those that the file declares, else those of its format: LUF of glTF, else
    /// RDF. Scenes are in RDF.
    pub axes: Option<Axes>,
    /// How much memory a file may take.
    pub limits: ReadLimits,
}

/// What a reader does with spherical harmonics above degree 0, with which colours depend on the direction of view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum HigherHarmonics {
    /// They become the columns of [`Layout::with_harmonics`](tcgs_core::Layout::with_harmonics).
    #[default]
    Keep,
    /// They are ignored: each Gaussian keeps its colour of degree 0.
    Drop,
}

/// How much memory a reader may allocate for a file, whatever the file claims.
///
/// Real files expand little: an SPZ file to four times its length, a compressed npz to ten. Files made to exhaust memory expand
/// a thousandfold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReadLimits {
    /// Bytes that any file may take.
    pub base_bytes: u64,
    /// Bytes of memory for each byte of the file, above [`Self::base_bytes`].
    pub expansion: u64,
}

impl ReadLimits {
    /// No limit: for files of a known source.
    pub const NONE: Self = Self { base_bytes: u64::MAX, expansion: 0 };

    /// Bytes of memory that a file may take.
    ///
    /// - `file_bytes`: length of the file
    pub fn bytes(self, file_bytes: u64) -> u64 {
        self.base_bytes.saturating_add(self.expansion.saturating_mul(file_bytes))
    }
}

impl Default for ReadLimits {
    /// 64 MiB, and 64 bytes for each byte of the file.
    fn default() -> Self {
        Self { base_bytes: 64 << 20, expansion: 64 }
    }
}

impl From<HigherHarmonics> for ReadSettings {
    fn from(higher_harmonics: HigherHarmonics) -> Self {
        Self { higher_harmonics, ..Self::default() }
    }
}
