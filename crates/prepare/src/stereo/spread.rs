//! Points without any depth: for cameras that stand too far apart to be compared, with masks or without.
//!
//! Points are strewn through the ball that the cameras look at. The points on which cameras agree best in colour stay.
//! This measures no depth, but surfaces are likelier there than elsewhere. Training moves and removes the rest.

use rayon::prelude::*;
use tcgs_capture::{Capture, Split};
use tcgs_core::{Pinhole, View, add_scaled, distance, length};

use super::patchmatch::Random;
use super::shell::Shell;
use super::thin;
use super::vantage::Vantage;
use super::{Hull, Origin, Point, Prepared, Stereo, StereoSettings, median, solve};
use crate::PrepareError;

/// Number of points that are tried for each that stays.
const TRIALS: usize = 12;
/// Radius of the ball, over the mean distance of the cameras from the place that they look at.
const BALL_SHARE: f64 = 0.6;
/// Radius of the shell, over the largest distance of a camera from the place that they look at.
const SHELL_SHARE: f32 = 2.0;
/// Share of the points that are on the shell.
const ON_SHELL: f64 = 0.3;

/// Strews points through the scene of the training cameras of the first frame, for cameras that stand too far apart for
/// [`stereo_points`](super::stereo_points). No depth is known, but training has something to move.
///
/// - `capture`: with at least two training cameras; its own points, if there are any, are not used
/// - returns: at most about as many points as the settings say, all of them foreground; none has a measured depth
///
/// Equal captures and settings give equal points, whatever the number of threads.
///
/// # Errors
/// [`PrepareError`] if there is one camera only, if an image cannot be decoded, or if the cameras do not look at one
/// place.
pub fn spread_points(capture: &Capture, settings: &StereoSettings) -> Result<Prepared, PrepareError> {
    let views = capture.views(Split::Train, 0, 1)?;
    if views.len() < 2 {
        return Err(PrepareError::invalid(capture.path(), "has 1 training camera, expected at least 2"));
    }
    spread(&views, settings).ok_or_else(|| {
        PrepareError::invalid(capture.path(), "has no place that the cameras look at, expected cameras around a scene")
    })
}

/// Strews points, if the cameras look at one place from several sides.
fn spread(views: &[View], settings: &StereoSettings) -> Option<Prepared> {
    let widest = views.iter().map(|view| view.camera.width).max().unwrap_or(1);
    let factor = widest.div_ceil(settings.image_width).max(1);
    let (place, far) = looked_at(views)?;
    let vantages: Vec<Vantage> = views.par_iter().map(|view| Vantage::new(view, factor)).collect();
    let radius = (BALL_SHARE * far) as f32;
    let num_within = ((1.0 - ON_SHELL) * settings.num_points as f64) as usize;
    let mut tried: Vec<(f32, Point)> = (0..TRIALS * num_within)
        .into_par_iter()
        .filter_map(|i| {
            let mut random = Random::new(settings.seed, i as u64);
            let offset: [f32; 3] = std::array::from_fn(|_| random.signed());
            let position = add_scaled(place, radius, offset);
            let inside = length(offset) <= 1.0;
            inside.then(|| judged(&vantages, position)).flatten()
        })
        .collect();
    // Stable, so that equal points keep the order in which they were tried.
    tried.sort_by(|a, b| a.0.total_cmp(&b.0));
    let kept = tried.into_iter().take(num_within).map(|(_, point)| point);

    let farthest = vantages.iter().map(|v| distance(v.pinhole.center, place)).fold(0.0, f32::max);
    let shell = Shell::around(place, SHELL_SHARE * farthest);
    let (maps, witnesses, hull_surface) = (Vec::new(), Vec::new(), Vec::new());
    let around = Vec::new();
    let stereo = Stereo { vantages, maps, witnesses, hull: Hull::default(), hull_surface, around };
    let ended = thin::thin(&[stereo.ended(&[], &shell)], settings.num_points - num_within);

    let mut prepared = Prepared::default();
    let kept = kept.map(|point| (Origin::Strewn, point));
    for (origin, Point { position, color, .. }) in
        kept.chain(ended.into_iter().map(|(_, point)| (Origin::Shell, point)))
    {
        let cloud = &mut prepared.cloud;
        cloud.points.push(position);
        cloud.colors.push(color.map(|c| c.clamp(0.0, 1.0)));
        // The moving points are unknown, so all are foreground.
        cloud.foreground.push(true);
        prepared.origins.push(origin);
    }
    Some(prepared)
}

/// A point in the colours of the views that see it, and by how much these differ; `None` if fewer than two do.
fn judged(vantages: &[Vantage], position: [f32; 3]) -> Option<(f32, Point)> {
    let seen = vantages.iter().filter_map(|vantage| {
        let (pixel, _) = vantage.pinhole.pixel(position)?;
        Some(vantage.colors[pixel])
    });
    let colors: Vec<[f32; 3]> = seen.collect();
    if colors.len() < 2 {
        return None;
    }
    let color = median(&colors);
    let differences = colors.iter().flat_map(|seen| (0..3).map(move |k| (seen[k] - color[k]).abs()));
    // More views that agree are stronger evidence.
    let score = differences.sum::<f32>() / (colors.len() * (colors.len() - 1)) as f32;
    Some((score, Point { position, color, foreground: true }))
}

/// The place that is nearest to all lines of sight, and the mean distance of the cameras from it.
fn looked_at(views: &[View]) -> Option<([f32; 3], f64)> {
    let pinholes: Vec<Pinhole<f64>> = views.iter().map(|view| Pinhole::new(&view.camera)).collect();
    let mut rows = [[0.0; 4]; 3];
    for pinhole in &pinholes {
        let (center, forward) = (pinhole.center, pinhole.forward());
        for i in 0..3 {
            for j in 0..3 {
                let share = f64::from(u8::from(i == j)) - forward[i] * forward[j];
                rows[i][j] += share;
                rows[i][3] += share * center[j];
            }
        }
    }
    let place: [f64; 3] = solve(rows)?;
    let before = |pinhole: &Pinhole<f64>| pinhole.camera_point(place)[2];
    let distance = pinholes.iter().map(before).sum::<f64>() / pinholes.len() as f64;
    // A place behind the cameras is in no camera's sight.
    (distance > 0.0 && pinholes.iter().filter(|p| before(p) > 0.0).count() * 2 > pinholes.len())
        .then(|| (place.map(|x| x as f32), distance))
}
