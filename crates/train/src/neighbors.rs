//! The graph of neighbours that the losses on motion hold together: neighbours of the foreground, found once after the
//! first timestep. Gaussians born later are neighbours of those born with them. After deaths, neighbours are found
//! again.

use std::cmp::Ordering;

use rayon::prelude::*;
use tcgs_core::Real;

use crate::parameters::nearest;

/// Number of neighbours of each foreground Gaussian. Reference: 20.
pub const NUM_NEIGHBORS: usize = 20;
/// A neighbour at distance `d` has the weight `exp(−NEIGHBOR_FALLOFF d²)`; per squared scene unit. Reference: 2000.
pub const NEIGHBOR_FALLOFF: f32 = 2000.0;
/// Links that are processed side by side: a node's list is padded to a multiple of this.
pub(crate) const LANES: usize = 8;
/// A link stands for an edge that leaves the list's node.
pub(crate) const LEAVES: u32 = 1 << 31;
/// A link stands for an edge that arrives at the list's node.
pub(crate) const ARRIVES: u32 = 1 << 30;

/// The graph of nearest neighbours among the foreground Gaussians: `F` nodes with `per_node` edges each. Positions are
/// those at the first timestep, or at the timestep at which the Gaussians were born together.
///
/// Every node also has a list of the nodes that share an edge with it, whichever way the edge runs. A node therefore
/// finds its whole gradient in one walk and writes nothing for a far end. Two nodes that are each other's neighbours,
/// as most are, share one link for both edges.
#[derive(Clone, Debug)]
pub struct Neighbors<R> {
    /// `[F]` indices of the foreground Gaussians, ascending.
    pub foreground: Vec<u32>,
    /// Edges per node: [`NUM_NEIGHBORS`], or one less than the size of the largest group born together if that is
    /// smaller.
    pub per_node: usize,
    /// `[F, per_node]`, the neighbours of each node, as positions in `foreground`.
    pub indices: Vec<u32>,
    /// `[F, per_node]`, weight of each edge.
    pub weights: Vec<R>,
    /// `[F, per_node]` distance at the first timestep, scene units.
    pub distances: Vec<R>,
    /// `[F + 1]` first of each node's entries in `blocks`.
    block_starts: Vec<u32>,
    /// The lists of all nodes.
    blocks: Vec<LinkBlock<R>>,
}

/// One or two edges between a list's node and another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Link<R> {
    /// Position of the other node in `foreground`.
    pub other: u32,
    /// [`LEAVES`], [`ARRIVES`], or both; 0 for padding.
    pub directions: u32,
    /// Weight of the edges.
    pub weight: R,
    /// Distance at the first timestep, scene units.
    pub distance: R,
}

/// [`LANES`] links of one list. Padding names the list's own node and weighs nothing.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LinkBlock<R> {
    /// Other node and directions.
    pub others: [u32; LANES],
    /// Weights.
    pub weights: [R; LANES],
    /// Distances at the first timestep, scene units.
    pub distances: [R; LANES],
}

impl<R: Real> LinkBlock<R> {
    fn new(node: u32, links: &[Link<R>]) -> Self {
        let padding = Link { other: node, directions: 0, weight: R::zero(), distance: R::zero() };
        let link = |l: usize| links.get(l).copied().unwrap_or(padding);
        Self {
            others: std::array::from_fn(|l| link(l).other | link(l).directions),
            weights: std::array::from_fn(|l| link(l).weight),
            distances: std::array::from_fn(|l| link(l).distance),
        }
    }
}

impl Neighbors<f32> {
    /// Finds the neighbours among the foreground.
    ///
    /// - `means`: `[N, 3]` at the first timestep, finite, scene units
    /// - `is_foreground`: `[N]`
    pub fn new(means: &[[f32; 3]], is_foreground: &[bool]) -> Self {
        let foreground: Vec<u32> = (0..means.len() as u32).filter(|&i| is_foreground[i as usize]).collect();
        let points: Vec<[f32; 3]> = foreground.iter().map(|&i| means[i as usize]).collect();
        let found = nearest(&points, NUM_NEIGHBORS);
        let per_node = found.first().map_or(0, Vec::len);
        let edges = || found.iter().flatten();
        Self::from_edges(
            foreground,
            per_node,
            edges().map(|&(i, _)| i).collect(),
            edges().map(|&(_, d)| (-NEIGHBOR_FALLOFF * d).exp()).collect(),
            edges().map(|&(_, d)| d.sqrt()).collect(),
        )
    }
}

