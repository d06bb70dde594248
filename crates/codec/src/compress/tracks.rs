//! Tracks of a scene of floats, and the keypoints that stay of them.

use std::ops::Range;

use rayon::prelude::*;
use tcgs_core::{Attribute, DynamicGaussians, dot};

use super::CompressSettings;
use crate::compact::{Tracks, unit_quat};
use crate::keypoints::{Selector, fit_values};

/// Gaussians whose tracks are gathered from the timesteps together: a cache line or more of each.
const BLOCK: usize = 64;

/// Tracks of one attribute after `reduce(values, gaussian, selector, out)`, which is given the `[C, T]` values
/// of a Gaussian and adds a track for each component.
pub(super) fn float_tracks(
    scene: &DynamicGaussians,
    attribute: Attribute,
    reduce: impl Fn(&[f32], usize, &mut Selector, &mut Tracks<f32>) + Sync,
) -> Tracks<f32> {
    let (n, components) = (scene.num_gaussians(), attribute.components());
    let samples = scene.num_samples(attribute);
    let blocks: Vec<Tracks<f32>> = (0..n.div_ceil(BLOCK))
        .into_par_iter()
        .map_init(Selector::default, |selector, block| {
            let gaussians = block * BLOCK..((block + 1) * BLOCK).min(n);
            let values = gather(scene, attribute, gaussians.clone());
            let mut tracks = Tracks::default();
            for (gaussian, values) in gaussians.zip(values.chunks_exact(samples * components)) {
                reduce(values, gaussian, selector, &mut tracks);
            }
            tracks
        })
        .collect();
    let mut tracks = Tracks::default();
    for block in &blocks {
        tracks.append(block);
    }
    tracks
}

/// `[gaussians, components, T]` of one attribute; quaternions of unit length, neighbours in time in one
/// hemisphere, the first with `w >= 0`.
fn gather(scene: &DynamicGaussians, attribute: Attribute, gaussians: Range<usize>) -> Vec<f32> {
    let components = attribute.components();
    let samples = scene.num_samples(attribute);
    let mut tracks = vec![0.0; gaussians.len() * components * samples];
    for timestep in 0..samples {
        let values = &scene.values(attribute, timestep)[gaussians.start * components..gaussians.end * components];
        for (track, value) in tracks.chunks_exact_mut(samples).zip(values) {
            track[timestep] = *value;
        }
    }
    if attribute == Attribute::Quat {
        for tracks in tracks.chunks_exact_mut(4 * samples) {
            // Before the first: no rotation, so that w >= 0.
            let mut before = [1.0, 0.0, 0.0, 0.0];
            for timestep in 0..samples {
                let mut quat = unit_quat(std::array::from_fn(|c| tracks[c * samples + timestep]));
                if dot(quat, before) < 0.0 {
                    quat = quat.map(|x| -x);
                }
                for (channel, &x) in quat.iter().enumerate() {
                    tracks[channel * samples + timestep] = x;
                }
                before = quat;
            }
        }
    }
    tracks
}

/// Keypoints of one track.
pub(super) fn reduce(
    track: &[f32],
    max_mse: f32,
    settings: &CompressSettings,
    selector: &mut Selector,
) -> (Vec<u16>, Vec<f32>) {
    if !settings.keypoints {
        return ((0..track.len()).map(|t| t as u16).collect(), track.to_vec());
    }
    if settings.constant_tracks {
        let count = track.len() as f64;
        let mean = (track.iter().map(|&x| f64::from(x)).sum::<f64>() / count) as f32;
        let mse = track.iter().map(|&x| (f64::from(x) - f64::from(mean)).powi(2)).sum::<f64>() / count;
        if mse <= f64::from(max_mse) {
            return (vec![0], vec![mean]);
        }
    }
    let indices = selector.select(track, settings.max_keypoints, max_mse);
    (indices.iter().map(|&i| i as u16).collect(), indices.iter().map(|&i| track[i]).collect())
}

/// Keypoints that all components of an attribute of a Gaussian share, segment by segment.
///
/// - `values`: `[C, T]`
/// - `tolerances`: `[C]`
pub(super) fn reduce_jointly(
    values: &[f32],
    tolerances: &[f32],
    segment_length: usize,
    settings: &CompressSettings,
    selector: &mut Selector,
    out: &mut Tracks<f32>,
) {
    let num_timesteps = values.len() / tolerances.len();
    let tracks: Vec<&[f32]> = values.chunks_exact(num_timesteps).collect();
    let weights: Vec<f64> = tolerances.iter().map(|&t| 1.0 / f64::from(t).max(1e-30)).collect();
    if settings.constant_tracks && mean_error(&tracks, &weights) <= tracks.len() as f64 {
        tracks.iter().for_each(|track| out.push(&[0], &[mean(track)]));
        return;
    }
    let mut times: Vec<u16> = Vec::new();
    let mut at_keypoints: Vec<Vec<f32>> = vec![Vec::new(); tracks.len()];
    for start in (0..num_timesteps).step_by(segment_length) {
        let span = start..(start + segment_length).min(num_timesteps);
        let tracks: Vec<&[f32]> = tracks.iter().map(|track| &track[span.clone()]).collect();
        let still = settings.constant_tracks && mean_error(&tracks, &weights) <= tracks.len() as f64;
        let limit = FIT_GAIN * tracks.len() as f64;
        let indices = selector.select_joint(&tracks, &weights, if still { 2 } else { settings.max_keypoints }, limit);
        times.extend(indices.iter().map(|&i| (start + i) as u16));
        for (track, at_keypoints) in tracks.iter().zip(&mut at_keypoints) {
            if still {
                at_keypoints.extend(vec![mean(track); indices.len()]);
            } else {
                at_keypoints.extend(fit_values(track, indices));
            }
        }
    }
    at_keypoints.iter().for_each(|values| out.push(&times, values));
}

/// By how much the squared error through samples may exceed the tolerance, since fitted values lower it.
const FIT_GAIN: f64 = 1.5;

fn mean(track: &[f32]) -> f32 {
    (track.iter().map(|&x| f64::from(x)).sum::<f64>() / track.len() as f64) as f32
}

/// Mean over time of the weighted sum of squared distances to the means.
fn mean_error(tracks: &[&[f32]], weights: &[f64]) -> f64 {
    let error = |track: &&[f32]| {
        let mean = f64::from(mean(track));
        track.iter().map(|&x| (f64::from(x) - mean).powi(2)).sum::<f64>() / track.len() as f64
    };
    tracks.iter().zip(weights).map(|(track, weight)| weight * error(track)).sum()
}
