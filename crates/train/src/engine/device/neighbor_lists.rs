//! Neighbours as the shaders walk them: in an order that keeps Gaussians near in space near in memory.
//!
//! A foreground Gaussian is a *node*, and its list is that of [`Neighbors`].
//!
//! Nodes lie along a Morton curve of their first positions, so that a workgroup's lists name few nodes beyond its own.
//! Within a workgroup nodes are sorted by the length of their lists. Lists are stored slice by slice, [`SLICE`] nodes
//! side by side: threads that run together read neighbouring words and end together.

use rayon::prelude::*;
use tcgs_render::device::{WORKGROUP, Wgsl};

use crate::neighbors::{ARRIVES, LEAVES, Link, Neighbors};

/// Nodes whose lists lie side by side.
const SLICE: usize = 32;
/// Words of an entry: node and directions, weight, distance. They lie a slice apart.
const WORDS: usize = 3;

/// Flag of a place: a position among the background, not a node.
const BACKGROUND: u32 = 1 << 31;

/// How the lists lie, for the shader that walks them.
pub(crate) fn constants() -> Wgsl {
    Wgsl::new()
        .constant("BACKGROUND", BACKGROUND)
        .constant("LEAVES", LEAVES)
        .constant("ARRIVES", ARRIVES)
        .constant("SLICE", SLICE)
        .constant("LINK_STRIDE", WORDS * SLICE)
}

/// The graph that the losses on motion walk; constant over all timesteps.
#[derive(Debug, PartialEq)]
pub(crate) struct NeighborLists {
    /// `[N]` the node that a Gaussian is, or its position among the background with the highest bit set.
    pub places: Vec<u32>,
    /// `[F]` Gaussian, first word of its list in `links`, entries of the list, 0.
    pub nodes: Vec<[u32; 4]>,
    /// Lists: by slice, by position in the list, by word, by node of the slice.
    pub links: Vec<u32>,
}

impl NeighborLists {
    /// - `first_means`: `[N, 3]` at the first timestep, finite
    pub fn new(neighbors: &Neighbors<f32>, first_means: &[[f32; 3]]) -> Self {
        let foreground = &neighbors.foreground;
        let lists: Vec<Vec<Link<f32>>> = (0..foreground.len()).map(|i| neighbors.links(i).collect()).collect();

        let points: Vec<[f32; 3]> = foreground.iter().map(|&i| first_means[i as usize]).collect();
        let mut order = along_morton_curve(&points);
        for block in order.chunks_mut(WORKGROUP as usize) {
            block.sort_by_key(|&i| std::cmp::Reverse(lists[i as usize].len()));
        }
        let mut ranks = vec![0; order.len()];
        for (rank, &i) in order.iter().enumerate() {
            ranks[i as usize] = rank as u32;
        }

        let mut places = vec![0; first_means.len()];
        for (&gaussian, &rank) in foreground.iter().zip(&ranks) {
            places[gaussian as usize] = rank;
        }
        let mut is_foreground = vec![false; first_means.len()];
        foreground.iter().for_each(|&i| is_foreground[i as usize] = true);
        let background = (0..first_means.len()).filter(|&i| !is_foreground[i]);
        for (position, i) in background.enumerate() {
            places[i] = position as u32 | BACKGROUND;
        }

        let mut nodes = Vec::with_capacity(order.len());
        let mut links = Vec::new();
        for slice in order.chunks(SLICE) {
            let first = links.len();
            let longest = slice.iter().map(|&i| lists[i as usize].len()).max().unwrap_or(0);
            links.resize(first + longest * WORDS * SLICE, 0);
            for (lane, &i) in slice.iter().enumerate() {
                let mut list = lists[i as usize].clone();
                // Threads side by side then ask for nodes near each other at the same time.
                list.sort_by_key(|link| ranks[link.other as usize]);
                for (position, link) in list.iter().enumerate() {
                    let at = first + position * WORDS * SLICE + lane;
                    links[at] = ranks[link.other as usize] | link.directions;
                    links[at + SLICE] = link.weight.to_bits();
                    links[at + 2 * SLICE] = link.distance.to_bits();
                }
                nodes.push([foreground[i as usize], (first + lane) as u32, list.len() as u32, 0]);
            }
        }
        Self { places, nodes, links }
    }
}

