//! The values of a codebook: few numbers for many.

/// Numbers that a codebook holds.
const SIZE: usize = 256;
/// Bins of the density that places the numbers.
const BINS: usize = 4096;
/// Share of the numbers that lie evenly in the range, whatever the density. It bounds the error.
const EVEN: f64 = 0.25;

/// Numbers in ascending order.
pub struct Codebook {
    values: Vec<f32>,
}

impl Codebook {
    /// The values themselves if at most 256 differ. Else the density of the numbers is the density of the values to the
    /// power 1/3, mixed with an even density. The first part minimises the mean squared error. The second bounds each
    /// error by 1/64 of the range of all values.
    ///
    /// Panter and Dite 1951, "Quantization distortion in pulse-count modulation with nonuniform spacing of levels".
    pub fn of(values: impl Iterator<Item = f32>) -> Self {
        let mut sorted: Vec<f32> = values.collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let mut distinct = sorted.clone();
        distinct.dedup();
        distinct.truncate(SIZE + 1);
        let (Some(&low), Some(&high)) = (sorted.first(), sorted.last()) else { return Self { values: vec![0.0] } };
        if distinct.len() <= SIZE {
            return Self { values: distinct };
        }
        let (low, range) = (f64::from(low), f64::from(high) - f64::from(low));
        let edges = edges(&sorted, low, range);
        let mut rest = &sorted[..];
        let mut values = Vec::with_capacity(SIZE);
        for cell in edges.windows(2) {
            let end = if cell[1] == 1.0 {
                rest.len()
            } else {
                rest.partition_point(|&x| f64::from(x) < low + cell[1] * range)
            };
            let (own, behind) = rest.split_at(end);
            rest = behind;
            if !own.is_empty() {
                values.push((own.iter().copied().map(f64::from).sum::<f64>() / own.len() as f64) as f32);
            }
        }
        Self { values }
    }

    /// Place of the nearest number.
    pub fn place(&self, value: f32) -> u8 {
        let above = self.values.partition_point(|&x| x < value).min(self.values.len() - 1);
        let below = above.saturating_sub(1);
        let distance = |place: usize| (f64::from(self.values[place]) - f64::from(value)).abs();
        (if distance(below) <= distance(above) { below } else { above }) as u8
    }

    /// The numbers, the last of them again up to 256, for readers that expect as many.
    pub fn into_values(mut self) -> Vec<f32> {
        let last = self.values[self.values.len() - 1];
        self.values.resize(SIZE, last);
        self.values
    }
}

/// The edges of the cells that each give a number, as shares of the range: from 0 to 1.
fn edges(sorted: &[f32], low: f64, range: f64) -> Vec<f64> {
    let mut counts = vec![0_usize; BINS];
    for &x in sorted {
        counts[(((f64::from(x) - low) / range * BINS as f64) as usize).min(BINS - 1)] += 1;
    }
    let roots: Vec<f64> = counts.iter().map(|&count| (count as f64).cbrt()).collect();
    let sum: f64 = roots.iter().sum();
    let mut edges = vec![0.0];
    let mut before = 0.0;
    for (bin, root) in roots.iter().enumerate() {
        let weight = (1.0 - EVEN) * root / sum + EVEN / BINS as f64;
        // Edges within this bin, where the density is even.
        while edges.len() < SIZE && edges.len() as f64 / SIZE as f64 <= before + weight {
            let within = (edges.len() as f64 / SIZE as f64 - before) / weight;
            edges.push((bin as f64 + within) / BINS as f64);
        }
        before += weight;
    }
    // Rounding may leave out the last ones.
    edges.resize(SIZE + 1, 1.0);
    edges
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_values_are_kept() {
        for n in [1, 2, 255, 256] {
            let values: Vec<f32> = (0..n).map(|i| (i * 37 % n) as f32 / 7.0 - 3.0).collect();
            let book = Codebook::of(values.iter().chain(&values).copied());
            let found: Vec<u8> = values.iter().map(|&x| book.place(x)).collect();
            let numbers = book.into_values();
            assert_eq!(numbers.len(), 256);
            assert!(values.iter().zip(found).all(|(&x, place)| numbers[usize::from(place)] == x));
        }
        assert_eq!(Codebook::of([].into_iter()).into_values(), [0.0; 256]);
    }

    #[test]
    fn errors_are_bounded_and_small_where_values_are_dense() {
        // Most values lie within a hundredth of the range.
        let values: Vec<f32> =
            (0..10_000).map(|i| if i % 100 == 0 { i as f32 / 100.0 } else { 50.0 + (i as f32).sin() / 2.0 }).collect();
        let book = Codebook::of(values.iter().copied());
        let places: Vec<u8> = values.iter().map(|&x| book.place(x)).collect();
        let numbers = book.into_values();
        assert!(numbers.is_sorted());
        let errors: Vec<f32> =
            values.iter().zip(places).map(|(x, place)| (x - numbers[usize::from(place)]).abs()).collect();
        let worst = errors.iter().copied().fold(0.0, f32::max);
        assert!(worst <= 99.0 / 64.0, "{worst}");
        let mean = errors.iter().sum::<f32>() / 1e4;
        // Even steps would have an error of 99 / 256 / 4.
        assert!(mean < 99.0 / 256.0 / 4.0 / 4.0, "{mean}");
    }

    #[test]
    fn numbers_of_any_size_have_a_place() {
        let values: Vec<f32> = (0..1000).map(|i| [f32::MAX, f32::MIN, 0.0, i as f32][i % 4]).collect();
        let book = Codebook::of(values.iter().copied());
        assert_eq!((book.place(f32::MIN), book.place(f32::MAX)), (0, (book.values.len() - 1) as u8));
        assert!(book.into_values().iter().all(|x| x.is_finite()));
    }
}
