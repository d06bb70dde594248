//! Which Gaussians the losses on motion hold together: neighbours of the foreground, found once after the first
//! timestep.

use tcgs_core::Real;

use crate::parameters::nearest;

/// Number of neighbours of each foreground Gaussian. Reference: 20.
pub const NUM_NEIGHBORS: usize = 20;
/// A neighbour at distance `d` has the weight `exp(−NEIGHBOR_FALLOFF d²)`; per squared scene unit. Reference: 2000.
pub const NEIGHBOR_FALLOFF: f32 = 2000.0;
/// The graph of nearest neighbours among the foreground Gaussians at the first timestep: `F` nodes with `per_node`
/// edges each.
#[derive(Clone, Debug)]
pub struct Neighbors<R> {
    /// `[F]` indices of the foreground Gaussians.
    pub foreground: Vec<u32>,
    /// Number of edges of each node: `min(NUM_NEIGHBORS, F − 1)`.
    pub per_node: usize,
    /// `[F, per_node]`, the neighbours of each node, as positions in `foreground`.
    pub indices: Vec<u32>,
    /// `[F, per_node]`, weight of each edge.
    pub weights: Vec<R>,
    /// `[F, per_node]` distance at the first timestep, scene units.
    pub distances: Vec<R>,
    /// `[F + 1]` first of each node's entries in `incoming`.
    incoming_starts: Vec<u32>,
    /// `[F, per_node]` edges that end at each node.
    incoming: Vec<u32>,
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

impl<R: Real> Neighbors<R> {
    /// From edges found elsewhere; the fields say what each argument is.
    ///
    /// # Panics
    /// If `indices` is not `[foreground, per_node]`, or one of them is no position in `foreground`.
    pub fn from_edges(
        foreground: Vec<u32>,
        per_node: usize,
        indices: Vec<u32>,
        weights: Vec<R>,
        distances: Vec<R>,
    ) -> Self {
        assert_eq!(indices.len(), foreground.len() * per_node, "edges against [{}, {per_node}]", foreground.len());
        let mut incoming_starts = vec![0_u32; foreground.len() + 1];
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
        Self { foreground, per_node, indices, weights, distances, incoming_starts, incoming }
    }

    /// Edges that end at the node at position `i`.
    pub(crate) fn incoming(&self, i: usize) -> &[u32] {
        &self.incoming[self.incoming_starts[i] as usize..self.incoming_starts[i + 1] as usize]
    }
}
