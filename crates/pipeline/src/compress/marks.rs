//! Foreground marks of Gaussians, from the scene to labels of the file (`docs/FORMAT.md`, "Labels").

use tcgs_codec::{FOREGROUND, LABELS, Labels};

use super::CompressOptions;
use crate::{OpenScene, PipelineError};

/// Whether a compressed file keeps the foreground marks of Gaussians.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Marks {
    /// They are left out.
    #[default]
    Drop,
    /// The file has them as an object of its labels ([`LABELS`]), if any Gaussian that stays is background.
    Keep,
}

impl Marks {
    /// Refuses marks beside labels that were attached: the first labels of a file count.
    pub(super) fn check(options: &CompressOptions) -> Result<(), PipelineError> {
        if options.marks == Self::Keep && options.data.iter().any(|(name, _)| name == LABELS) {
            let expected = "one of the two: marks of the foreground are labels";
            return Err(PipelineError::input(LABELS, "attached, and marks that are kept", expected));
        }
        Ok(())
    }

    /// Whether each Gaussian that stays is foreground. None if marks are not kept, or if no Gaussian is background.
    ///
    /// - `keep`: their indices
    pub(super) fn of(self, scene: &OpenScene, keep: &[usize]) -> Result<Option<Vec<bool>>, PipelineError> {
        let of_all = match self {
            Self::Drop => None,
            Self::Keep => scene.foreground_of_all()?,
        };
        let kept = of_all.map(|of_all| keep.iter().map(|&gaussian| of_all[gaussian]).collect());
        Ok(kept.filter(|marks: &Vec<bool>| marks.contains(&false)))
    }
}

/// Labels of a file, as application data.
///
/// - `order`: which of the Gaussians each of the file's is
pub(super) fn labels(foreground: &[bool], order: &[usize]) -> Vec<u8> {
    let members: Vec<bool> = order.iter().map(|&gaussian| foreground[gaussian]).collect();
    Labels::of_object(FOREGROUND, &members).to_json()
}
