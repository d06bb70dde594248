//! Losses that keep motion plausible after the first timestep: `rigid`, `rot`, `iso` among
//! neighbours of the foreground, `floor`, `bg`, and `soft_col_cons`. Luiten et al. 2024, §3.3 and
//! the released code.
//!
//! Every loss is a mean over its set; an empty set contributes nothing. Gradients that an edge
//! passes to its far end are written once and gathered by that end, so that sums have one order.

use std::sync::Arc;

use rayon::prelude::*;
use tcgs_core::{
    Real, dot, normalize, normalize_vjp, quat_conjugate, quat_mul, quat_mul_vjp, rotmat_from_quat, rotmat_from_quat_vjp,
};

use crate::losses::{LossTerms, ROOT_EPSILON, WeightConfig};
use crate::neighbors::Neighbors;

/// Fewest foreground Gaussians that one task handles. Sums are taken per Gaussian and then in order, so
/// that this does not show in them.
const CHUNK: usize = 128;

/// The gradients of stored values to which [`MotionPrior::losses`] adds.
#[derive(Debug)]
pub struct PriorGrads<'a, R> {
    /// `[N, 3]`, gradients of the means.
    pub v_means: &'a mut [[R; 3]],
    /// `[N, 4]`, gradients of the stored quaternions.
    pub v_quats: &'a mut [[R; 4]],
    /// `[N, 3]`, gradients of the colours.
    pub v_colors: &'a mut [[R; 3]],
}

/// The quantities of earlier timesteps that the losses on motion of one timestep compare with.
#[derive(Clone, Debug)]
pub struct MotionPrior<R> {
    /// The neighbours at the first timestep.
    pub neighbors: Arc<Neighbors<R>>,
    /// `[F, per_node]` `x_k − x_i` at the timestep before.
    previous_offsets: Vec<[R; 3]>,
    /// `[F]` inverse rotation at the timestep before.
    previous_inverse_quats: Vec<[R; 4]>,
    /// `[B]` indices of the background Gaussians, where they were and how they stood first.
    background: Vec<(u32, [R; 3], [R; 4])>,
    /// `[N]` colours at the timestep before.
    previous_colors: Vec<[R; 3]>,
}

/// Sums of the three losses along one node's edges, and gradients to the node itself.
struct Node<R> {
    losses: [f64; 3],
    v_mean: [R; 3],
    v_relative: [R; 4],
    v_rotmat: [[R; 3]; 3],
}

impl<R: Real> MotionPrior<R> {
    /// Prepares a timestep.
    ///
    /// - `is_foreground`: `[N]`
    /// - `first_means`, `first_quats`: `[N]`, at the first timestep
    /// - `means`, `quats`, `colors`: `[N]`, at the timestep before; rotations in any length
    pub fn new(
        neighbors: Arc<Neighbors<R>>,
        is_foreground: &[bool],
        first_means: &[[R; 3]],
        first_quats: &[[R; 4]],
        means: &[[R; 3]],
        quats: &[[R; 4]],
        colors: &[[R; 3]],
    ) -> Self {
        let fg = &neighbors.foreground;
        let previous_offsets = (0..neighbors.indices.len())
            .map(|edge| {
                let (i, k) = (fg[edge / neighbors.per_node], fg[neighbors.indices[edge] as usize]);
                std::array::from_fn(|d| means[k as usize][d] - means[i as usize][d])
            })
            .collect();
        Self {
            previous_offsets,
            previous_inverse_quats: fg.iter().map(|&i| quat_conjugate(normalize(quats[i as usize]))).collect(),
            background: (0..means.len())
                .filter(|&i| !is_foreground[i])
                .map(|i| (i as u32, first_means[i], normalize(first_quats[i])))
                .collect(),
            previous_colors: colors.to_vec(),
            neighbors,
        }
    }

