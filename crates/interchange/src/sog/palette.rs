//! A palette: few rows of numbers for many.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Rows, and which of them stands for each row that was given.
pub struct Palette {
    /// `[count * width]`
    pub rows: Vec<f32>,
    /// `[N]`
    pub places: Vec<u16>,
}

/// Rows that one row of the palette stands for.
struct Cluster {
    members: Vec<u32>,
    /// Sum of the squared distances from the mean.
    error: f64,
    /// The column along which they differ most, and its mean.
    widest: (usize, f64),
    /// Equal errors keep their order.
    order: usize,
}

impl Cluster {
    fn of(rows: &[f32], width: usize, members: Vec<u32>, order: usize) -> Self {
        let (mut sums, mut squares) = (vec![0.0; width], vec![0.0; width]);
        for &member in &members {
            for (c, &x) in rows[member as usize * width..][..width].iter().enumerate() {
                sums[c] += f64::from(x);
                squares[c] += f64::from(x) * f64::from(x);
            }
        }
        let n = members.len() as f64;
        let spread = |c: usize| (squares[c] - sums[c] * sums[c] / n).max(0.0);
        let widest = (0..width).fold(0, |widest, c| if spread(c) > spread(widest) { c } else { widest });
        let error = (0..width).map(spread).sum();
        Self { members, error, widest: (widest, sums[widest] / n), order }
    }

    fn mean(&self, rows: &[f32], width: usize) -> Vec<f32> {
        let mut sums = vec![0.0; width];
        for &member in &self.members {
            sums.iter_mut().zip(&rows[member as usize * width..]).for_each(|(sum, &x)| *sum += f64::from(x));
        }
        sums.into_iter().map(|sum| (sum / self.members.len() as f64) as f32).collect()
    }
}

impl Ord for Cluster {
    fn cmp(&self, other: &Self) -> Ordering {
        self.error.total_cmp(&other.error).then(other.order.cmp(&self.order))
    }
}

impl PartialOrd for Cluster {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Cluster {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Cluster {}

/// The rows themselves if there are few enough. Else the means of clusters: the cluster of the largest error is split
/// in two at its mean, along its widest column, until there are enough.
///
/// - `rows`: `[N * width]`, fewer than 2³² rows, at least one
/// - `max_count`: at most 2¹⁶
pub fn palette(rows: &[f32], width: usize, max_count: usize) -> Palette {
    let num_rows = rows.len() / width;
    if num_rows <= max_count {
        return Palette { rows: rows.to_vec(), places: (0..num_rows).map(|i| i as u16).collect() };
    }
    let all = Cluster::of(rows, width, (0..num_rows as u32).collect(), 0);
    let (mut unsplit, mut finished) = (BinaryHeap::from([all]), Vec::new());
    let mut made = 1;
    while let Some(cluster) = unsplit.pop() {
        let (column, mean) = cluster.widest;
        let is_below = |member: &u32| f64::from(rows[*member as usize * width + column]) < mean;
        let is_full = unsplit.len() + finished.len() + 1 >= max_count;
        let (below, above): (Vec<u32>, Vec<u32>) = cluster.members.iter().partition(|member| is_below(member));
        if is_full || below.is_empty() || above.is_empty() {
            finished.push(cluster);
            continue;
        }
        for members in [below, above] {
            unsplit.push(Cluster::of(rows, width, members, made));
            made += 1;
        }
    }
    let mut places = vec![0; num_rows];
    let mut means = Vec::with_capacity(finished.len() * width);
    for (place, cluster) in finished.iter().enumerate() {
        cluster.members.iter().for_each(|&member| places[member as usize] = place as u16);
        means.extend(cluster.mean(rows, width));
    }
    Palette { rows: means, places }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random;

    fn squared_error(rows: &[f32], palette: &Palette, width: usize) -> f64 {
        let row = |all: &[f32], i: usize| all[i * width..][..width].to_vec();
        let errors = palette.places.iter().enumerate().map(|(i, &place)| {
            let (a, b) = (row(rows, i), row(&palette.rows, place.into()));
            a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>()
        });
        errors.sum()
    }

    #[test]
    fn few_rows_are_kept() {
        let rows: Vec<f32> = (0..30).map(|i| i as f32).collect();
        let found = palette(&rows, 3, 10);
        assert_eq!((&found.rows, found.places), (&rows, (0..10).collect()));
    }

    #[test]
    fn groups_of_rows_become_one_row_each() {
        // Five points, each with a hundred neighbours within 0.05.
        let rows: Vec<f32> = (0..500_usize)
            .flat_map(|i| [(i % 5) as f32, ((i * i) % 5) as f32 + 0.05 * (i as f32).sin(), -((i % 5) as f32)])
            .collect();
        let found = palette(&rows, 3, 5);
        assert_eq!(found.rows.len(), 15);
        assert!((0..500).all(|i| found.places[i] == found.places[i % 5]));
        assert!(squared_error(&rows, &found, 3) < 500.0 * 0.05 * 0.05);
    }

    #[test]
    fn more_rows_err_less_and_equal_rows_need_one() {
        let gaussians = random(2000, 0);
        let rows = gaussians.means().as_flattened();
        let errors: Vec<f64> =
            [1, 10, 100, 1000].iter().map(|&count| squared_error(rows, &palette(rows, 3, count), 3)).collect();
        assert!(errors.is_sorted_by(|a, b| a > b) && errors[3] < errors[0] / 50.0, "{errors:?}");
        let same = palette(&[0.25; 300], 3, 10);
        assert_eq!((same.rows, same.places), (vec![0.25; 3], vec![0; 100]));
        // As many as possible are used.
        assert_eq!(palette(rows, 3, 1999).rows.len(), 3 * 1999);
    }
}
