//! A curve of successive values, in few points.

/// Points of a curve; at most twice as many.
const NUM_POINTS: usize = 100;

/// Means of stretches of values. When there are too many stretches, each becomes twice as long.
#[derive(Clone, Debug)]
pub(super) struct Curve {
    /// Values of a stretch.
    stretch: usize,
    /// Mean of each whole stretch.
    means: Vec<f64>,
    /// The current stretch: number of values, and their sum.
    open: (usize, f64),
}

impl Default for Curve {
    fn default() -> Self {
        Self { stretch: 1, means: Vec::new(), open: (0, 0.0) }
    }
}

impl Curve {
    pub fn push(&mut self, value: f64) {
        self.open = (self.open.0 + 1, self.open.1 + value);
        if self.open.0 < self.stretch {
            return;
        }
        self.means.push(self.open.1 / self.stretch as f64);
        self.open = (0, 0.0);
        if self.means.len() == 2 * NUM_POINTS {
            self.means = self.means.as_chunks::<2>().0.iter().map(|[a, b]| 0.5 * (a + b)).collect();
            self.stretch *= 2;
        }
    }

    /// Values up to the end of each stretch, and its mean.
    pub fn points(&self) -> Vec<(usize, f64)> {
        self.means.iter().enumerate().map(|(i, &mean)| ((i + 1) * self.stretch, mean)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_curve_has_few_points_and_the_same_shape() {
        let mut curve = Curve::default();
        (0..5).for_each(|i| curve.push(f64::from(i)));
        assert_eq!(curve.points(), [(1, 0.0), (2, 1.0), (3, 2.0), (4, 3.0), (5, 4.0)]);
        (5..1001).for_each(|i| curve.push(f64::from(i)));
        let points = curve.points();
        assert!((NUM_POINTS..2 * NUM_POINTS).contains(&points.len()), "{}", points.len());
        // The mean of a stretch of 8 values that ends before value `end`.
        assert!(points.iter().all(|&(end, mean)| end % 8 == 0 && mean == end as f64 - 4.5), "{points:?}");
    }
}
