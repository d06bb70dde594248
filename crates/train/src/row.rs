//! What replaces the Gaussians of a state when density adapts.

/// Where a Gaussian of a reshaped state comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Row {
    /// It was there before, at this index.
    Kept(usize),
    /// It is new and starts as the one at this index is, without its moments: a clone, or a child of a split.
    New {
        /// Index of the one it starts from.
        parent: usize,
    },
}

impl Row {
    /// Index of the Gaussian whose values it has.
    pub fn source(self) -> usize {
        match self {
            Self::Kept(i) | Self::New { parent: i } => i,
        }
    }

    /// Index where it was before, unless it is new.
    pub fn kept(self) -> Option<usize> {
        match self {
            Self::Kept(i) => Some(i),
            Self::New { .. } => None,
        }
    }
}
