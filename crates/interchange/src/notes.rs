//! Notes by readers of other programs' files: assumptions and replacements that are not errors.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::Axes;

/// An assumption or a replacement by a reader, over all timesteps of a scene. The text names no file.
///
/// ```
/// use tcgs_interchange::ReadNote;
/// let note = ReadNote::Replaced { opacities: 12, scales: 3, timesteps: 1 };
/// assert_eq!(note.to_string(), "infinite numbers were replaced by finite ones: opacities 12, scales 3");
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ReadNote {
    /// Files of a format whose programs disagree about axes declare none.
    AssumedAxes(Axes),
    /// Numbers were infinite: opacities of exactly 0 or 1, scales of exactly 0.
    Replaced {
        /// Number of opacities.
        opacities: usize,
        /// Number of scales, of which a Gaussian has three.
        scales: usize,
        /// Number of timesteps that have any.
        timesteps: usize,
    },
}

impl fmt::Display for ReadNote {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AssumedAxes(axes) => write!(f, "axes assumed {axes}, as PLY files have"),
            Self::Replaced { opacities, scales, timesteps } => {
                write!(f, "infinite numbers were replaced by finite ones: opacities {opacities}, scales {scales}")?;
                if *timesteps > 1 {
                    write!(f, ", in {timesteps} timesteps")?;
                }
                Ok(())
            }
        }
    }
}

/// Numbers of replaced values at one timestep.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Replaced {
    pub opacities: usize,
    pub scales: usize,
}

/// Counts of replaced numbers at the timesteps read so far. A timestep counts once, however often it is read.
#[derive(Clone, Debug, Default)]
pub(crate) struct ReplacedByTimestep(Arc<Mutex<BTreeMap<usize, Replaced>>>);

impl ReplacedByTimestep {
    pub fn record(&self, timestep: usize, replaced: Replaced) {
        if replaced != Replaced::default() {
            self.counts().insert(timestep, replaced);
        }
    }

    /// None if no number was replaced.
    pub fn note(&self) -> Option<ReadNote> {
        let counts = self.counts();
        let sum = |of: fn(&Replaced) -> usize| counts.values().map(of).sum();
        let (opacities, scales) = (sum(|replaced| replaced.opacities), sum(|replaced| replaced.scales));
        (!counts.is_empty()).then(|| ReadNote::Replaced { opacities, scales, timesteps: counts.len() })
    }

    fn counts(&self) -> MutexGuard<'_, BTreeMap<usize, Replaced>> {
        // Counts are inserted whole.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
