//! Keypoints of every track under limits: the error of lines between them, and their number.

use rayon::prelude::*;
use tcgs_codec::select_keypoints;
use tcgs_core::{Attribute, DynamicGaussians};

use super::{Findings, squared_error, tracks_of};
use crate::tables::figure::Figure;
use crate::tables::table::{self, Cell, Sheet};
use tcgs_report::plot::{Axes, Line};

/// The tolerance of the paper's figures.
const MAX_MSE: f32 = 1e-6;
/// The paper's limit for Panoptic Sports.
const PAPER_LIMIT: usize = 30;
const LIMITS: [usize; 11] = [2, 3, 4, 6, 8, 10, 15, 20, 30, 45, 60];
const VARYING: [(Attribute, &str); 3] =
    [(Attribute::Mean, "positions"), (Attribute::Quat, "rotations"), (Attribute::Color, "colours")];

/// Sums over the tracks of an attribute under a limit.
#[derive(Clone)]
struct Sums {
    squared_error: f64,
    keypoints: f64,
    /// Number of tracks by number of keypoints.
    histogram: Vec<f64>,
}

/// Errors and numbers of keypoints by limit.
pub fn analyse(scene: &DynamicGaussians) -> Findings {
    let (n, t) = (scene.num_gaussians(), scene.num_timesteps());
    let mut limits: Vec<usize> = LIMITS.into_iter().filter(|&limit| limit <= t).collect();
    limits.push(t.min(PAPER_LIMIT));
    limits.sort_unstable();
    limits.dedup();
    let mut sheet = Sheet { title: "errors and keypoints by limit".into(), ..Sheet::default() };
    sheet.head = vec!["error, all".into()];
    sheet.head.extend(VARYING.map(|(_, name)| format!("error, {name}")));
    sheet.head.extend(VARYING.map(|(_, name)| format!("keypoints, {name}")));
    let mut error = Line { name: "all".into(), points: Vec::new() };
    let mut keypoints = VARYING.map(|(_, name)| Line { name: name.into(), points: Vec::new() });
    let mut figures = Vec::new();
    for &limit in &limits {
        let sums = VARYING.map(|(attribute, _)| sums(scene, attribute, limit));
        let tracks = VARYING.map(|(attribute, _)| (n * attribute.components()) as f64);
        let all: f64 = tracks.iter().sum();
        let total = sums.iter().map(|s| s.squared_error).sum::<f64>() / (all * t as f64);
        let errors = (0..3).map(|i| Cell::new(sums[i].squared_error / (tracks[i] * t as f64), None));
        let numbers = (0..3).map(|i| Cell::new(sums[i].keypoints / tracks[i], Some(2)));
        let cells = std::iter::once(Cell::new(total, None)).chain(errors).chain(numbers).collect();
        sheet.lines.push(table::Line { label: limit.to_string(), cells });
        error.points.push((limit as f64, total));
        for (line, i) in keypoints.iter_mut().zip(0..) {
            line.points.push((limit as f64, sums[i].keypoints / tracks[i]));
        }
        if limit == t.min(PAPER_LIMIT) {
            for ((_, name), sums) in VARYING.into_iter().zip(&sums) {
                figures.push(Figure::Columns {
                    title: format!("{name}: keypoints of a track, at most {limit}"),
                    x: "keypoints".into(),
                    y: "tracks".into(),
                    bars: (2..=limit).map(|k| (k.to_string(), sums.histogram[k])).collect(),
                });
            }
        }
    }
    let axes = |y: &str, log_y| Axes { x: "most keypoints of a track".into(), y: y.into(), log_x: false, log_y };
    let curves = [
        Figure::Lines {
            title: "Interpolation error".into(),
            axes: axes("mean squared error", true),
            lines: vec![error],
        },
        Figure::Lines {
            title: "Mean keypoints".into(),
            axes: axes("keypoints a track", false),
            lines: keypoints.into(),
        },
    ];
    Findings { sheets: vec![sheet], figures: curves.into_iter().chain(figures).collect(), ..Findings::default() }
}

fn sums(scene: &DynamicGaussians, attribute: Attribute, limit: usize) -> Sums {
    let empty = || Sums { squared_error: 0.0, keypoints: 0.0, histogram: vec![0.0; limit + 1] };
    let of_gaussian = |gaussian: usize| {
        tracks_of(scene, attribute, gaussian).into_iter().fold(empty(), |mut sums, track| {
            let indices = select_keypoints(&track, limit, MAX_MSE).expect("a finite track");
            sums.squared_error += squared_error(&track, &indices);
            sums.keypoints += indices.len() as f64;
            sums.histogram[indices.len().min(limit)] += 1.0;
            sums
        })
    };
    // In order, so that sums do not depend on the number of threads.
    let gaussians: Vec<usize> = (0..scene.num_gaussians()).collect();
    let chunks = gaussians.par_chunks(4096).map(|chunk| chunk.iter().map(|&g| of_gaussian(g)).fold(empty(), added));
    chunks.collect::<Vec<_>>().into_iter().fold(empty(), added)
}

fn added(mut sums: Sums, other: Sums) -> Sums {
    sums.squared_error += other.squared_error;
    sums.keypoints += other.keypoints;
    sums.histogram.iter_mut().zip(&other.histogram).for_each(|(sum, x)| *sum += x);
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_bound_keypoints_and_more_of_them_err_less() {
        let mut scene = DynamicGaussians::default();
        for t in 0..12 {
            let mut gaussians = tcgs_core::Gaussians::zeros(2);
            gaussians.quats_mut().fill([1.0, 0.0, 0.0, 0.0]);
            gaussians.means_mut()[1] = [(t as f32).sin(), t as f32, 0.0];
            scene.push(gaussians);
        }
        let findings = analyse(&scene);
        let sheet = &findings.sheets[0];
        let labels: Vec<&str> = sheet.lines.iter().map(|line| line.label.as_str()).collect();
        assert_eq!(labels, ["2", "3", "4", "6", "8", "10", "12"]);
        let value = |line: usize, cell: usize| sheet.lines[line].cells[cell].value.unwrap();
        assert!(value(0, 0) > value(3, 0) && value(5, 0) > value(6, 0));
        assert!(value(6, 0) <= f64::from(MAX_MSE));
        // Five of six coordinates are lines.
        assert_eq!((value(0, 4), value(0, 5), value(0, 6)), (2.0, 2.0, 2.0));
        assert!((value(3, 4) - (5.0 * 2.0 + 6.0) / 6.0).abs() < 1e-12);
    }
}