    /// Values of the losses on motion, the others 0; *accumulates* the gradient of their weighted sum.
    ///
    /// - `means`, `quats`, `colors`: `[N]`, stored form
    pub fn losses(
        &self,
        means: &[[R; 3]],
        quats: &[[R; 4]],
        colors: &[[R; 3]],
        weights: &WeightConfig,
        grads: PriorGrads<'_, R>,
    ) -> LossTerms {
        let mut losses = LossTerms::default();
        let among_neighbors = [weights.rigid, weights.rot, weights.iso];
        if self.neighbors.per_node > 0 && among_neighbors != [0.0; 3] {
            [losses.rigid, losses.rot, losses.iso] =
                self.neighbor_losses(means, quats, weights, grads.v_means, grads.v_quats);
        }
        let foreground = &self.neighbors.foreground;
        if !foreground.is_empty() && weights.floor != 0.0 {
            let share = R::of(f64::from(weights.floor) / foreground.len() as f64);
            for &i in foreground {
                let y = means[i as usize][1];
                if y > R::zero() {
                    losses.floor += to_f64(y) / foreground.len() as f64;
                    grads.v_means[i as usize][1] = grads.v_means[i as usize][1] + share;
                }
            }
        }
        if !self.background.is_empty() && weights.background != 0.0 {
            let share = R::of(f64::from(weights.background) / self.background.len() as f64);
            let mut sum = R::zero();
            for &(i, first_mean, first_quat) in &self.background {
                let i = i as usize;
                sum = sum + l1(means[i], first_mean, share, &mut grads.v_means[i]);
                let mut v_unit = [R::zero(); 4];
                sum = sum + l1(normalize(quats[i]), first_quat, share, &mut v_unit);
                add(&mut grads.v_quats[i], normalize_vjp(quats[i], v_unit));
            }
            losses.background = to_f64(sum) / self.background.len() as f64;
        }
        if !colors.is_empty() && weights.soft_color != 0.0 {
            let share = R::of(f64::from(weights.soft_color) / colors.len() as f64);
            let mut sum = R::zero();
            for ((&color, &previous), v_color) in colors.iter().zip(&self.previous_colors).zip(grads.v_colors) {
                sum = sum + l1(color, previous, share, v_color);
            }
            losses.soft_color = to_f64(sum) / colors.len() as f64;
        }
        losses
    }

    fn neighbor_losses(
        &self,
        means: &[[R; 3]],
        quats: &[[R; 4]],
        weights: &WeightConfig,
        v_means: &mut [[R; 3]],
        v_quats: &mut [[R; 4]],
    ) -> [f64; 3] {
        let Neighbors { foreground, per_node, .. } = &*self.neighbors;
        let per_node = *per_node;
        let num_edges = foreground.len() * per_node;
        let share = |weight: f32| R::of(f64::from(weight) / num_edges as f64);
        let shares = [share(weights.rigid), share(weights.rot), share(weights.iso)];
        let points: Vec<[R; 3]> = foreground.iter().map(|&i| means[i as usize]).collect();
        let relative: Vec<[R; 4]> = foreground
            .par_iter()
            .zip(&self.previous_inverse_quats)
            .map(|(&i, &inverse)| quat_mul(normalize(quats[i as usize]), inverse))
            .collect();

        // Along every node's own edges; what belongs to the far end stays with the edge.
        let mut v_ends: Vec<([R; 3], [R; 4])> = vec![([R::zero(); 3], [R::zero(); 4]); num_edges];
        let nodes: Vec<Node<R>> = v_ends
            .par_chunks_mut(per_node)
            .enumerate()
            .with_min_len(CHUNK)
            .map(|(i, v_ends)| self.node(i, &points, &relative, shares, v_ends))
            .collect();

        // Every node gathers what its incoming edges hold for it.
        let gathered: Vec<([R; 3], [R; 4])> = nodes
            .par_iter()
            .enumerate()
            .with_min_len(CHUNK)
            .map(|(i, node)| {
                let (mut v_mean, mut v_relative) = (node.v_mean, node.v_relative);
                for &edge in self.neighbors.incoming(i) {
                    let (v_end_mean, v_end_relative) = v_ends[edge as usize];
                    add(&mut v_mean, v_end_mean);
                    add(&mut v_relative, v_end_relative);
                }
                add(&mut v_relative, rotmat_from_quat_vjp(relative[i], node.v_rotmat));
                let stored = quats[foreground[i] as usize];
                let (v_unit, _) = quat_mul_vjp(normalize(stored), self.previous_inverse_quats[i], v_relative);
                (v_mean, normalize_vjp(stored, v_unit))
            })
            .collect();
        for (&i, (v_mean, v_quat)) in foreground.iter().zip(gathered) {
            add(&mut v_means[i as usize], v_mean);
            add(&mut v_quats[i as usize], v_quat);
        }
        let mut sums = [0.0; 3];
        for node in &nodes {
            for (sum, loss) in sums.iter_mut().zip(node.losses) {
                *sum += loss;
            }
        }
        sums.map(|sum| sum / num_edges as f64)
    }

