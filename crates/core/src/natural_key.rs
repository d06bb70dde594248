//! The natural order of names: numbers inside them count as numbers.

/// Sort key of a name for the natural order: `cam2` before `cam10`, however long the numbers are. Names that differ
/// only in leading zeros are in the order of their text.
///
/// - `name`: of a file, a camera or a timestep
///
/// ```
/// let mut names = ["cam10", "cam2", "cam02"];
/// names.sort_by_cached_key(|name| tcgs_core::natural_key(name));
/// assert_eq!(names, ["cam02", "cam2", "cam10"]);
/// ```
pub fn natural_key(name: &str) -> impl Ord + use<> {
    let mut runs: Vec<(bool, String)> = Vec::new();
    for c in name.chars() {
        match runs.last_mut() {
            Some((digits, run)) if *digits == c.is_ascii_digit() => run.push(c),
            _ => runs.push((c.is_ascii_digit(), c.into())),
        }
    }
    // Digits come first; of two numbers the longer is the larger.
    let key = |(digits, run): (bool, String)| match digits {
        true => {
            let number = run.trim_start_matches('0');
            (number.len(), number.to_owned())
        }
        false => (usize::MAX, run),
    };
    (runs.into_iter().map(key).collect::<Vec<_>>(), name.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_count_as_numbers() {
        for expected in [
            &["9.ply", "010.ply", "10.ply", "a02b9.ply", "a2b9.ply", "a2b10.ply", "a.ply"][..],
            &["b", "b3_2", "b3_10", "cam02", "cam2", "cam2.x", "cam10"],
            // More digits than an integer holds.
            &["t9.png", "t99999999999999999999.png", "t100000000000000000000.png"],
        ] {
            let mut names: Vec<&str> = expected.iter().rev().copied().collect();
            names.sort_by_cached_key(|name| natural_key(name));
            assert_eq!(names, expected);
        }
    }
}
