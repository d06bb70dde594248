//! Refines a calibration by the images of its own cameras.

use std::ops::ControlFlow;
use std::path::Path;

use rayon::prelude::*;
use tcgs_capture::CaptureDescription;
use tcgs_core::upper_median;

use super::bundle::{self, Freedom, Track};
use super::camera::RigCamera;
use super::frames::{Frames, moments};
use super::matches::{self, Shot};
use super::meant;
use super::patch::likeness;
use crate::PrepareError;

/// Number of moments whose images are matched.
const NUM_MOMENTS: usize = 4;
/// Correlation above which a place has not changed over time.
const STILL: f32 = 0.95;
/// Search band around the calibration's projection, share of the image's longer side: first, and in later rounds.
/// Calibrations with larger errors are wrong, and are not mended.
pub(super) const BANDS: [f64; 3] = [0.01, 0.005, 0.003];
/// Assumed error of the calibration in the first fit, share of the image's longer side.
const COARSE: f64 = 0.005;
/// Typical errors of a calibration, as priors.
const FREEDOM: Freedom = Freedom { turn: 0.03, shift: 0.05, log_focal: 0.02, k1: 0.03 };
/// One of so many regions of each image is held out: its tracks judge, and are not fitted.
const HELD_OUT: usize = 4;
/// Regions along the longer side of an image.
const REGIONS: f64 = 12.0;
/// A track closer than this to a held-out one is not fitted, share of the longer side.
const TOUCHING: f64 = 0.004;
/// A camera with fewer fitted tracks than this stays where it is.
pub(super) const MIN_TRACKS: usize = 12;
/// A camera is alone if others have this many times as many tracks.
const ALONE: usize = 20;
/// Two cameras belong together if they share at least one of so many of the tracks that each shares with its strongest
/// partner. In rendered rooms with two papers cameras share a twentieth by chance.
const WEAK: usize = 8;
/// Minimum number of held-out tracks for a judgement.
pub(super) const MIN_JUDGES: usize = 20;
/// Minimum ratio of tracks to chance matches for cameras that see the same.
const BEYOND_CHANCE: usize = 2;
/// Roll of each control camera against the one before, radians, for counting chance matches.
const ASIDE: f64 = 0.15;
/// The new calibration replaces the old if the median errors of held-out tracks, averaged over cameras, fall to
/// [`BETTER`] of the old, and no camera's error rises above [`NO_WORSE`].
pub(super) const BETTER: f64 = 0.9;
pub(super) const NO_WORSE: f64 = 1.2;
/// Errors below this are not distinguished, pixels.
const EXACT_PX: f64 = 0.1;

/// Result of refining a calibration, judged by tracks that were not fitted.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Refinement {
    /// Whether the new calibration was better, and taken.
    pub is_taken: bool,
    /// Number of fitted tracks, and of judging tracks.
    pub num_tracks: [usize; 2],
    /// Mean of [`Self::camera_error_px`].
    pub error_px: [f64; 2],
    /// For each camera, in the description's order, the median reprojection error of tracks in pixels, before and
    /// after. If the calibration was not replaced, "after" is the error that it would have had. `None` where too few
    /// tracks judge.
    pub camera_error_px: Vec<Option<[f64; 2]>>,
    /// The change to all poses beforehand, in words, if they were written down in another convention than their format
    /// has.
    pub mended: Option<String>,
    /// The cameras, by their index in the description, that share hardly any place with the others, while the others
    /// share many.
    pub alone: Vec<usize>,
    /// Groups of cameras, by their places in the description, that share hardly any place with each other. Fewer than
    /// two groups if all see one scene. Cameras of [`Self::alone`] are in no group.
    pub groups: Vec<Vec<usize>>,
}

