//! An order of Gaussians in which neighbours in space are neighbours in a file. Formats whose numbers share ranges, or
//! predict one another, profit from it.

/// Bits of each coordinate: three times as many fit 64.
const BITS: u32 = 21;

/// The Morton order (Z-order curve) of points within their bounding box. Equal points keep their order.
///
/// - `points`: `[N, 3]`
/// - returns: `[N]`, the index of each point in turn
///
/// ```
/// use tcgs_interchange::space_order;
/// let points = [[0.0, 0.0, 0.0], [9.0, 9.0, 9.0], [1.0, 0.0, 0.0], [8.0, 9.0, 9.0]];
/// assert_eq!(space_order(&points), [0, 2, 3, 1]);
/// ```
pub fn space_order(points: &[[f32; 3]]) -> Vec<usize> {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for point in points {
        for c in 0..3 {
            (low[c], high[c]) = (low[c].min(point[c].into()), high[c].max(point[c].into()));
        }
    }
    // One step for all axes: a box that is flat has few different coordinates along its shortest side.
    let size = (0..3).map(|c| high[c] - low[c]).fold(0.0, f64::max);
    let step = f64::from((1_u32 << BITS) - 1) / if size > 0.0 { size } else { 1.0 };
    let code = |point: &[f32; 3]| -> u64 {
        let cell: [u64; 3] = std::array::from_fn(|c| ((f64::from(point[c]) - low[c]) * step) as u64);
        (0..BITS).flat_map(|bit| (0..3).map(move |c| (cell[c] >> bit & 1) << (3 * bit + c as u32))).sum()
    };
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_cached_key(|&i| code(&points[i]));
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random;

    #[test]
    fn neighbours_in_the_order_are_near() {
        let gaussians = random(4096, 0);
        let points = gaussians.means();
        let order = space_order(points);
        let mut each_once = order.clone();
        each_once.sort_unstable();
        assert_eq!(each_once, (0..4096).collect::<Vec<_>>());
        // 256 points of 4096 fill a sixteenth of the box; random ones fill all of it.
        let volume = |indices: &[usize]| -> f32 {
            let span = |c: usize| {
                let of = |i: &usize| points[*i][c];
                let most = indices.iter().map(of).fold(f32::MIN, f32::max);
                most - indices.iter().map(of).fold(f32::MAX, f32::min)
            };
            (0..3).map(span).product()
        };
        let mean = order.chunks(256).map(volume).sum::<f32>() / 16.0;
        assert!(mean < 0.2 * volume(&(0..256).collect::<Vec<_>>()), "{mean}");
    }

    #[test]
    fn any_points_have_an_order() {
        assert_eq!(space_order(&[]), Vec::<usize>::new());
        assert_eq!(space_order(&[[3.0; 3]; 4]), [0, 1, 2, 3]);
        assert_eq!(space_order(&[[f32::MAX; 3], [f32::MIN; 3], [0.0; 3]]), [1, 2, 0]);
    }
}
