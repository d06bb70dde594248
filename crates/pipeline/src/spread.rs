//! Evenly spaced selection.

/// At most `count` numbers below `length`, evenly from 0 to the last.
pub fn spread(length: usize, count: usize) -> impl Iterator<Item = usize> {
    let count = count.min(length);
    (0..count).map(move |i| i * (length - 1) / (count - 1).max(1))
}
