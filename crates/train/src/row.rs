//! The rows of a reshaped state: which Gaussian of the old state each Gaussian of the new state comes from.

/// Where a Gaussian of a reshaped state comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Row {
    /// The Gaussian existed at this index of the old state, and keeps its values and moments.
    Kept(usize),
    /// The Gaussian is new, a clone or a child of a split: it starts with its parent's values and with zero moments.
    New {
        /// Index of the parent in the old state.
        parent: usize,
    },
}

impl Row {
    /// Index in the old state of the Gaussian whose values the new one takes.
    pub fn source(self) -> usize {
        match self {
            Self::Kept(i) | Self::New { parent: i } => i,
        }
    }

    /// Index of the same Gaussian in the old state; `None` if the Gaussian is new.
    pub fn kept(self) -> Option<usize> {
        match self {
            Self::Kept(i) => Some(i),
            Self::New { .. } => None,
        }
    }
}