/// Mends poses in a wrong convention where this is certain. Refines poses, focal lengths and the first coefficient of
/// distortion of a description's cameras, where that is better.
///
/// Corners are matched between neighbouring cameras at several moments. A quarter of the regions of every image is held
/// out, and a robust bundle adjustment fits the cameras to the rest. The rig as a whole keeps place, direction and
/// size.
///
/// - `folder`: the folder that the description's files are relative to
/// - `tell`: called with a description of each step; a break ends the work
/// - returns: `None` if `tell` ended the work, or if the cameras have too little in common to judge: too few tracks, or
///   no more than match by chance. The description is then unchanged
///
/// # Errors
/// [`PrepareError`] if an image cannot be decoded.
pub fn refine_cameras(
    folder: &Path,
    description: &mut CaptureDescription,
    tell: &mut dyn FnMut(&str) -> ControlFlow<()>,
) -> Result<Option<Refinement>, PrepareError> {
    let mut before: Vec<RigCamera> = description.cameras.iter().map(RigCamera::new).collect();
    if before.len() < 2 || tell("reading images").is_break() {
        return Ok(None);
    }
    let shots = shots(&Frames::open(folder, description)?, description.num_frames)?;
    if tell("matching").is_break() {
        return Ok(None);
    }
    let mut first = tracks(&before, &shots, BANDS[0]);
    let meant = meant::find(&before, &first[0], &shots[0], BANDS[0]);
    let mended = meant.map(|(cameras, words)| {
        first = tracks(&cameras, &shots, BANDS[0]);
        before = cameras;
        words
    });
    if !is_beyond_chance(&before, &first, &shots, BANDS[0]) {
        return Ok(None);
    }
    let alone = alone(&first, before.len());
    let groups = groups(&first, before.len(), &alone);
    let (judges, fitted) = held_out(first, &before);
    let num_judges: usize = judges.iter().map(Vec::len).sum();
    if num_judges < MIN_JUDGES {
        return Ok(None);
    }
    let mut after = before.clone();
    let mut num_fitted = fit(&mut after, fitted);
    for band in &BANDS[1..] {
        if tell("matching again").is_break() {
            return Ok(None);
        }
        let more = apart_from(tracks(&after, &shots, *band), &judges, &before);
        num_fitted = fit(&mut after, more);
    }
    let mut refinement = judge(&before, &after, &judges);
    refinement.num_tracks = [num_fitted, num_judges];
    if refinement.is_taken || mended.is_some() {
        let best = if refinement.is_taken { &after } else { &before };
        for (camera, rig) in description.cameras.iter_mut().zip(best) {
            rig.put_into(camera);
        }
    }
    (refinement.mended, refinement.alone, refinement.groups) = (mended, alone, groups);
    for (camera, errors) in description.cameras.iter_mut().zip(&refinement.camera_error_px) {
        let shown = if refinement.is_taken { errors.map(|[_, after]| after) } else { errors.map(|[before, _]| before) };
        camera.error_px = shown.map(|px| (1e3 * px).round() / 1e3);
    }
    Ok(Some(refinement))
}

/// Whether the first moment has clearly more tracks than match by chance.
///
/// - `band`: the search band of `tracks`
pub(super) fn is_beyond_chance(cameras: &[RigCamera], tracks: &[Vec<Track>], shots: &[Vec<Shot>], band: f64) -> bool {
    let by_chance = matches::find(&turned_aside(cameras), &shots[0], band).len();
    tracks[0].len() >= BEYOND_CHANCE * by_chance
}

/// The frames whose images are matched.
pub(super) fn moments_of(num_frames: usize) -> Vec<usize> {
    moments(num_frames, NUM_MOMENTS)
}

/// Pictures at several moments; later moments have only the corners that were not there before.
pub(super) fn shots(frames: &Frames, num_frames: usize) -> Result<Vec<Vec<Shot>>, PrepareError> {
    let mut all: Vec<Vec<Shot>> = Vec::new();
    for frame in moments_of(num_frames) {
        let mut shots: Vec<Shot> = frames.at(frame)?.par_iter().map(Shot::new).collect();
        for earlier in &all {
            shots.par_iter_mut().zip(earlier).for_each(|(shot, earlier)| {
                let Shot { pyramid, corners } = shot;
                corners.retain(|corner| likeness(pyramid, &earlier.pyramid, corner) < STILL);
            });
        }
        all.push(shots);
    }
    Ok(all)
}

