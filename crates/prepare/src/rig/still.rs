//! Detects cameras that move, which no later step can use.

use std::path::Path;

use rayon::prelude::*;
use tcgs_capture::CaptureDescription;

use super::corners::{Corner, Pyramid};
use super::frames::{Frames, moments};
use super::patch::likeness;
use crate::PrepareError;

/// Number of compared moments.
const NUM_MOMENTS: usize = 4;
/// Minimum number of corners for a judgement.
const MIN_CORNERS: usize = 40;
/// A camera with a smaller share of unmoved corners at all later moments moves. A camera on a tripod has more, whatever
/// moves before it.
const MOVING: f64 = 0.05;
/// Minimum share of corners that are found again in the next frame; fewer mean noise.
const FLOWING: f64 = 0.3;
/// Minimum correlation of a place with itself, also after a small shift.
const STILL: f32 = 0.7;
/// Pyramid level of the comparison: a shake of a few pixels vanishes there, and noise is averaged.
const LEVEL: usize = 2;
/// Cells of a picture along its longer side.
const CELLS: usize = 12;

/// The names of cameras that move: their pictures stay the same from one frame to the next, and differ later.
///
/// - `folder`: the folder that the description's files are relative to
///
/// # Errors
/// [`PrepareError`] if an image cannot be decoded.
pub fn moving_cameras(folder: &Path, description: &CaptureDescription) -> Result<Vec<String>, PrepareError> {
    let chosen = moments(description.num_frames, NUM_MOMENTS);
    let Some((&first, later)) = chosen.split_first() else { return Ok(Vec::new()) };
    let frames = Frames::open(folder, description)?;
    let pyramids = |frame: usize| -> Result<Vec<Pyramid>, PrepareError> {
        Ok(frames.at(frame)?.par_iter().map(Pyramid::new).collect())
    };
    let begin = pyramids(first)?;
    let corners: Vec<Vec<Corner>> = begin
        .iter()
        .map(|pyramid| {
            let level = LEVEL.min(pyramid.levels.len() - 1);
            pyramid.corners_of_level(level, CELLS)
        })
        .collect();
    let next = pyramids((first + 1).min(description.num_frames - 1))?;
    let later = later.iter().map(|&frame| pyramids(frame)).collect::<Result<Vec<_>, _>>()?;
    let moves = |camera: usize| {
        let share = |other: &Pyramid| {
            let still = corners[camera].iter().filter(|corner| likeness(&begin[camera], other, corner) > STILL).count();
            still as f64 / corners[camera].len() as f64
        };
        corners[camera].len() >= MIN_CORNERS
            && share(&next[camera]) > FLOWING
            && later.iter().all(|moment| share(&moment[camera]) < MOVING)
            && !later.is_empty()
    };
    let cameras = description.cameras.iter().enumerate();
    Ok(cameras.filter(|(i, _)| moves(*i)).map(|(_, camera)| camera.name.clone()).collect())
}
