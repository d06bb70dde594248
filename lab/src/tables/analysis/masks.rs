//! Changes of masks over time.

use tcgs_core::sigmoid;

use super::Findings;
use crate::tables::figure::Figure;
use tcgs_report::plot::{Axes, Line};

/// Curves of each kind.
const SHOWN: usize = 4;

/// - `logits`: `[T][N]`
/// - `threshold`: a Gaussian whose mask exceeds it is drawn
pub fn analyse(logits: &[Vec<f32>], threshold: f32) -> Findings {
    let (t, n) = (logits.len(), logits.first().map_or(0, Vec::len));
    if n == 0 {
        return Findings::default();
    }
    let value = |timestep: usize, gaussian: usize| f64::from(sigmoid(logits[timestep][gaussian]));
    let way = |g: usize| (1..t).map(|i| (value(i, g) - value(i - 1, g)).abs()).sum::<f64>();
    let mut by_way: Vec<(f64, usize)> = (0..n).map(|g| (way(g), g)).collect();
    let change = by_way.iter().map(|x| x.0).sum::<f64>() / (n * (t - 1).max(1)) as f64;
    let drawn = |g: usize| (0..t).filter(|&i| value(i, g) > f64::from(threshold)).count();
    let switched = (0..n).filter(|&g| (1..t).contains(&drawn(g))).count() as f64 / n as f64;
    let mean = |g: usize| (0..t).map(|i| value(i, g)).sum::<f64>() / t as f64;
    let kept = (0..n).filter(|&g| mean(g) > f64::from(threshold)).count() as f64 / n as f64;
    by_way.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let most = by_way.iter().take(SHOWN).map(|&(_, g)| ("changes most", g));
    let spread = (0..SHOWN.min(n)).map(|i| ("any", (2 * i + 1) * n / (2 * SHOWN)));
    let lines = most
        .chain(spread)
        .map(|(what, g)| Line {
            name: format!("{what}: {g}"),
            points: (0..t).map(|i| (i as f64, value(i, g))).collect(),
        })
        .collect();
    let axes = Axes { x: "timestep".into(), y: "mask value".into(), log_x: false, log_y: false };
    let values = [("change", change), ("switched", switched), ("kept", kept)];
    Findings {
        values: values.map(|(name, value)| (name.to_owned(), value)).into(),
        sheets: Vec::new(),
        figures: vec![Figure::Lines { title: "Masks over time".into(), axes, lines }],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_moves_is_counted() {
        // Three stay, one of them masked out; one goes from drawn to masked out and back.
        let logits: Vec<Vec<f32>> = (0..3).map(|t| vec![5.0, 5.0, -20.0, if t == 1 { -20.0 } else { 0.0 }]).collect();
        let findings = analyse(&logits, 0.01);
        assert!((findings.values["change"] - 2.0 * 0.5 / 8.0).abs() < 1e-6);
        assert_eq!((findings.values["switched"], findings.values["kept"]), (0.25, 0.75));
        let Figure::Lines { lines, .. } = &findings.figures[0] else { panic!("a figure of lines") };
        assert_eq!(lines[0].name, "changes most: 3");
    }
}
