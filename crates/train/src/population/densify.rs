//! Adaptive density control of the first timestep: clone, split, remove, reset. Kerbl et al. 2023,
//! §5.2, with the rules of the released code of Luiten et al. 2024.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use tcgs_core::{Attribute, normalize, rotmat_from_unit_quat, sigmoid};

use crate::config::DensifyConfig;
use crate::row::Row;
use crate::state::{GradientStatistic, State};

/// Largest scale up to which a Gaussian is cloned rather than split, as a share of the scene's radius. Reference.
pub(crate) const CLONE_SCALE: f32 = 0.01;
/// Number of children that replace a Gaussian that is split. Reference.
pub(crate) const SPLIT_CHILDREN: usize = 2;
/// The scales of the children are those of their parent divided by this. Reference.
pub(crate) const SPLIT_SHRINK: f32 = 1.6;
/// Scale above which a Gaussian is too large and may be removed, as a share of the scene's radius. Reference.
pub(crate) const PRUNE_SCALE: f32 = 0.1;
/// Opacity that a reset gives to all Gaussians, activated. Reference.
pub(crate) const RESET_OPACITY: f32 = 0.01;

/// The result of one call of [`densify`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Densified {
    /// Number of small Gaussians of large gradient that were cloned.
    pub cloned: usize,
    /// Number of large Gaussians of large gradient that were replaced by children.
    pub split: usize,
    /// Number of Gaussians that were removed, since they were nearly transparent or too large.
    pub removed: usize,
    /// `[N]` the index that each Gaussian had before, or its parent if it is new.
    pub sources: Vec<usize>,
}

/// The inputs of one call of [`densify`] other than the state.
#[derive(Clone, Copy, Debug)]
pub struct DensifyStep<'a> {
    /// The thresholds of density control.
    pub config: &'a DensifyConfig,
    /// Extent of the scene in scene units, to which scales are compared.
    pub scene_radius: f32,
    /// Whether this is the last densification, whose threshold of opacity (`prune_opacity_end`) is larger.
    pub last: bool,
    /// Whether too large Gaussians are removed.
    pub removes_large: bool,
    /// Seed of the random positions of the children.
    pub seed: u64,
}

fn largest_scale(log_scale: [f32; 3]) -> f32 {
    log_scale.into_iter().fold(f32::MIN, f32::max).exp()
}

/// One step of adaptive density control. Clones small and splits large Gaussians whose mean NDC gradient reaches the
/// threshold, removes nearly transparent and too large Gaussians, and resets the gradient statistic. If all Gaussians
/// would be removed, none is. Kerbl et al. 2023, §5.2.
pub fn densify(state: &mut State, step: &DensifyStep<'_>) -> Densified {
    let c = step.config;
    let statistic = &state.statistic;
    let gradient = |i: usize| if statistic.count[i] > 0 { statistic.sum[i] / statistic.count[i] as f32 } else { 0.0 };
    let (n, num_trained) = (state.parameters.num_gaussians(), state.num_trained());
    let scales: Vec<f32> = state.parameters.gaussians.log_scales().iter().map(|&s| largest_scale(s)).collect();
    let steep: Vec<usize> = (0..num_trained).filter(|&i| gradient(i) >= c.gradient_threshold).collect();
    let (cloned, split): (Vec<usize>, Vec<usize>) =
        steep.into_iter().partition(|&i| scales[i] <= CLONE_SCALE * step.scene_radius);

    // Parents of a split are gone.
    let mut is_parent = vec![false; n];
    for &i in &split {
        is_parent[i] = true;
    }
    let mut rows: Vec<Row> = (0..num_trained).filter(|&i| !is_parent[i]).map(Row::Kept).collect();
    rows.extend(cloned.iter().map(|&parent| Row::New { parent }));
    let first_child = rows.len();
    for _ in 0..SPLIT_CHILDREN {
        rows.extend(split.iter().map(|&parent| Row::New { parent }));
    }
    let end = rows.len();
    rows.extend((num_trained..n).map(Row::Kept));
    state.gather(&rows);

    let gaussians = &mut state.parameters.gaussians;
    let mut random = Pcg64Mcg::seed_from_u64(step.seed);
    for i in first_child..end {
        let quat = gaussians.quats()[i];
        // Quantised rotations already have unit length; normalising them again would change their last bits.
        let rotmat = rotmat_from_unit_quat(if state.quantizers.is_some() { quat } else { normalize(quat) });
        let local: [f32; 3] = std::array::from_fn(|d| gaussians.log_scales()[i][d].exp() * normal(&mut random));
        for (d, row) in rotmat.iter().enumerate() {
            gaussians.means_mut()[i][d] += row[0] * local[0] + row[1] * local[1] + row[2] * local[2];
        }
        gaussians.log_scales_mut()[i] = gaussians.log_scales_mut()[i].map(|s| s - SPLIT_SHRINK.ln());
    }

    let threshold = if step.last { c.prune_opacity_end } else { DensifyConfig::PRUNE_OPACITY };
    let keep: Vec<usize> = (0..rows.len())
        .filter(|&i| {
            let large =
                step.removes_large && largest_scale(gaussians.log_scales()[i]) > PRUNE_SCALE * step.scene_radius;
            sigmoid(gaussians.logit_opacities()[i]) >= threshold && !large
        })
        .collect();
    // An empty scene would have nothing left to learn from.
    let removed = if keep.is_empty() { 0 } else { rows.len() - keep.len() };
    if removed > 0 {
        remove_others(state, &keep);
        rows = keep.iter().map(|&i| rows[i]).collect();
    }
    state.statistic = GradientStatistic::new(state.parameters.num_gaussians());
    let sources = rows.iter().map(|row| row.source()).collect();
    Densified { cloned: cloned.len(), split: split.len(), removed, sources }
}

/// Removes all Gaussians but those at `keep`. The Gaussians that stay keep their moments, their part of the gradient
/// statistic and their bit widths.
///
/// - `keep`: indices of the Gaussians that stay, in their new order
pub fn remove_others(state: &mut State, keep: &[usize]) {
    state.gather(&keep.iter().map(|&i| Row::Kept(i)).collect::<Vec<_>>());
}

/// Sets the opacity of all Gaussians, even of less opaque ones, to `RESET_OPACITY`, and Adam's moments of the opacities
/// to zero.
pub fn reset_opacities(state: &mut State) {
    let logit = (RESET_OPACITY / (1.0 - RESET_OPACITY)).ln();
    state.parameters.gaussians.logit_opacities_mut().fill(logit);
    state.optimizer.clear(Attribute::LogitOpacity, false);
}

/// A standard normal number (Box and Muller 1958).
fn normal(random: &mut Pcg64Mcg) -> f32 {
    let (u, v): (f32, f32) = (random.random(), random.random());
    (-2.0 * (1.0 - u).ln()).sqrt() * (std::f32::consts::TAU * v).cos()
}