/// The tracks of each moment.
pub(super) fn tracks(cameras: &[RigCamera], shots: &[Vec<Shot>], band: f64) -> Vec<Vec<Track>> {
    shots.iter().map(|shots| matches::find(cameras, shots, band)).collect()
}

/// Control cameras for matches by chance: each is rolled about its viewing direction, so real matches are hardly
/// possible.
fn turned_aside(cameras: &[RigCamera]) -> Vec<RigCamera> {
    let turned = |(i, camera): (usize, &RigCamera)| {
        let (sin, cos) = (ASIDE * (i + 1) as f64).sin_cos();
        let [x, y, z] = camera.camera_from_world;
        let mix = |a: f64, b: f64| std::array::from_fn(|k| a * x[k] + b * y[k]);
        RigCamera { camera_from_world: [mix(cos, -sin), mix(sin, cos), z], ..camera.clone() }
    };
    cameras.iter().enumerate().map(turned).collect()
}

/// The cameras with hardly any track, while the others have many.
fn alone(tracks: &[Vec<Track>], num_cameras: usize) -> Vec<usize> {
    let mut counts = vec![0_usize; num_cameras];
    for &(camera, _) in tracks.iter().flatten().flat_map(|track| &track.seen) {
        counts[camera] += 1;
    }
    let mut sorted = counts.clone();
    sorted.sort_unstable();
    let usual = sorted[num_cameras / 2];
    let is_alone = |&camera: &usize| counts[camera] < MIN_TRACKS && counts[camera] * ALONE < usual;
    (0..num_cameras).filter(is_alone).collect()
}

/// Groups of at least two cameras each that share places, directly or through others.
///
/// - `alone`: cameras that are in no group
/// - returns: nothing if all are one group
pub(super) fn groups(tracks: &[Vec<Track>], num_cameras: usize, alone: &[usize]) -> Vec<Vec<usize>> {
    let mut shared = vec![vec![0_usize; num_cameras]; num_cameras];
    for track in tracks.iter().flatten() {
        for &(a, _) in &track.seen {
            for &(b, _) in &track.seen {
                shared[a][b] += 1;
            }
        }
    }
    // Some places match by chance; the more places there are, the more match.
    let strongest = |a: usize| (0..num_cameras).filter(|&b| b != a).map(|b| shared[a][b]).max().unwrap_or_default();
    let is_tied = |a: usize, b: usize| shared[a][b] >= MIN_TRACKS.max(strongest(a).min(strongest(b)) / WEAK);
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for camera in (0..num_cameras).filter(|camera| !alone.contains(camera)) {
        let (tied, mut others): (Vec<_>, Vec<_>) =
            groups.into_iter().partition(|group| group.iter().any(|&other| is_tied(camera, other)));
        let mut group = tied.concat();
        group.push(camera);
        group.sort_unstable();
        others.push(group);
        groups = others;
    }
    groups.retain(|group| group.len() >= 2);
    groups.sort();
    if groups.len() < 2 { Vec::new() } else { groups }
}

/// Judging tracks and fitted tracks, of each moment.
pub(super) fn held_out(tracks: Vec<Vec<Track>>, cameras: &[RigCamera]) -> (Vec<Vec<Track>>, Vec<Vec<Track>>) {
    let is_judge = |track: &Track| {
        let (camera, pixel) = track.seen[0];
        let region = pixel.map(|p| (p / (longer_side(&cameras[camera]) / REGIONS)) as usize);
        (region[0] + 2 * region[1] + camera) % HELD_OUT == 0
    };
    let judges: Vec<Vec<Track>> =
        tracks.iter().map(|of_moment| of_moment.iter().filter(|t| is_judge(t)).cloned().collect()).collect();
    let fitted = apart_from(tracks, &judges, cameras);
    (judges, fitted)
}