/// Positions of `points` in the order of a Morton curve through their bounding box; equal keys by position.
fn along_morton_curve(points: &[[f32; 3]]) -> Vec<u32> {
    /// Bits of a coordinate.
    const BITS: u32 = 21;
    let bound = |pick: fn(f32, f32) -> f32, start: f32, axis: usize| points.iter().map(|p| p[axis]).fold(start, pick);
    let low = [0, 1, 2].map(|axis| bound(f32::min, f32::INFINITY, axis));
    let high = [0, 1, 2].map(|axis| bound(f32::max, f32::NEG_INFINITY, axis));
    let extent = (0..3).map(|axis| high[axis] - low[axis]).fold(f32::MIN_POSITIVE, f32::max);
    let key = |point: [f32; 3]| -> u64 {
        (0..3).fold(0, |key, axis| {
            let cell = (point[axis] - low[axis]) / extent * ((1 << BITS) - 1) as f32;
            key | spread(cell as u64) << axis
        })
    };
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    order.par_sort_by_cached_key(|&i| key(points[i as usize]));
    order
}

/// Moves bit `i` of 21 to bit `3 i`.
fn spread(x: u64) -> u64 {
    let x = (x | x << 32) & 0x001f_0000_0000_ffff;
    let x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    let x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    let x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_spread_to_every_third() {
        for i in 0..21 {
            assert_eq!(spread(1 << i), 1 << (3 * i));
        }
        assert_eq!(along_morton_curve(&[[9.0, 9.0, 9.0], [0.0; 3], [8.0, 9.0, 9.0], [1.0, 0.0, 0.0]]), [1, 3, 2, 0]);
        assert_eq!(along_morton_curve(&[[2.0; 3]; 3]), [0, 1, 2]);
    }

    /// Every edge as `(near Gaussian, far Gaussian, weight, distance)`, as the lists tell it at one of its ends.
    fn edges(lists: &NeighborLists, direction: u32) -> Vec<(u32, u32, u32, u32)> {
        let mut edges = Vec::new();
        for &[gaussian, first, count, _] in &lists.nodes {
            for position in 0..count as usize {
                let at = first as usize + position * WORDS * SLICE;
                let other = lists.nodes[(lists.links[at] & !(LEAVES | ARRIVES)) as usize][0];
                let ends = if direction == LEAVES { (gaussian, other) } else { (other, gaussian) };
                if lists.links[at] & direction != 0 {
                    edges.push((ends.0, ends.1, lists.links[at + SLICE], lists.links[at + 2 * SLICE]));
                }
            }
        }
        edges.sort_unstable();
        edges
    }

    #[test]
    fn both_ends_know_every_edge_once() {
        // Every third is background; along a curve, so that not all edges have an opposite.
        let means: Vec<[f32; 3]> = (0..900)
            .map(|i| {
                let t = i as f32 / 50.0;
                [t * t.sin(), t.cos(), (t * t) % 7.0]
            })
            .collect();
        let is_foreground: Vec<bool> = (0..900).map(|i| i % 3 != 0).collect();
        let neighbors = Neighbors::new(&means, &is_foreground);
        let lists = NeighborLists::new(&neighbors, &means);

        let mut expected: Vec<_> = (0..neighbors.indices.len())
            .map(|edge| {
                let ends = [edge / neighbors.per_node, neighbors.indices[edge] as usize];
                let [near, far] = ends.map(|i| neighbors.foreground[i]);
                (near, far, neighbors.weights[edge].to_bits(), neighbors.distances[edge].to_bits())
            })
            .collect();
        expected.sort_unstable();
        assert_eq!(edges(&lists, LEAVES), expected);
        assert_eq!(edges(&lists, ARRIVES), expected);
        let entries: u32 = lists.nodes.iter().map(|node| node[2]).sum();
        assert!((entries as usize) < 2 * expected.len() - 100, "{entries} entries of {} edges", expected.len());

        for (i, &place) in lists.places.iter().enumerate() {
            if i % 3 == 0 {
                assert_eq!(place, BACKGROUND | (i / 3) as u32);
            } else {
                assert_eq!(lists.nodes[place as usize][0], i as u32);
            }
        }
    }

    #[test]
    fn opposite_edges_that_differ_stay_apart() {
        let neighbors = Neighbors::from_edges(vec![0, 1], 1, vec![1, 0], vec![0.5, 0.25], vec![1.0, 1.0]);
        let lists = NeighborLists::new(&neighbors, &[[0.0; 3], [1.0; 3]]);
        assert_eq!((lists.nodes[0][2], edges(&lists, LEAVES)), (2, edges(&lists, ARRIVES)));
        assert_eq!(NeighborLists::new(&Neighbors::new(&[[0.0; 3]], &[true]), &[[0.0; 3]]).nodes, [[0; 4]]);
    }
}
