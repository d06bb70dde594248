//! The extent of the bulk of a scene.

use crate::distance;

/// Share of the Gaussians whose centres lie within [`Extent::radius`]: a few Gaussians far away do not matter.
const WITHIN: f64 = 0.75;

/// Middle and radius of the bulk of a scene, robust against a few Gaussians far away.
///
/// Compression derives its tolerance of positions from the radius where the unit of a scene is unknown, so another
/// definition of the extent changes the bytes of files.
///
/// ```
/// use tcgs_core::Extent;
/// let extent = Extent::of(&[[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0], [900.0, 0.0, 0.0]]);
/// assert_eq!((extent.center, extent.radius), ([2.0, 0.0, 0.0], 2.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Extent {
    /// Median of the centres along each axis, scene units.
    pub center: [f64; 3],
    /// Distance from `center` within which three quarters of the centres lie, scene units.
    pub radius: f64,
}

impl Extent {
    /// The extent of some centres; zero at the origin if there are none.
    ///
    /// - `means`: `[N, 3]`, finite
    pub fn of(means: &[[f32; 3]]) -> Self {
        let center: [f64; 3] = std::array::from_fn(|axis| quantile(means.iter().map(|m| f64::from(m[axis])), 0.5));
        Self { center, radius: quantile(means.iter().map(|m| distance(m.map(f64::from), center)), WITHIN) }
    }
}

/// The value at rank `⌊share (N − 1)⌋` in ascending order; 0 of no values.
fn quantile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    if values.is_empty() {
        return 0.0;
    }
    let index = (share * (values.len() - 1) as f64) as usize;
    *values.select_nth_unstable_by(index, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_center_is_the_median_and_the_radius_holds_three_quarters() {
        // Distances 0, 1, …, 100 from the median, on either side in turn.
        let means: Vec<[f32; 3]> =
            (0..=100_u8).map(|i| [7.0 + if i % 2 == 0 { 1.0 } else { -1.0 } * f32::from(i), -2.0, 0.5]).collect();
        let Extent { center, radius } = Extent::of(&means);
        assert_eq!((center, radius), ([7.0, -2.0, 0.5], 75.0));
    }

    #[test]
    fn a_few_far_away_do_not_matter() {
        let mut means = vec![[1.0, 2.0, 3.0]; 100];
        means[7] = [1e9, 0.0, 0.0];
        assert_eq!(Extent::of(&means), Extent { center: [1.0, 2.0, 3.0], radius: 0.0 });
        assert_eq!(Extent::of(&[]), Extent { center: [0.0; 3], radius: 0.0 });
    }
}
