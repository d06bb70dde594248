//! Polynomials in time against keypoints, grouped by path length: the better fit at equal numbers.

use rayon::prelude::*;
use tcgs_codec::select_keypoints;

use super::{Findings, above_rounding, along, squared_error};
use crate::tables::figure::Figure;
use crate::tables::table::{self, Cell, Sheet};
use tcgs_report::plot::{Axes, Line};

/// Shares of the Gaussians by path, the slowest first.
const GROUPS: [(&str, f64, f64); 3] =
    [("slower half", 0.0, 0.5), ("fastest tenth", 0.9, 1.0), ("fastest hundredth", 0.99, 1.0)];
/// Degrees in the table; 3 is that of Spacetime Gaussians.
const DEGREES: [usize; 4] = [1, 3, 5, 9];
/// Polynomials of higher degree oscillate between samples.
const MAX_DEGREE: usize = 19;

/// - `tracks`: `[N][3][T]`
pub fn analyse(tracks: &[[Vec<f32>; 3]]) -> Findings {
    let Some(t) = tracks.first().map(|track| track[0].len()).filter(|&t| t > 2) else { return Findings::default() };
    let mut by_path: Vec<(f64, &[Vec<f32>; 3])> = tracks.iter().map(|track| (path(track), track)).collect();
    by_path.sort_by(|a, b| a.0.total_cmp(&b.0));
    let basis = basis(t, MAX_DEGREE.min(t - 1));
    let mut sheet =
        Sheet { title: "root mean square distance from the track, in the scene's unit".into(), ..Sheet::default() };
    sheet.head = vec!["median path".into()];
    let degrees: Vec<usize> = DEGREES.into_iter().filter(|&degree| degree < t - 1).collect();
    for degree in &degrees {
        sheet.head.push(format!("degree {degree}"));
        sheet.head.push(format!("keypoints, {} numbers", degree + 1));
    }
    let mut figures = Vec::new();
    for (name, from, to) in GROUPS {
        let at = |share: f64| (share * by_path.len() as f64) as usize;
        let group = &by_path[at(from).min(by_path.len() - 1)..at(to).max(1)];
        let members: Vec<&[Vec<f32>; 3]> = group.iter().map(|(_, track)| *track).collect();
        let (polynomials, keypoints) = (polynomial_curve(&members, &basis), keypoint_curve(&members));
        let mut cells = vec![Cell::new(group[group.len() / 2].0, Some(3))];
        for degree in &degrees {
            cells.push(Cell::new(polynomials[*degree].1, None));
            let found = along(&keypoints, (degree + 1) as f64);
            cells.push(found.map_or_else(Cell::default, |error| Cell::new(error, None)));
        }
        sheet.lines.push(table::Line { label: name.into(), cells });
        let most = polynomials.last().map_or(0.0, |point| point.0);
        let keypoints = keypoints.into_iter().filter(|point| point.0 <= most).collect();
        let line = |name: &str, points| Line { name: name.into(), points };
        let axes =
            Axes { x: "numbers stored a coordinate".into(), y: "distance, RMS".into(), log_x: false, log_y: true };
        let lines = above_rounding(vec![line("polynomials", polynomials), line("keypoints", keypoints)]);
        figures.push(Figure::Lines { title: format!("Positions of the {name}"), axes, lines });
    }
    Findings { sheets: vec![sheet], figures, ..Findings::default() }
}

/// Path length of a Gaussian.
fn path(track: &[Vec<f32>; 3]) -> f64 {
    (1..track[0].len()).map(|t| track.iter().map(|x| f64::from(x[t] - x[t - 1]).powi(2)).sum::<f64>().sqrt()).sum()
}

/// Orthonormal polynomials over the timesteps: `[degree + 1][T]`.
fn basis(t: usize, degree: usize) -> Vec<Vec<f64>> {
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for power in 0..=degree {
        let x = |i: usize| 2.0 * i as f64 / (t - 1) as f64 - 1.0;
        // The previous one times x spans the same space, and keeps digits.
        let mut next: Vec<f64> = match basis.last() {
            None => vec![1.0; t],
            Some(last) => last.iter().enumerate().map(|(i, y)| y * x(i)).collect(),
        };
        debug_assert_eq!(basis.len(), power);
        // Two passes of orthogonalisation are enough.
        for _ in 0..2 {
            for known in &basis {
                let along: f64 = known.iter().zip(&next).map(|(a, b)| a * b).sum();
                next.iter_mut().zip(known).for_each(|(y, k)| *y -= along * k);
            }
        }
        let length = next.iter().map(|y| y * y).sum::<f64>().sqrt();
        next.iter_mut().for_each(|y| *y /= length);
        basis.push(next);
    }
    basis
}

