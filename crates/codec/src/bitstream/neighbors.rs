//! The two nearest neighbours of every Gaussian among those decoded before it (`docs/FORMAT.md`, "Neighbours"). First
//! codes and keypoints are predicted from them.

use std::ops::Range;

use crate::morton;

/// Marks a missing neighbour.
pub(super) const NONE: u32 = u32::MAX;

/// Number of candidates before a Gaussian in its layer, and on either side of it along the curve in the layers before.
const REACH: usize = 4;

/// The two nearest neighbours of every Gaussian among a few candidates that precede it in the file.
#[derive(Clone, Debug, Default)]
pub(super) struct Neighbors {
    /// `[N][2]`, nearest first; [`NONE`] where there are fewer.
    nearest: Vec<[u32; 2]>,
    /// First positions as 16-bit coordinates.
    points: Vec<[u16; 3]>,
    /// Curve key and index of all Gaussians of the layers before, sorted.
    along_curve: Vec<(u64, u32)>,
}

impl Neighbors {
    /// Memory per Gaussian, bytes.
    pub(super) const BYTES_PER_GAUSSIAN: usize =
        size_of::<[u32; 2]>() + size_of::<[u16; 3]>() + size_of::<(u64, u32)>();

    pub(super) fn of(&self, gaussian: usize) -> [u32; 2] {
        self.nearest[gaussian]
    }

    /// Adds the Gaussians of the next layer.
    pub(super) fn extend(&mut self, points: impl Iterator<Item = [u16; 3]>) {
        let start = self.points.len();
        self.points.extend(points);
        let layer: Range<usize> = start..self.points.len();
        let keys: Vec<(u64, u32)> = layer.clone().map(|g| (morton::interleave(self.points[g]), g as u32)).collect();
        for (gaussian, &(key, _)) in layer.clone().zip(&keys) {
            let place = self.along_curve.partition_point(|&(k, _)| k < key);
            let around = place.saturating_sub(REACH)..(place + REACH).min(self.along_curve.len());
            let before = gaussian.saturating_sub(REACH).max(start)..gaussian;
            let candidates = before.rev().map(|g| g as u32).chain(self.along_curve[around].iter().map(|&(_, g)| g));
            let mut best = [(u64::MAX, NONE); 2];
            for candidate in candidates {
                let distance = squared_distance(self.points[gaussian], self.points[candidate as usize]);
                if distance < best[0].0 {
                    best = [(distance, candidate), best[0]];
                } else if distance < best[1].0 {
                    best[1] = (distance, candidate);
                }
            }
            self.nearest.push([best[0].1, best[1].1]);
        }
        self.along_curve.extend(keys);
        self.along_curve.sort_unstable();
    }
}

fn squared_distance(a: [u16; 3], b: [u16; 3]) -> u64 {
    (0..3).map(|i| u64::from(a[i].abs_diff(b[i])).pow(2)).sum()
}