pub(super) fn longer_side(camera: &RigCamera) -> f64 {
    camera.lens.width.max(camera.lens.height) as f64
}

/// The tracks that share no image place with the judging tracks.
fn apart_from(tracks: Vec<Vec<Track>>, judges: &[Vec<Track>], cameras: &[RigCamera]) -> Vec<Vec<Track>> {
    let apart = |(mut tracks, judges): (Vec<Track>, &Vec<Track>)| {
        let mut judged: Vec<Vec<[f64; 2]>> = vec![Vec::new(); cameras.len()];
        for &(camera, pixel) in judges.iter().flat_map(|judge| &judge.seen) {
            judged[camera].push(pixel);
        }
        let touches = |&(camera, [x, y]): &(usize, [f64; 2])| {
            let reach = TOUCHING * longer_side(&cameras[camera]);
            judged[camera].iter().any(|[u, v]| (x - u).abs() < reach && (y - v).abs() < reach)
        };
        tracks.retain(|track| !track.seen.iter().any(touches));
        tracks
    };
    tracks.into_iter().zip(judges).map(apart).collect()
}

/// - returns: number of fitted tracks
fn fit(cameras: &mut [RigCamera], tracks: Vec<Vec<Track>>) -> usize {
    let mut tracks: Vec<Track> = tracks.into_iter().flatten().collect();
    let mut counts = vec![0; cameras.len()];
    for &(camera, _) in tracks.iter().flat_map(|track| &track.seen) {
        counts[camera] += 1;
    }
    let is_free: Vec<bool> = counts.iter().map(|&count| count >= MIN_TRACKS).collect();
    // The first fit attributes all errors to the calibration: one bad camera among good ones looks like mismatches.
    let coarse = COARSE * cameras.iter().map(longer_side).fold(0.0, f64::max);
    for min_scale in [coarse, bundle::MIN_SCALE_PX] {
        bundle::bundle(cameras, &mut tracks, &is_free, FREEDOM, min_scale);
    }
    tracks.len()
}

/// Compares two calibrations on tracks to which neither was fitted.
fn judge(before: &[RigCamera], after: &[RigCamera], judges: &[Vec<Track>]) -> Refinement {
    let errors = |cameras: &[RigCamera]| -> Vec<Vec<f64>> {
        let mut errors = vec![Vec::new(); cameras.len()];
        for track in judges.iter().flatten() {
            // A track that no longer meets in front of the cameras has an infinite error.
            let found = bundle::triangulate(cameras, &track.seen);
            let of_track = match found {
                Some(point) => bundle::errors(cameras, &Track { point, seen: track.seen.clone() }),
                None => vec![f64::INFINITY; track.seen.len()],
            };
            for (&(camera, _), error) in track.seen.iter().zip(of_track) {
                errors[camera].push(error);
            }
        }
        errors
    };
    let (old, new) = (errors(before), errors(after));
    let of_camera = |(old, new): (&Vec<f64>, &Vec<f64>)| {
        (old.len() >= MIN_TRACKS)
            .then(|| [old, new].map(|errors| upper_median(errors.iter().copied()).unwrap_or_default()))
    };
    let camera_error_px: Vec<Option<[f64; 2]>> = old.iter().zip(&new).map(of_camera).collect();
    // Every camera counts the same: two cameras with much in common must not outvote the others.
    let judged: Vec<[f64; 2]> = camera_error_px.iter().flatten().copied().collect();
    let mean = |which: usize| judged.iter().map(|error| error[which]).sum::<f64>() / judged.len().max(1) as f64;
    let error_px = [mean(0), mean(1)];
    let is_no_worse = |[old, new]: &[f64; 2]| *new <= NO_WORSE * old.max(EXACT_PX);
    let is_taken = error_px[1] < BETTER * error_px[0] && error_px[0] > EXACT_PX && judged.iter().all(is_no_worse);
    Refinement { is_taken, num_tracks: [0; 2], error_px, camera_error_px, mended: None, alone: vec![], groups: vec![] }
}
