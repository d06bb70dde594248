//! Analyses of results that neither `compress` nor `eval` measures: the behaviour of tracks and masks.

mod cubic;
mod masks;
mod polynomials;
mod selection;
mod tracks;

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::Context;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tcgs_core::{Attribute, DynamicGaussians};
use tcgs_train::{Run, TrainedScene, mean_masks};

use super::figure::Figure;
use super::table::Sheet;
use tcgs_report::plot::Line;

/// The findings of an analysis.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Findings {
    /// Values for columns of a table.
    pub values: BTreeMap<String, f64>,
    /// Tables of its own.
    pub sheets: Vec<Sheet>,
    /// Plots of its own.
    pub figures: Vec<Figure>,
}

/// Analyses a trained run.
///
/// - `name`: as in a table's file
/// - `run`: the run's folder
pub fn analyse(name: &str, run: &Path) -> anyhow::Result<Value> {
    let run = Run::open(run)?;
    let trained = run.trained()?;
    let findings = match name {
        "tracks" => tracks::analyse(&kept(&run, &trained).0),
        "selection" => selection::analyse(&foreground(&run, &trained)),
        "polynomials" => polynomials::analyse(&foreground(&run, &trained)),
        "masks" => masks::analyse(&throughout(&trained), run.config().mask.threshold),
        _ => anyhow::bail!("{name}: no analysis of this name"),
    };
    serde_json::to_value(findings).with_context(|| format!("the analysis {name} as JSON"))
}

/// The scene without Gaussians that are masked over time, and whether each of the others is foreground.
fn kept(run: &Run, trained: &TrainedScene) -> (DynamicGaussians, Vec<bool>) {
    let threshold = if run.config().mask.enabled { run.config().mask.threshold } else { -1.0 };
    let means = mean_masks(&trained.mask_logits, trained.lives.as_ref());
    let keep: Vec<usize> = (0..means.len()).filter(|&i| means[i] > threshold).collect();
    (trained.scene.select(&keep), keep.iter().map(|&i| trained.foreground[i]).collect())
}

/// Mask logits `[T][N]` of the Gaussians that live at all timesteps.
fn throughout(trained: &TrainedScene) -> Vec<Vec<f32>> {
    let Some(lives) = &trained.lives else { return trained.mask_logits.clone() };
    let last = trained.mask_logits.len().saturating_sub(1);
    let whole = |id: &usize| lives[*id].birth == 0 && lives[*id].death as usize > last;
    let of_timestep = |(timestep, logits): (usize, &Vec<f32>)| {
        let living = lives.living(timestep);
        living.iter().zip(logits).filter(|(id, _)| whole(id)).map(|(_, &logit)| logit).collect()
    };
    trained.mask_logits.iter().enumerate().map(of_timestep).collect()
}

/// Positions of the foreground: `[N][3][T]`; of all Gaussians if there is no foreground.
fn foreground(run: &Run, trained: &TrainedScene) -> Vec<[Vec<f32>; 3]> {
    let (scene, is_foreground) = kept(run, trained);
    let all = !is_foreground.contains(&true);
    (0..scene.num_gaussians())
        .filter(|&i| all || is_foreground[i])
        .map(|i| std::array::from_fn(|axis| (0..scene.num_timesteps()).map(|t| scene.means(t)[i][axis]).collect()))
        .collect()
}

/// The tracks of an attribute of one Gaussian, `[C][T]`. Rotations have unit length and one sign over time, as in
/// compression.
fn tracks_of(scene: &DynamicGaussians, attribute: Attribute, gaussian: usize) -> Vec<Vec<f32>> {
    let components = attribute.components();
    let mut tracks = vec![Vec::with_capacity(scene.num_timesteps()); components];
    let mut last: Vec<f32> = Vec::new();
    for timestep in 0..scene.num_timesteps() {
        let at = gaussian * components;
        let mut values = scene.values(attribute, timestep)[at..at + components].to_vec();
        if attribute == Attribute::Quat {
            let length = values.iter().map(|x| x * x).sum::<f32>().sqrt();
            let against = last.iter().zip(&values).map(|(a, b)| a * b).sum::<f32>() < 0.0;
            let factor = if against { -1.0 } else { 1.0 } / length.max(f32::MIN_POSITIVE);
            values.iter_mut().for_each(|x| *x *= factor);
        }
        for (track, &value) in tracks.iter_mut().zip(&values) {
            track.push(value);
        }
        last = values;
    }
    tracks
}

/// Squared error, summed over time, of straight lines between some samples.
fn squared_error(track: &[f32], indices: &[usize]) -> f64 {
    let mut sum = 0.0;
    for pair in indices.windows(2) {
        let (a, b) = (f64::from(track[pair[0]]), f64::from(track[pair[1]]));
        for i in pair[0] + 1..pair[1] {
            let between = a + (b - a) * (i - pair[0]) as f64 / (pair[1] - pair[0]) as f64;
            sum += (f64::from(track[i]) - between).powi(2);
        }
    }
    sum
}

/// Cuts falling curves to some decades below the highest point: the rest is rounding.
fn above_rounding(mut lines: Vec<Line>) -> Vec<Line> {
    let highest = lines.iter().flat_map(|line| &line.points).map(|point| point.1).fold(0.0, f64::max);
    for line in &mut lines {
        line.points.retain(|point| point.1 >= 1e-6 * highest);
    }
    lines
}

/// The ordinate of a falling curve at an abscissa, interpolated along the logarithm; none outside of the curve.
fn along(curve: &[(f64, f64)], x: f64) -> Option<f64> {
    let mut sorted = curve.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    sorted.windows(2).find(|pair| pair[0].0 <= x && x <= pair[1].0 && pair[0].0 < pair[1].0).map(|pair| {
        let share = (x - pair[0].0) / (pair[1].0 - pair[0].0);
        let floor = |y: f64| y.max(1e-300).ln();
        (floor(pair[0].1) + share * (floor(pair[1].1) - floor(pair[0].1))).exp()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_those_of_the_chords() {
        let track = [0.0, 1.0, 2.0, 1.0, 0.0];
        assert_eq!(squared_error(&track, &[0, 4]), 6.0);
        assert_eq!(squared_error(&track, &[0, 2, 4]), 0.0);
    }

    #[test]
    fn curves_are_read_between_their_points() {
        let curve = [(4.0, 1.0), (2.0, 100.0)];
        assert!((along(&curve, 3.0).unwrap() - 10.0).abs() < 1e-9);
        assert_eq!(along(&curve, 5.0), None);
    }

    #[test]
    fn rotations_keep_their_sign() {
        let mut scene = DynamicGaussians::default();
        for sign in [1.0, -1.0, 1.0] {
            let mut gaussians = tcgs_core::Gaussians::zeros(1);
            gaussians.quats_mut()[0] = [0.0, 2.0 * sign, 0.0, 0.0];
            scene.push(gaussians);
        }
        assert_eq!(tracks_of(&scene, Attribute::Quat, 0)[1], [1.0; 3]);
    }
}
