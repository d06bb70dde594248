//! Points in space, found by their distance: a k-d tree.

use std::ops::Range;

/// Most points of a leaf, which are tested one by one.
const LEAF: usize = 12;

/// A tree over points, which it does not move.
pub struct Tree {
    /// Rows of the points; a subtree's rows are adjacent.
    rows: Vec<u32>,
    /// Axis and split position of each subtree. The two children of node `i` are nodes `2 i + 1` and `2 i + 2`.
    splits: Vec<(usize, f32)>,
}

impl Tree {
    /// - `points`: at most 2^32; they need not be finite
    pub fn new(points: &[[f32; 3]]) -> Self {
        let mut tree = Self { rows: (0..points.len() as u32).collect(), splits: Vec::new() };
        tree.split(points, 0, 0..points.len());
        tree
    }

    /// Sorts a subtree into halves along the axis in which it is longest.
    fn split(&mut self, points: &[[f32; 3]], place: usize, range: Range<usize>) {
        if range.len() <= LEAF {
            return;
        }
        let rows = &mut self.rows[range.clone()];
        let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
        for &row in rows.iter() {
            let point = points[row as usize];
            bounds[0] = std::array::from_fn(|i| bounds[0][i].min(point[i]));
            bounds[1] = std::array::from_fn(|i| bounds[1][i].max(point[i]));
        }
        let length = |axis: &usize| bounds[1][*axis] - bounds[0][*axis];
        let axis = (0..3).max_by(|a, b| length(a).total_cmp(&length(b))).unwrap_or(0);
        let middle = rows.len() / 2;
        let along = |row: &u32| points[*row as usize][axis];
        let (_, &mut at, _) = rows.select_nth_unstable_by(middle, |a, b| along(a).total_cmp(&along(b)));
        if self.splits.len() <= place {
            self.splits.resize(place + 1, (0, 0.0));
        }
        self.splits[place] = (axis, points[at as usize][axis]);
        let middle = range.start + middle;
        self.split(points, 2 * place + 1, range.start..middle);
        self.split(points, 2 * place + 2, middle..range.end);
    }

    /// Visits the points within a distance, near ones roughly first, and some others.
    ///
    /// - `take`: receives a row, and returns the distance for the rest of the search
    pub fn visit(&self, point: [f32; 3], distance: f64, take: &mut impl FnMut(usize) -> f64) {
        self.visit_subtree(0, 0..self.rows.len(), point, distance, take);
    }

    fn visit_subtree(
        &self,
        place: usize,
        range: Range<usize>,
        point: [f32; 3],
        mut distance: f64,
        take: &mut impl FnMut(usize) -> f64,
    ) -> f64 {
        if range.len() <= LEAF {
            for &row in &self.rows[range] {
                distance = take(row as usize);
            }
            return distance;
        }
        let (axis, at) = self.splits[place];
        let beyond = f64::from(point[axis]) - f64::from(at);
        let middle = range.start + range.len() / 2;
        let (low, high) = ((2 * place + 1, range.start..middle), (2 * place + 2, middle..range.end));
        let (near, far) = if beyond < 0.0 { (low, high) } else { (high, low) };
        distance = self.visit_subtree(near.0, near.1, point, distance, take);
        if beyond.abs() <= distance {
            distance = self.visit_subtree(far.0, far.1, point, distance, take);
        }
        distance
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_and_all_within_a_distance_are_found() {
        let of = |i: usize, salt: usize| (((i * 7919 + salt * 104_729) % 1009) as f32 / 1009.0 - 0.5).powi(3);
        let mut points: Vec<[f32; 3]> = (0..500).map(|i| [of(i, 1), of(i, 2), 20.0 * of(i, 3)]).collect();
        points.extend([[0.01; 3]; 40]);
        points.extend([[f32::NAN; 3], [f32::INFINITY, 0.0, 0.0]]);
        let tree = Tree::new(&points);
        let distance = |a: [f32; 3], b: [f32; 3]| (0..3).map(|i| f64::from(a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
        for query in (0..60).map(|i| [of(i, 4), of(i, 5), of(i, 6)]) {
            let mut found = Vec::new();
            tree.visit(query, 0.05, &mut |row| {
                found.push(row);
                0.05
            });
            let within = (0..points.len()).filter(|&row| distance(points[row], query) <= 0.05);
            assert!(within.clone().all(|row| found.contains(&row)));
            let mut nearest = f64::INFINITY;
            tree.visit(query, nearest, &mut |row| {
                nearest = nearest.min(distance(points[row], query));
                nearest
            });
            let expected = points.iter().map(|point| distance(*point, query)).fold(f64::INFINITY, f64::min);
            assert_eq!(nearest, expected);
        }
        Tree::new(&[]).visit([0.0; 3], 1.0, &mut |_| panic!("there is no point"));
    }
}
