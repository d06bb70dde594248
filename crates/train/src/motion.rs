//! The poses of earlier timesteps, and the constant-velocity prediction of the next one.

use std::ops::Range;
use std::sync::Arc;

use tcgs_core::{Gaussians, Real, normalize};

use crate::neighbors::Neighbors;

/// Positions and rotations of all Gaussians at one timestep.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pose {
    /// `[N, 3]` centres, scene units.
    pub means: Vec<[f32; 3]>,
    /// `[N, 4]` rotations, `w, x, y, z`.
    pub quats: Vec<[f32; 4]>,
}

impl Pose {
    /// Copies the means and quaternions of `gaussians`.
    pub fn of(gaussians: &Gaussians) -> Self {
        Self { means: gaussians.means().to_vec(), quats: gaussians.quats().to_vec() }
    }

    /// The poses of some rows, one after another.
    pub(crate) fn range(&self, rows: Range<usize>) -> Self {
        Self { means: self.means[rows.clone()].to_vec(), quats: self.quats[rows].to_vec() }
    }

    fn extend(&mut self, others: &Self) {
        self.means.extend_from_slice(&others.means);
        self.quats.extend_from_slice(&others.quats);
    }

    fn select(&self, indices: &[usize]) -> Self {
        Self {
            means: indices.iter().map(|&i| self.means[i]).collect(),
            quats: indices.iter().map(|&i| self.quats[i]).collect(),
        }
    }
}

/// The earlier timesteps that the losses on motion and on masks compare with. Exists from the second timestep on.
#[derive(Clone, Debug)]
pub struct Past {
    /// The pose at the first timestep.
    pub first: Arc<Pose>,
    /// The neighbours at the first timestep, which all later timesteps use.
    pub neighbors: Arc<Neighbors<f32>>,
    /// The Gaussians at the previous timestep. Between two timesteps, before the next one begins, the Gaussians at the
    /// second to last finished timestep, from which the velocity at the last one is measured.
    pub previous: Gaussians,
    /// `[N]` mask logits of the timestep before, where masks are on.
    pub previous_mask_logits: Option<Vec<f32>>,
    /// `[N]` how still the images of this timestep show each Gaussian to be, 0 to 1; empty if unknown.
    pub stillness: Vec<f32>,
}

impl Past {
    /// The past of Gaussians whose first timestep is finished.
    ///
    /// - `first`: poses at the end of the first timestep
    /// - `previous`: see [`Self::previous`]
    /// - `is_foreground`: `[N]`
    pub fn new(first: Pose, previous: Gaussians, is_foreground: &[bool]) -> Self {
        let neighbors = Arc::new(Neighbors::new(&first.means, is_foreground));
        Self { first: Arc::new(first), neighbors, previous, previous_mask_logits: None, stillness: Vec::new() }
    }

    /// Rows taken from `indices`. Neighbours are found again among the rows that were born together.
    ///
    /// - `is_foreground`, `births`: of the rows taken
    pub(crate) fn gather(&mut self, indices: &[usize], is_foreground: &[bool], births: &[u32]) {
        *self = self.select(indices, |first| Neighbors::among(&first.means, is_foreground, births));
    }

    /// Adds Gaussians that were born together; each has stood at its place of birth so far.
    ///
    /// - `first`: their poses at birth
    /// - `previous`: as [`Self::previous`]
    /// - `is_foreground`: of them
    pub(crate) fn append(&mut self, first: &Pose, previous: &Gaussians, is_foreground: &[bool]) {
        let num_before = self.first.means.len();
        Arc::make_mut(&mut self.neighbors).append(&first.means, is_foreground, num_before);
        Arc::make_mut(&mut self.first).extend(first);
        let layout = Arc::clone(previous.layout());
        self.previous = Gaussians::concat(&layout, &[std::mem::take(&mut self.previous), previous.clone()]);
    }

    /// The past of the rows at `indices`, with unknown stillness.
    ///
    /// - `neighbors`: finds neighbours among these rows, by their poses at the first timestep
    pub(crate) fn select(&self, indices: &[usize], neighbors: impl FnOnce(&Pose) -> Neighbors<f32>) -> Self {
        let first = self.first.select(indices);
        let logits = self.previous_mask_logits.as_ref();
        Self {
            neighbors: Arc::new(neighbors(&first)),
            first: Arc::new(first),
            previous: self.previous.select(indices),
            previous_mask_logits: logits.map(|logits| indices.iter().map(|&i| logits[i]).collect()),
            stillness: Vec::new(),
        }
    }
}

/// The constant-velocity prediction of the next timestep: `x + (x − x_before)`, and likewise for
/// rotations, normalised. Luiten et al. 2024, `initialize_per_timestep` of the released code.
///
/// - `mean`, `mean_before`: scene units
/// - `quat`, `quat_before`: `w, x, y, z`, any length; normalised first
/// - returns: mean and unit rotation
pub fn predict<R: Real>(mean: [R; 3], mean_before: [R; 3], quat: [R; 4], quat_before: [R; 4]) -> ([R; 3], [R; 4]) {
    let (q, before) = (normalize(quat), normalize(quat_before));
    (
        std::array::from_fn(|i| mean[i] + (mean[i] - mean_before[i])),
        normalize(std::array::from_fn(|i| q[i] + (q[i] - before[i]))),
    )
}
