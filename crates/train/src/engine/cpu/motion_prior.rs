//! Losses that keep motion plausible after the first timestep: `rigid`, `rot`, `iso` among
//! neighbours of the foreground, `floor`, `bg`, and `soft_col_cons`. Luiten et al. 2024, §3.3 and
//! the released code. And `stillness`, which is ours.
//!
//! Every loss is a mean over its set; an empty set contributes nothing. Sums are taken over runs of a fixed length and
//! then in order, so that the number of threads does not show in them.
//!
//! # The floor
//!
//! Counted for 50,000 nodes with 20 neighbours each: 1.19 links an edge pair (see [`Neighbors`]), 3.5 blocks of eight a
//! node with padding. A link reads 12 bytes in order and 40 bytes of another node, 2 MB in all, which a cache holds; it
//! takes about 130 operations. That is 17 MB and 22 M operations of eight lanes: 2 ms on two cores.

use std::sync::Arc;

use multiversion::multiversion;
use rayon::prelude::*;
use tcgs_core::{
    Real, cross, dot, normalize, normalize_vjp, quat_conjugate, quat_mul, rotmat_from_unit_quat,
    rotmat_from_unit_quat_vjp,
};

use crate::losses::{LossTerms, ROOT_EPSILON, WeightConfig};
use crate::neighbors::{ARRIVES, LANES, LEAVES, LinkBlock, Neighbors};

/// Rows that one task handles.
const CHUNK: usize = 1 << 8;

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
    /// `[F]` means and inverse rotations at the timestep before.
    previous: Vec<([R; 3], [R; 4])>,
    /// `[B]` indices of the background Gaussians, ascending.
    background: Vec<u32>,
    /// `[B]` where they were and how they stood first.
    first_background: Vec<([R; 3], [R; 4])>,
    /// `[N]` how much each is to stay, and where it was and how it stood at the timestep before; empty for nothing.
    still: Vec<(R, [R; 3], [R; 4])>,
    /// `[N]` colours at the timestep before.
    previous_colors: Vec<[R; 3]>,
}

/// A foreground Gaussian as its neighbours read it.
#[derive(Clone, Copy)]
struct Node<R> {
    /// Mean.
    mean: [R; 3],
    /// Rotation since the timestep before.
    relative: [R; 4],
    /// Mean at the timestep before.
    previous_mean: [R; 3],
}

