//! Initial points by multi-view stereo: made, reported, written.

use std::io::BufWriter;
use std::path::Path;
use std::time::Instant;

use serde_json::{Value, json};
use tcgs_capture::{Capture, Origin, Prepared, write_prepared};
use tcgs_interchange::{Existing, write_whole};
use tcgs_prepare::{PrepareError, StereoSettings, spread_points, stereo_points};

use super::steps::reported;
use super::{say, unwritable};
use crate::error::PipelineError;
use crate::observe::{Observer, PrepareStep, Work};

/// Usual number of steps of making points.
const NUM_STEPS: usize = 7;

/// Least share of points whose depth is triangulated or bounded by masks; with fewer, strewn points are as good.
const MIN_SURE: f64 = 0.02;

/// Makes points for a capture by stereo, and reports its progress and result.
///
/// - returns: the points, and the record of the step
///
/// # Errors
/// [`PipelineError`] if no points can be made of the capture's images. [`PipelineError::Stopped`] if the observer stops
/// the call.
pub fn make_points(
    capture: &Capture,
    settings: &StereoSettings,
    observer: &mut dyn Observer,
) -> Result<(Prepared, Value), PipelineError> {
    let begin = Instant::now();
    let prepared =
        reported(observer, Work::MakingPoints, NUM_STEPS, |report| stereo_points(capture, settings, report))?;
    let seconds = begin.elapsed().as_secs_f64();
    say(observer, PrepareStep::Points { prepared: &prepared, secs: seconds })?;
    let count = |origin| prepared.count(origin);
    let told = json!({
        "num_points": prepared.cloud.points.len(),
        "num_foreground": num_foreground(&prepared),
        "origins": {
            "triangulated": count(Origin::Triangulated),
            "hull": count(Origin::Hull),
            "filled": count(Origin::Filled),
            "shell": count(Origin::Shell),
        },
        "agreement": prepared.agreement,
        "seconds": seconds,
    });
    Ok((prepared, told))
}

/// Makes points for a capture of few cameras. As [`make_points`], but strews the points if the cameras stand too far
/// apart for stereo, or hardly agree on any depth. Any other error is returned.
pub(super) fn make_or_strew(
    capture: &Capture,
    settings: &StereoSettings,
    observer: &mut dyn Observer,
) -> Result<(Prepared, Value), PipelineError> {
    let why = match make_points(capture, settings, observer) {
        Ok((prepared, told)) => {
            let sure = prepared.count(Origin::Triangulated) + prepared.count(Origin::Hull);
            if sure as f64 >= MIN_SURE * prepared.cloud.points.len() as f64 {
                return Ok((prepared, told));
            }
            format!("only {sure} points have a depth that cameras agree on")
        }
        Err(PipelineError::Prepare(PrepareError::FarApart { degrees, .. })) => {
            format!("no three cameras are within {degrees} degrees of each other, so no depth can be seen")
        }
        Err(PipelineError::Prepare(PrepareError::NoDepth { .. })) => "no cameras agree on any depth".into(),
        Err(error) => return Err(error),
    };
    let prepared = spread_points(capture, settings)?;
    let num_points = prepared.cloud.points.len();
    say(observer, PrepareStep::PointsStrewn { prepared: &prepared, why: &why })?;
    let told = json!({ "num_points": num_points, "num_foreground": num_points, "strewn": true });
    Ok((prepared, told))
}

/// Writes points whole or not at all.
pub(super) fn write(path: &Path, prepared: &Prepared) -> Result<(), PipelineError> {
    let written = write_whole(path, Existing::Keep, |file| write_prepared(BufWriter::new(file), prepared));
    written.map_err(unwritable(path))
}

fn num_foreground(prepared: &Prepared) -> usize {
    prepared.cloud.foreground.iter().filter(|&&foreground| foreground).count()
}
