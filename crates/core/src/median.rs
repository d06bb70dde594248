//! The upper median.

use crate::Real;

/// The upper median: the middle value in ascending order, or the greater one of the middle two. NaN comes last, or
/// first if its sign is negative.
///
/// - returns: one of the values; `None` without values
///
/// ```
/// assert_eq!(tcgs_core::upper_median([4.0, 1.0, 3.0, 2.0]), Some(3.0));
/// ```
pub fn upper_median<R: Real>(values: impl IntoIterator<Item = R>) -> Option<R> {
    let mut values: Vec<R> = values.into_iter().collect();
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, R::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_middle_value_in_ascending_order() {
        for count in 1..20_u8 {
            let values: Vec<f32> = (0..count).map(|i| f32::from(i * 7 % count)).collect();
            let mut sorted = values.clone();
            sorted.sort_by(f32::total_cmp);
            assert_eq!(upper_median(values), Some(sorted[sorted.len() / 2]));
        }
        assert_eq!(upper_median::<f32>([]), None);
    }
}