/// The means' and the rotations' gradients of some Gaussians that follow each other.
type Rows<'a, R> = (&'a mut [[R; 3]], &'a mut [[R; 4]]);

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
        let background: Vec<u32> = (0..means.len() as u32).filter(|&i| !is_foreground[i as usize]).collect();
        let pose = |&i: &u32| (means[i as usize], quat_conjugate(normalize(quats[i as usize])));
        let first = |&i: &u32| (first_means[i as usize], normalize(first_quats[i as usize]));
        Self {
            previous: neighbors.foreground.iter().map(pose).collect(),
            first_background: background.iter().map(first).collect(),
            background,
            still: Vec::new(),
            previous_colors: colors.to_vec(),
            neighbors,
        }
    }

    /// Tells how little each Gaussian is seen to change, for [`Loss::Stillness`](crate::Loss::Stillness).
    ///
    /// - `stillness`: `[N]`, 0 to 1; empty leaves the loss out
    /// - `means`, `quats`: `[N]`, at the timestep before; rotations in any length
    pub fn with_stillness(mut self, stillness: &[R], means: &[[R; 3]], quats: &[[R; 4]]) -> Self {
        let poses = means.iter().zip(quats);
        self.still = stillness.iter().zip(poses).map(|(&s, (&mean, &quat))| (s, mean, normalize(quat))).collect();
        self
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
        let PriorGrads { v_means, v_quats, v_colors } = grads;
        let among_neighbors = [weights.rigid, weights.rot, weights.iso];
        if self.neighbors.per_node > 0 && among_neighbors != [0.0; 3] {
            [losses.rigid, losses.rot, losses.iso] = self.neighbor_losses(means, quats, weights, v_means, v_quats);
        }
        let foreground = &self.neighbors.foreground;
        if !foreground.is_empty() && weights.floor != 0.0 {
            let share = share_of(weights.floor, foreground.len());
            for &i in foreground {
                let y = means[i as usize][1];
                if y > R::zero() {
                    losses.floor += to_f64(y) / foreground.len() as f64;
                    v_means[i as usize][1] = v_means[i as usize][1] + share;
                }
            }
        }
        if !self.background.is_empty() && weights.background != 0.0 {
            let share = share_of(weights.background, self.background.len());
            let chunks = (self.background.par_chunks(CHUNK), self.first_background.par_chunks(CHUNK));
            let rows = split_rows(v_means, v_quats, self.background.chunks(CHUNK));
            let sums: Vec<R> = (chunks.0, chunks.1, rows)
                .into_par_iter()
                .map(|(indices, first, rows)| background_rows(indices, first, means, quats, share, rows))
                .collect();
            losses.background = sums.into_iter().map(to_f64).sum::<f64>() / self.background.len() as f64;
        }
        if !self.still.is_empty() && weights.stillness != 0.0 {
            let share = share_of(weights.stillness, self.still.len());
            let rows = (v_means.par_chunks_mut(CHUNK), v_quats.par_chunks_mut(CHUNK));
            let sums: Vec<R> = (self.still.par_chunks(CHUNK), means.par_chunks(CHUNK), quats.par_chunks(CHUNK), rows)
                .into_par_iter()
                .map(|(still, means, quats, rows)| still_rows(still, means, quats, share, rows))
                .collect();
            losses.stillness = sums.into_iter().map(to_f64).sum::<f64>() / self.still.len() as f64;
        }
        if !colors.is_empty() && weights.soft_color != 0.0 {
            let share = share_of(weights.soft_color, colors.len());
            let previous = self.previous_colors.par_chunks(CHUNK);
            let sums: Vec<R> = (colors.par_chunks(CHUNK), previous, v_colors.par_chunks_mut(CHUNK))
                .into_par_iter()
                .map(|(colors, previous, v_colors)| color_rows(colors, previous, share, v_colors))
                .collect();
            losses.soft_color = sums.into_iter().map(to_f64).sum::<f64>() / colors.len() as f64;
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
        let num_edges = foreground.len() * per_node;
        let shares = [weights.rigid, weights.rot, weights.iso].map(|weight| share_of(weight, num_edges));
        let nodes: Vec<Node<R>> = foreground
            .par_iter()
            .zip(&self.previous)
            .with_min_len(CHUNK)
            .map(|(&i, &(previous_mean, inverse))| Node {
                mean: means[i as usize],
                relative: quat_mul(normalize(quats[i as usize]), inverse),
                previous_mean,
            })
            .collect();
        let rows = split_rows(v_means, v_quats, foreground.chunks(CHUNK));
        let sums: Vec<[f64; 3]> = (foreground.par_chunks(CHUNK), self.previous.par_chunks(CHUNK), rows)
            .into_par_iter()
            .enumerate()
            .map(|(chunk, (indices, previous, rows))| {
                node_rows(&self.neighbors, chunk * CHUNK, indices, previous, &nodes, quats, shares, rows)
            })
            .collect();
        let sum = |loss: usize| sums.iter().map(|sum| sum[loss]).sum::<f64>() / num_edges as f64;
        [sum(0), sum(1), sum(2)]
    }
}

/// Cuts gradients where runs of ascending indices end.
fn split_rows<'a, 'i, R>(
    mut v_means: &'a mut [[R; 3]],
    mut v_quats: &'a mut [[R; 4]],
    runs: impl Iterator<Item = &'i [u32]>,
) -> Vec<Rows<'a, R>> {
    let mut begin = 0;
    let rows = runs.map(|run| {
        let end = run.last().map_or(begin, |&last| last as usize + 1);
        let (means, quats);
        (means, v_means) = std::mem::take(&mut v_means).split_at_mut(end - begin);
        (quats, v_quats) = std::mem::take(&mut v_quats).split_at_mut(end - begin);
        begin = end;
        (means, quats)
    });
    rows.collect()
}

/// First of the Gaussians whose gradients [`split_rows`] gave to a run.
fn first_row(indices: &[u32], num_rows: usize) -> usize {
    indices.last().map_or(0, |&last| last as usize + 1 - num_rows)
}

/// Sums over the links of a node, lane by lane:
///
/// - the three losses (3)
/// - the negative gradient of the node's mean, without the part of `rigid` along leaving edges (3)
/// - the negative of that part, in the node's frame (3)
/// - the negative gradient of the node's rotation by `rot` (4)
/// - the gradient of the node's rotation matrix (9)
type LinkSums<R> = [[R; LANES]; 22];