    fn node(
        &self,
        i: usize,
        points: &[[R; 3]],
        relative: &[[R; 4]],
        shares: [R; 3],
        v_ends: &mut [([R; 3], [R; 4])],
    ) -> Node<R> {
        let [rigid_share, rot_share, iso_share] = shares;
        let epsilon = R::of(ROOT_EPSILON);
        let rotmat = rotmat_from_quat(relative[i]);
        let mut node = Node {
            losses: [0.0; 3],
            v_mean: [R::zero(); 3],
            v_relative: [R::zero(); 4],
            v_rotmat: [[R::zero(); 3]; 3],
        };
        let first = i * v_ends.len();
        for (slot, v_end) in v_ends.iter_mut().enumerate() {
            let edge = first + slot;
            let k = self.neighbors.indices[edge] as usize;
            let weight = self.neighbors.weights[edge];
            let offset: [R; 3] = std::array::from_fn(|d| points[k][d] - points[i][d]);

            // rigid: the neighbour as it was, seen in the frame that turned with i.
            let residual: [R; 3] = std::array::from_fn(|j| {
                rotmat[0][j] * offset[0] + rotmat[1][j] * offset[1] + rotmat[2][j] * offset[2]
                    - self.previous_offsets[edge][j]
            });
            let rigid = (weight * dot(residual, residual) + epsilon).sqrt();
            let v_residual = residual.map(|r| rigid_share * weight * r / rigid);
            let mut v_offset: [R; 3] = std::array::from_fn(|d| dot(rotmat[d], v_residual));
            for d in 0..3 {
                for j in 0..3 {
                    node.v_rotmat[d][j] = node.v_rotmat[d][j] + offset[d] * v_residual[j];
                }
            }

            // rot: neighbours turn alike.
            let turn: [R; 4] = std::array::from_fn(|d| relative[k][d] - relative[i][d]);
            let rot = (weight * dot(turn, turn) + epsilon).sqrt();
            let v_turn = turn.map(|t| rot_share * weight * t / rot);

            // iso: distances stay.
            let length = (dot(offset, offset) + epsilon).sqrt();
            let stretch = length - self.neighbors.distances[edge];
            let iso = (weight * stretch * stretch + epsilon).sqrt();
            let v_length = iso_share * weight * stretch / iso;
            add(&mut v_offset, offset.map(|o| v_length * o / length));

            add(&mut node.v_mean, v_offset.map(|v| -v));
            add(&mut node.v_relative, v_turn.map(|v| -v));
            *v_end = (v_offset, v_turn);
            for (sum, loss) in node.losses.iter_mut().zip([rigid, rot, iso]) {
                *sum += to_f64(loss);
            }
        }
        node
    }
}

fn to_f64<R: Real>(x: R) -> f64 {
    x.to_f64().unwrap_or(f64::NAN)
}

#[inline(always)]
fn add<R: Real, const D: usize>(sum: &mut [R; D], value: [R; D]) {
    for i in 0..D {
        sum[i] = sum[i] + value[i];
    }
}

/// `‖a − b‖₁`; adds `share * sign(a − b)` to `v_a`.
#[inline(always)]
fn l1<R: Real, const D: usize>(a: [R; D], b: [R; D], share: R, v_a: &mut [R; D]) -> R {
    let mut sum = R::zero();
    for i in 0..D {
        let difference = a[i] - b[i];
        sum = sum + difference.abs();
        if difference != R::zero() {
            v_a[i] = v_a[i] + share * difference.signum();
        }
    }
    sum
}