impl Neighbors<f32> {
    /// Finds the neighbours among those of the foreground that were born together.
    ///
    /// - `means`, `is_foreground`: as for [`Self::new`]
    /// - `births`: `[N]` timesteps of birth; Gaussians born together are adjacent
    pub(crate) fn among(means: &[[f32; 3]], is_foreground: &[bool], births: &[u32]) -> Self {
        let mut neighbors = Self::new(&[], &[]);
        let mut begin = 0;
        for together in births.chunk_by(|a, b| a == b) {
            let end = begin + together.len();
            neighbors.append(&means[begin..end], &is_foreground[begin..end], begin);
            begin = end;
        }
        neighbors
    }

    /// Adds the neighbours of Gaussians that were born together, among themselves. All nodes have the same number of
    /// edges: if too few were born together, edges of weight 0 from a node to itself fill its list.
    ///
    /// - `means`: `[M, 3]` at their first timestep, finite, scene units
    /// - `is_foreground`: `[M]`
    /// - `first`: index of the first of them among all Gaussians
    pub(crate) fn append(&mut self, means: &[[f32; 3]], is_foreground: &[bool], first: usize) {
        let own = Self::new(means, is_foreground);
        let per_node = self.per_node.max(own.per_node);
        let offset = self.foreground.len() as u32;
        let mut edges = self.padded(per_node);
        edges.extend(own.padded(per_node).into_iter().map(|(end, weight, distance)| (offset + end, weight, distance)));
        let foreground = self.foreground.iter().copied().chain(own.foreground.iter().map(|&i| first as u32 + i));
        *self = Self::from_edges(
            foreground.collect(),
            per_node,
            edges.iter().map(|edge| edge.0).collect(),
            edges.iter().map(|edge| edge.1).collect(),
            edges.iter().map(|edge| edge.2).collect(),
        );
    }

    /// Far end, weight and distance of the edges, `per_node` of each node: its own, then ones of weight 0 to itself.
    fn padded(&self, per_node: usize) -> Vec<(u32, f32, f32)> {
        let of_node = |node: usize| {
            let own = node * self.per_node..(node + 1) * self.per_node;
            let own = own.map(|edge| (self.indices[edge], self.weights[edge], self.distances[edge]));
            own.chain(std::iter::repeat((node as u32, 0.0, 0.0))).take(per_node)
        };
        (0..self.foreground.len()).flat_map(of_node).collect()
    }
}

impl<R: Real> Neighbors<R> {
    /// Builds the graph from edges found elsewhere; the fields describe the arguments.
    ///
    /// # Panics
    /// If `foreground` is not ascending, `indices` is not `[foreground, per_node]`, or one of them is no position in
    /// `foreground`.
    pub fn from_edges(
        foreground: Vec<u32>,
        per_node: usize,
        indices: Vec<u32>,
        weights: Vec<R>,
        distances: Vec<R>,
    ) -> Self {
        let num_nodes = foreground.len();
        assert!(foreground.is_sorted_by(|a, b| a < b) && num_nodes < ARRIVES as usize, "foreground is ascending");
        assert_eq!(indices.len(), num_nodes * per_node, "edges against [{num_nodes}, {per_node}]");
        let mut incoming_starts = vec![0_u32; num_nodes + 1];
        for &end in &indices {
            incoming_starts[end as usize + 1] += 1;
        }
        for i in 1..incoming_starts.len() {
            incoming_starts[i] += incoming_starts[i - 1];
        }
        let mut next = incoming_starts.clone();
        let mut incoming = vec![0; indices.len()];
        for (edge, &end) in indices.iter().enumerate() {
            incoming[next[end as usize] as usize] = edge as u32;
            next[end as usize] += 1;
        }
        let lists: Vec<Vec<LinkBlock<R>>> = (0..num_nodes)
            .into_par_iter()
            .map(|i| {
                let link = |other: u32, directions, edge: usize| Link {
                    other,
                    directions,
                    weight: weights[edge],
                    distance: distances[edge],
                };
                let leaving = (i * per_node..(i + 1) * per_node).map(|edge| link(indices[edge], LEAVES, edge));
                let arriving = incoming[incoming_starts[i] as usize..incoming_starts[i + 1] as usize]
                    .iter()
                    .map(|&edge| link(edge / per_node as u32, ARRIVES, edge as usize));
                // An edge from a node to itself has no effect.
                let others = leaving.chain(arriving).filter(|link| link.other != i as u32);
                let links = merged(others.collect());
                links.chunks(LANES).map(|links| LinkBlock::new(i as u32, links)).collect()
            })
            .collect();
        let mut block_starts = Vec::with_capacity(num_nodes + 1);
        block_starts.push(0);
        block_starts.extend(lists.iter().scan(0, |end, list| {
            *end += list.len() as u32;
            Some(*end)
        }));
        Self { foreground, per_node, indices, weights, distances, block_starts, blocks: lists.concat() }
    }

