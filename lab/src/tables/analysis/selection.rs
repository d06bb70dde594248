//! Methods of selecting keypoints of the same tracks, and cubic curves through them: their errors at equal numbers.

use rayon::prelude::*;
use tcgs_codec::select_keypoints;

use super::{Findings, above_rounding, along, cubic, squared_error};
use crate::tables::figure::Figure;
use crate::tables::table::{self, Cell, Sheet};
use tcgs_report::plot::{Axes, Line};

/// Mean keypoints per track at which the methods are compared.
const BUDGETS: [f64; 9] = [2.25, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 12.0, 20.0];

/// - `tracks`: `[N][3][T]`
pub fn analyse(tracks: &[[Vec<f32>; 3]]) -> Findings {
    let tracks: Vec<&[f32]> = tracks.iter().flatten().map(Vec::as_slice).collect();
    let Some(t) = tracks.first().map(|track| track.len()).filter(|&t| t > 2) else { return Findings::default() };
    // Steps of a third of a decade.
    let sweep = |from: i32, to: i32| (3 * from..=3 * to).map(|i| 10f32.powf(i as f32 / 3.0)).collect::<Vec<_>>();
    let chords = |track: &[f32], indices: Vec<usize>| {
        let error = squared_error(track, &indices);
        (indices, error)
    };
    let methods = [
        (
            "Algorithm 1",
            sweep(-9, 4)
                .into_iter()
                .map(|tau| curve_point(&tracks, |x| chords(x, select_keypoints(x, t, tau).expect("a finite track"))))
                .collect(),
        ),
        (
            "Ramer-Douglas-Peucker",
            sweep(-5, 2).into_iter().map(|xi| curve_point(&tracks, |x| chords(x, ramer(x, xi)))).collect(),
        ),
        ("uniform", (2..=t).map(|count| curve_point(&tracks, |x| chords(x, uniform(t, count)))).collect::<Vec<_>>()),
        (
            "Algorithm 1, cubic",
            sweep(-9, 4).into_iter().map(|tau| curve_point(&tracks, |x| cubic::select(x, tau))).collect(),
        ),
    ];
    let mut sheet = Sheet { title: "mean squared error by keypoints a track".into(), ..Sheet::default() };
    sheet.head = methods.iter().map(|(name, _)| (*name).into()).collect();
    for budget in BUDGETS.into_iter().filter(|&budget| budget < t as f64) {
        let cells = methods
            .iter()
            .map(|(_, curve)| along(curve, budget).map_or_else(Cell::default, |error| Cell::new(error, None)));
        sheet.lines.push(table::Line { label: budget.to_string(), cells: cells.collect() });
    }
    let lines = methods.into_iter().map(|(name, points)| Line { name: name.into(), points }).collect();
    let axes = Axes { x: "keypoints a track, mean".into(), y: "mean squared error".into(), log_x: false, log_y: true };
    let figure = Figure::Lines { title: "Error over keypoints".into(), axes, lines: above_rounding(lines) };
    Findings { sheets: vec![sheet], figures: vec![figure], ..Findings::default() }
}

/// Mean number of keypoints and mean squared error of a selection method.
///
/// - `select`: maps a track to its keypoints and the squared error summed over time
fn curve_point(tracks: &[&[f32]], select: impl Fn(&[f32]) -> (Vec<usize>, f64) + Sync) -> (f64, f64) {
    let of_track = |track: &&[f32]| {
        let (indices, error) = select(track);
        (indices.len() as f64, error / track.len() as f64)
    };
    let all: Vec<(f64, f64)> = tracks.par_iter().map(of_track).collect();
    let sum = all.iter().fold((0.0, 0.0), |sum, x| (sum.0 + x.0, sum.1 + x.1));
    (sum.0 / all.len() as f64, sum.1 / all.len() as f64)
}

/// Keypoints at equal distances, as nearly as samples allow.
fn uniform(t: usize, count: usize) -> Vec<usize> {
    let mut indices: Vec<usize> = (0..count).map(|i| (i * (t - 1) + (count - 1) / 2) / (count - 1)).collect();
    indices.dedup();
    indices
}

/// Ramer-Douglas-Peucker on a function of time: splits where the chord errs most, while the error exceeds `tolerance`.
fn ramer(track: &[f32], tolerance: f32) -> Vec<usize> {
    let mut indices = vec![0, track.len() - 1];
    let mut open = vec![(0, track.len() - 1)];
    while let Some((first, last)) = open.pop() {
        let slope = (track[last] - track[first]) / (last - first) as f32;
        let error = |i: usize| (track[i] - track[first] - slope * (i - first) as f32).abs();
        let worst = (first + 1..last).max_by(|&a, &b| error(a).total_cmp(&error(b)).then(b.cmp(&a)));
        if let Some(worst) = worst.filter(|&i| error(i) > tolerance) {
            indices.push(worst);
            open.extend([(first, worst), (worst, last)]);
        }
    }
    indices.sort_unstable();
    indices
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uniform_keypoints_reach_both_ends() {
        assert_eq!(uniform(9, 3), [0, 4, 8]);
        assert_eq!(uniform(10, 2), [0, 9]);
        assert_eq!(uniform(5, 5), [0, 1, 2, 3, 4]);
    }

    #[test]
    fn ramer_splits_at_corners() {
        let track = [0.0, 1.0, 2.0, 1.0, 0.0, 0.0, 0.0];
        assert_eq!(ramer(&track, 0.1), [0, 2, 4, 6]);
        assert_eq!(ramer(&track, 5.0), [0, 6]);
    }

    #[test]
    fn a_corner_that_is_not_in_the_middle_favours_algorithm_1() {
        let track = |corner: usize| (0..40).map(|i| i.min(corner) as f32).collect::<Vec<_>>();
        let tracks: Vec<[Vec<f32>; 3]> = (3..37).map(|i| [track(i), track(i), vec![0.0; 40]]).collect();
        let sheet = &analyse(&tracks).sheets[0];
        let line = sheet.lines.iter().find(|line| line.label == "2.5").unwrap();
        let value = |i: usize| line.cells[i].value.unwrap();
        assert!(value(0) < value(2) && value(1) < value(2), "{line:?}");
    }
}