/// Stored numbers per coordinate and error, by degree.
fn polynomial_curve(tracks: &[&[Vec<f32>; 3]], basis: &[Vec<f64>]) -> Vec<(f64, f64)> {
    let of_track = |track: &&[Vec<f32>; 3]| {
        let mut left = vec![0.0; basis.len()];
        for coordinate in *track {
            let mut residual: Vec<f64> = coordinate.iter().map(|&x| f64::from(x)).collect();
            for (polynomial, left) in basis.iter().zip(&mut left) {
                let along: f64 = polynomial.iter().zip(&residual).map(|(a, b)| a * b).sum();
                residual.iter_mut().zip(polynomial).for_each(|(x, p)| *x -= along * p);
                *left += residual.iter().map(|x| x * x).sum::<f64>();
            }
        }
        left
    };
    let all: Vec<Vec<f64>> = tracks.par_iter().map(of_track).collect();
    let samples = (tracks.len() * basis[0].len()) as f64;
    (0..basis.len())
        .map(|degree| {
            let sum: f64 = all.iter().map(|left| left[degree]).sum();
            ((degree + 1) as f64, (sum / samples).sqrt())
        })
        .collect()
}

/// The same for keypoints, by tolerance: a value each, and a time for all but the ends.
fn keypoint_curve(tracks: &[&[Vec<f32>; 3]]) -> Vec<(f64, f64)> {
    let t = tracks[0][0].len();
    // The highest tolerance exceeds every track's error, so that all tracks have only their ends.
    (-36..=16)
        .map(|i| {
            let tolerance = 10f32.powf(i as f32 / 4.0);
            let of_track = |track: &&[Vec<f32>; 3]| {
                track.iter().fold((0.0, 0.0), |(numbers, error), coordinate| {
                    let indices = select_keypoints(coordinate, t, tolerance).expect("a finite track");
                    (numbers + (2 * indices.len() - 2) as f64, error + squared_error(coordinate, &indices))
                })
            };
            let all: Vec<(f64, f64)> = tracks.par_iter().map(of_track).collect();
            let sum = all.iter().fold((0.0, 0.0), |sum, x| (sum.0 + x.0, sum.1 + x.1));
            (sum.0 / (3 * tracks.len()) as f64, (sum.1 / (tracks.len() * t) as f64).sqrt())
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_fitted_by_degree_3() {
        let cubic: Vec<f32> = (0..20).map(|i| (i as f32 / 10.0 - 1.0).powi(3) + 5.0).collect();
        let track = [cubic.clone(), cubic.clone(), cubic];
        let curve = polynomial_curve(&[&track], &basis(20, 4));
        assert!(curve[2].1 > 0.01 && curve[3].1 < 1e-6, "{curve:?}");
        assert_eq!(curve[3].0, 4.0);
    }

    #[test]
    fn a_bounce_is_followed_by_keypoints_not_by_polynomials() {
        // Straight there and back, with a different turn for each.
        let bounce = |turn: usize| (0..60).map(|i| i.min(2 * turn - i.min(2 * turn)) as f32 / 10.0).collect::<Vec<_>>();
        let tracks: Vec<[Vec<f32>; 3]> = (20..40).map(|i| [bounce(i), bounce(i), vec![0.0; 60]]).collect();
        let findings = analyse(&tracks);
        let line = &findings.sheets[0].lines[1];
        let (cubic, keypoints) = (line.cells[3].value.unwrap(), line.cells[4].value.unwrap_or(0.0));
        assert!(keypoints < 0.1 * cubic, "{line:?}");
    }

    #[test]
    fn the_basis_is_orthonormal() {
        let basis = basis(150, MAX_DEGREE);
        for (i, a) in basis.iter().enumerate() {
            for (j, b) in basis.iter().enumerate() {
                let product: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-10, "{i}, {j}: {product}");
            }
        }
    }
}