    /// The list of the node at position `i`, with padding.
    #[inline]
    pub(crate) fn blocks(&self, i: usize) -> &[LinkBlock<R>] {
        &self.blocks[self.block_starts[i] as usize..self.block_starts[i + 1] as usize]
    }

    /// The list of the node at position `i`, without padding.
    #[cfg(feature = "gpu")]
    pub(crate) fn links(&self, i: usize) -> impl Iterator<Item = Link<R>> {
        const FLAGS: u32 = LEAVES | ARRIVES;
        let all = self.blocks(i).iter().flat_map(|block| {
            (0..LANES).map(|l| Link {
                other: block.others[l] & !FLAGS,
                directions: block.others[l] & FLAGS,
                weight: block.weights[l],
                distance: block.distances[l],
            })
        });
        all.filter(|link| link.directions != 0)
    }
}

/// Sorts links by the other node. Two opposite edges become one link if weight and distance agree, as they do when both
/// were measured.
fn merged<R: Real>(mut links: Vec<Link<R>>) -> Vec<Link<R>> {
    let order = |a: R, b: R| a.partial_cmp(&b).unwrap_or(Ordering::Equal);
    links.sort_by(|a, b| {
        let by_values = || order(a.weight, b.weight).then_with(|| order(a.distance, b.distance));
        a.other.cmp(&b.other).then_with(by_values).then_with(|| a.directions.cmp(&b.directions))
    });
    links.dedup_by(|next, kept| {
        let same = (next.other, next.weight, next.distance) == (kept.other, kept.weight, kept.distance)
            && next.directions & kept.directions == 0;
        if same {
            kept.directions |= next.directions;
        }
        same
    });
    links
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ends of each node's edges that weigh something.
    fn ends(neighbors: &Neighbors<f32>) -> Vec<Vec<u32>> {
        let edges = neighbors.indices.iter().zip(&neighbors.weights).collect::<Vec<_>>();
        let of_node = |node: &[(&u32, &f32)]| node.iter().filter(|(_, w)| **w > 0.0).map(|(end, _)| **end).collect();
        edges.chunks(neighbors.per_node).map(of_node).collect()
    }

    #[test]
    fn few_that_are_left_of_those_born_together_do_not_cut_the_neighbours_of_others() {
        // One Gaussian of the first timestep is left, or three; then four are born, then two.
        let means: Vec<[f32; 3]> = (0..9).map(|i| [0.001 * (i * i) as f32, 0.0, 0.0]).collect();
        let found = Neighbors::among(&means[2..], &[true; 7], &[0, 4, 4, 4, 4, 6, 6]);
        assert_eq!(found.per_node, 3);
        assert_eq!(
            ends(&found),
            [vec![], vec![2, 3, 4], vec![1, 3, 4], vec![2, 4, 1], vec![3, 2, 1], vec![6], vec![5]]
        );
        let found = Neighbors::among(&means, &[true; 9], &[0, 0, 0, 4, 4, 4, 4, 6, 6]);
        let first = [vec![1, 2], vec![0, 2], vec![1, 0]];
        let then = [vec![4, 5, 6], vec![3, 5, 6], vec![4, 6, 3], vec![5, 4, 3], vec![8], vec![7]];
        assert_eq!(ends(&found), [&first[..], &then].concat());
        // A Gaussian without foreground beside it takes no part.
        let mut is_foreground = [true; 9];
        is_foreground[..3].fill(false);
        let found = Neighbors::among(&means, &is_foreground, &[0, 0, 0, 4, 4, 4, 4, 6, 6]);
        assert_eq!((found.foreground.len(), found.per_node, ends(&found).len()), (6, 3, 6));
    }
}