/// `rigid`, `rot` and `iso` of some nodes, as sums along the edges that leave them. *Accumulates* the nodes' gradients,
/// including those through arriving edges.
///
/// The simple version, for an edge from `i` to `k`:
///
/// ```text
/// offset = x_k − x_i;   before = the same at the timestep before
/// rigid = √(w ‖Rᵢᵀ offset − before‖² + ε)     R: the rotation since the timestep before
/// rot   = √(w ‖q_k − q_i‖² + ε)               q: its quaternion
/// iso   = √(w (‖offset‖ − first distance)² + ε)
/// ```
///
/// Departures, for speed:
///
/// 1. A node walks all its edges and keeps only its own share of the gradient. Opposite edges are therefore computed at
///    either end, and `rot` and `iso` of both at once.
/// 2. `k` runs over lanes.
/// 3. `R_k` is applied as a quaternion.
/// 4. The product of two unit quaternions is assumed to have unit length. The gradient along its length vanishes at the
///    normalisation of the stored quaternions.
///
/// - `first`: position of the first node
/// - `indices`, `previous`: of the nodes
/// - `nodes`: of all nodes
/// - `shares`: of an edge in the three weighted means
#[multiversion(targets("x86_64+avx2"))]
#[allow(clippy::too_many_arguments, reason = "slices of what a prior and its caller hold")]
fn node_rows<R: Real>(
    neighbors: &Neighbors<R>,
    first: usize,
    indices: &[u32],
    previous: &[([R; 3], [R; 4])],
    nodes: &[Node<R>],
    quats: &[[R; 4]],
    shares: [R; 3],
    (v_means, v_quats): Rows<'_, R>,
) -> [f64; 3] {
    let begin = first_row(indices, v_means.len());
    let mut losses = [0.0; 3];
    for (position, (&index, &(_, inverse))) in indices.iter().zip(previous).enumerate() {
        let near = nodes[first + position];
        let rotmat = rotmat_from_unit_quat(near.relative);
        let mut sums = [[R::zero(); LANES]; 22];
        for block in neighbors.blocks(first + position) {
            add_links(nodes, block, &near, &rotmat, shares, &mut sums);
        }
        let sum = |i: usize| sum(sums[i]);
        let v_residual = [sum(6), sum(7), sum(8)];
        let v_rotmat = [[sum(13), sum(14), sum(15)], [sum(16), sum(17), sum(18)], [sum(19), sum(20), sum(21)]];
        let mut v_relative = rotmat_from_unit_quat_vjp(near.relative, v_rotmat);
        for d in 0..4 {
            v_relative[d] = v_relative[d] - sum(9 + d);
        }
        let row = index as usize - begin;
        add(&mut v_means[row], std::array::from_fn(|d| -(sum(3 + d) + dot(rotmat[d], v_residual))));
        add(&mut v_quats[row], normalize_vjp(quats[index as usize], quat_mul(v_relative, quat_conjugate(inverse))));
        for (i, loss) in losses.iter_mut().enumerate() {
            *loss += to_f64(sum(i));
        }
    }
    losses
}

/// Adds a block's links to a node's sums. The loop over lanes contains no loop, so that compilers vectorise it.
#[inline(always)]
fn add_links<R: Real>(
    nodes: &[Node<R>],
    block: &LinkBlock<R>,
    near: &Node<R>,
    rotmat: &[[R; 3]; 3],
    [rigid_share, rot_share, iso_share]: [R; 3],
    sums: &mut LinkSums<R>,
) {
    let (zero, one, epsilon) = (R::zero(), R::one(), R::of(ROOT_EPSILON));
    let [mut means, mut before, mut axes] = [[[zero; LANES]; 3]; 3];
    let mut ws = [zero; LANES];
    for l in 0..LANES {
        let far = &nodes[(block.others[l] & !(LEAVES | ARRIVES)) as usize];
        for d in 0..3 {
            means[d][l] = far.mean[d];
            before[d][l] = far.previous_mean[d];
            axes[d][l] = far.relative[1 + d];
        }
        ws[l] = far.relative[0];
    }
    for l in 0..LANES {
        let leaves = if block.others[l] & LEAVES != 0 { one } else { zero };
        let arrives = if block.others[l] & ARRIVES != 0 { one } else { zero };
        let (both, weight) = (leaves + arrives, block.weights[l]);
        let [x, y, z] = sub([means[0][l], means[1][l], means[2][l]], near.mean);
        let old = sub([before[0][l], before[1][l], before[2][l]], near.previous_mean);
        // rigid: the neighbour as it was, seen in the frame that turned with this node.
        let r = rotmat;
        let seen = [
            r[0][0] * x + r[1][0] * y + r[2][0] * z,
            r[0][1] * x + r[1][1] * y + r[2][1] * z,
            r[0][2] * x + r[1][2] * y + r[2][2] * z,
        ];
        let residual = sub(seen, old);
        let rigid = (weight * square(residual) + epsilon).sqrt();
        let [a, b, c] = scale(rigid_share * weight * leaves / rigid, residual);
        // The same in the frame of the neighbour, whose edge arrives: both offsets change sign.
        let (w, axis) = (ws[l], [axes[0][l], axes[1][l], axes[2][l]]);
        let arriving = sub(turn(-w, axis, [x, y, z]), old);
        let v_arriving = rigid_share * weight * arrives / (weight * square(arriving) + epsilon).sqrt();
        let v_far = turn(w, axis, scale(v_arriving, arriving));
        // rot: neighbours turn alike.
        let q = near.relative;
        let (tw, [tx, ty, tz]) = (w - q[0], sub(axis, [q[1], q[2], q[3]]));
        let rot = (weight * (tw * tw + square([tx, ty, tz])) + epsilon).sqrt();
        let v_turn = rot_share * weight * both / rot;
        // iso: distances stay.
        let length = (square([x, y, z]) + epsilon).sqrt();
        let stretch = length - block.distances[l];
        let iso = (weight * stretch * stretch + epsilon).sqrt();
        let v_length = iso_share * weight * both * stretch / (iso * length);

        let values = [
            leaves * rigid,
            leaves * rot,
            leaves * iso,
            v_length * x + v_far[0],
            v_length * y + v_far[1],
            v_length * z + v_far[2],
            a,
            b,
            c,
            v_turn * tw,
            v_turn * tx,
            v_turn * ty,
            v_turn * tz,
            x * a,
            x * b,
            x * c,
            y * a,
            y * b,
            y * c,
            z * a,
            z * b,
            z * c,
        ];
        for (sum, value) in sums.iter_mut().zip(values) {
            sum[l] = sum[l] + value;
        }
    }
}

