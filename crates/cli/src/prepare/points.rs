//! Initial points by multi-view stereo: made, described, written.

use std::io::BufWriter;
use std::path::Path;
use std::time::Instant;

use serde_json::{Value, json};
use tcgs_capture::{Capture, Origin, Prepared, write_prepared};
use tcgs_prepare::{PrepareError, StereoSettings, spread_points, stereo_points};

use super::Arguments;
use crate::output::write_file_with;
use crate::progress::Progress;
use crate::terminal::say;

/// Number of steps of making points, for the progress bar.
const NUM_STEPS: usize = 7;

/// Least share of points whose depth is triangulated or bounded by masks; with fewer, strewn points are as good.
const MIN_SURE: f64 = 0.02;

/// Makes points for a capture and prints a summary.
///
/// - returns: the points, and the report as JSON
pub fn make(capture: &Capture, arguments: &Arguments) -> anyhow::Result<(Prepared, Value)> {
    let settings = settings(arguments);
    let begin = Instant::now();
    let mut progress = Progress::new("preparing", NUM_STEPS);
    let prepared = stereo_points(capture, &settings, &mut |step| progress.step(|| step.into()))?;
    drop(progress);
    let seconds = begin.elapsed().as_secs_f64();
    say(&describe(&prepared, seconds))?;
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

/// Makes points for a capture of few cameras. As [`make`], but strews the points if the cameras stand too far apart for
/// stereo, or hardly agree on any depth. Any other error is returned.
pub fn make_or_strew(capture: &Capture, arguments: &Arguments) -> anyhow::Result<(Prepared, Value)> {
    let why = match make(capture, arguments) {
        Ok((prepared, told)) => {
            let sure = prepared.count(Origin::Triangulated) + prepared.count(Origin::Hull);
            if sure as f64 >= MIN_SURE * prepared.cloud.points.len() as f64 {
                return Ok((prepared, told));
            }
            format!("only {sure} points have a depth that three cameras agree on")
        }
        Err(error) => match error.downcast_ref() {
            Some(PrepareError::FarApart { degrees, .. }) => {
                format!("no three cameras are within {degrees} degrees of each other, so no depth can be seen")
            }
            Some(PrepareError::NoDepth { .. }) => "no three cameras agree on any depth".into(),
            _ => return Err(error),
        },
    };
    let prepared = spread_points(capture, &settings(arguments))?;
    let num_points = prepared.cloud.points.len();
    say(&format!(
        "{num_points} points, strewn where the cameras agree in colour: {why}; views between the cameras will be poor, and \
         `tcgs prepare --check` looks for a wrong calibration"
    ))?;
    let told = json!({ "num_points": num_points, "num_foreground": num_points, "strewn": true });
    Ok((prepared, told))
}

fn settings(arguments: &Arguments) -> StereoSettings {
    let defaults = StereoSettings::default();
    StereoSettings {
        num_points: arguments.points.unwrap_or(defaults.num_points),
        image_width: arguments.width.unwrap_or(defaults.image_width),
        seed: arguments.job.seed.unwrap_or(defaults.seed),
    }
}

/// Writes points whole or not at all.
pub fn write(path: &Path, prepared: &Prepared, force: bool) -> anyhow::Result<()> {
    write_file_with(path, force, |file| write_prepared(BufWriter::new(file), prepared))
}

fn num_foreground(prepared: &Prepared) -> usize {
    prepared.cloud.foreground.iter().filter(|&&foreground| foreground).count()
}

fn describe(prepared: &Prepared, seconds: f64) -> String {
    let parts = [
        (Origin::Triangulated, "triangulated"),
        (Origin::Hull, "on the visual hull"),
        (Origin::Filled, "between them"),
        (Origin::Shell, "on a shell around"),
    ];
    let parts: Vec<String> = parts
        .into_iter()
        .map(|(origin, name)| (prepared.count(origin), name))
        .filter(|&(count, _)| count > 0)
        .map(|(count, name)| format!("{count} {name}"))
        .collect();
    let (points, foreground) = (prepared.cloud.points.len(), num_foreground(prepared));
    format!("{points} points, {foreground} of them foreground: {}; {seconds:.1} s", parts.join(", "))
}