#[inline(always)]
fn sub<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline(always)]
fn scale<R: Real>(factor: R, v: [R; 3]) -> [R; 3] {
    [factor * v[0], factor * v[1], factor * v[2]]
}

#[inline(always)]
fn square<R: Real>(v: [R; 3]) -> R {
    v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
}

/// `v` turned by the unit quaternion `w, axis`: the product with its rotation matrix; by its inverse for `−w`.
#[inline(always)]
fn turn<R: Real>(w: R, axis: [R; 3], v: [R; 3]) -> [R; 3] {
    let c = cross(axis, v);
    let cc = cross(axis, c);
    let two = R::of(2.0);
    [v[0] + two * (w * c[0] + cc[0]), v[1] + two * (w * c[1] + cc[1]), v[2] + two * (w * c[2] + cc[2])]
}

#[inline(always)]
fn sum<R: Real>(lanes: [R; LANES]) -> R {
    ((lanes[0] + lanes[4]) + (lanes[2] + lanes[6])) + ((lanes[1] + lanes[5]) + (lanes[3] + lanes[7]))
}

/// `background` of some Gaussians: the sum of distances, before any weight. *Accumulates* their gradients.
#[multiversion(targets("x86_64+avx2"))]
fn background_rows<R: Real>(
    indices: &[u32],
    first: &[([R; 3], [R; 4])],
    means: &[[R; 3]],
    quats: &[[R; 4]],
    share: R,
    (v_means, v_quats): Rows<'_, R>,
) -> R {
    let begin = first_row(indices, v_means.len());
    let mut sum = R::zero();
    for (&i, &(first_mean, first_quat)) in indices.iter().zip(first) {
        let (i, row) = (i as usize, i as usize - begin);
        sum = sum + l1(means[i], first_mean, share, &mut v_means[row]);
        let mut v_unit = [R::zero(); 4];
        sum = sum + l1(normalize(quats[i]), first_quat, share, &mut v_unit);
        add(&mut v_quats[row], normalize_vjp(quats[i], v_unit));
    }
    sum
}

/// `stillness` of some Gaussians: the sum of distances weighted by stillness, before the loss's weight. *Accumulates*
/// the gradients.
#[multiversion(targets("x86_64+avx2"))]
fn still_rows<R: Real>(
    still: &[(R, [R; 3], [R; 4])],
    means: &[[R; 3]],
    quats: &[[R; 4]],
    share: R,
    (v_means, v_quats): Rows<'_, R>,
) -> R {
    let mut sum = R::zero();
    for (row, &(stillness, mean, quat)) in still.iter().enumerate() {
        let share = share * stillness;
        let moved = l1(means[row], mean, share, &mut v_means[row]);
        let mut v_unit = [R::zero(); 4];
        let turned = l1(normalize(quats[row]), quat, share, &mut v_unit);
        add(&mut v_quats[row], normalize_vjp(quats[row], v_unit));
        sum = sum + stillness * (moved + turned);
    }
    sum
}

/// `soft_color` of some Gaussians: the sum of distances, before any weight. *Accumulates* their gradients.
#[multiversion(targets("x86_64+avx2"))]
fn color_rows<R: Real>(colors: &[[R; 3]], previous: &[[R; 3]], share: R, v_colors: &mut [[R; 3]]) -> R {
    let mut sum = R::zero();
    for ((&color, &previous), v_color) in colors.iter().zip(previous).zip(v_colors) {
        sum = sum + l1(color, previous, share, v_color);
    }
    sum
}

fn share_of<R: Real>(weight: f32, count: usize) -> R {
    R::of(f64::from(weight) / count as f64)
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
