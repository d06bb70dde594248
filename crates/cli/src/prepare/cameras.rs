//! Poses of the cameras of a folder of videos: found by COLMAP, refined, scaled, and reported.

use std::ops::ControlFlow;
use std::path::Path;

use anyhow::Context;
use serde_json::{Value, json};
use tcgs_capture::{CalibrationSource, CaptureDescription};
use tcgs_prepare::{
    FoundCameras, PrepareError, Refinement, find_cameras, moving_cameras, refine_cameras, same_poses, scale_cameras,
};

use super::{MODEL, Scale};
use crate::error::wrong_input;
use crate::interrupt;
use crate::progress::Progress;
use crate::terminal::say;

/// Refuses moving cameras.
pub fn check_still(source: &Path, description: &CaptureDescription) -> anyhow::Result<()> {
    let moving = moving_cameras(source, description)?;
    if moving.is_empty() {
        return Ok(());
    }
    let problem = "what it shows is elsewhere later on, expected a camera that stands still";
    Err(wrong_input(format!(
        "{}: {}: {problem}; cameras that move are not supported",
        source.display(),
        moving.join(", ")
    )))
}

/// Prints cameras of a calibration that share one pose, before any computation uses it.
pub fn note_same_poses(description: &CaptureDescription) -> anyhow::Result<()> {
    let poses: Vec<_> = description.cameras.iter().map(|camera| camera.camera_from_world).collect();
    for group in same_poses(&poses) {
        let names: Vec<&str> = group.iter().map(|&i| description.cameras[i].name.as_str()).collect();
        say(&format!("  {} have one pose: the same place and the same direction; is one a copy?", names.join(", ")))?;
    }
    Ok(())
}

/// Finds the poses of the cameras by COLMAP.
///
/// - `temporary`: a folder that the caller removes
pub fn find(source: &Path, description: &mut CaptureDescription, temporary: &Path) -> anyhow::Result<FoundCameras> {
    let work = temporary.join("work");
    std::fs::create_dir(&work).with_context(|| format!("writing {}", work.display()))?;
    // COLMAP is a child process, which a signal must end first.
    let found =
        interrupt::politely(|| with_progress("cameras", 6, |tell| find_cameras(source, description, &work, tell)));
    interrupt::check()?;
    let found = found?;
    let mut calibration = CalibrationSource::default();
    (calibration.file, calibration.format) = (MODEL.into(), "colmap".into());
    let how = format!(
        "found by COLMAP from the images alone, by {} points: median error {:.2} pixels",
        found.num_points(),
        found.error_px
    );
    say(&format!("cameras: {how}"))?;
    calibration.changes.push(how);
    description.calibration = Some(calibration);
    Ok(found)
}

/// Refines a calibration if that lowers its errors, and prints by how much.
pub fn refine(source: &Path, description: &mut CaptureDescription) -> anyhow::Result<Option<Refinement>> {
    let refinement = with_progress("refining", 3, |tell| refine_cameras(source, description, tell))?;
    let lines = match &refinement {
        None => {
            vec!["too few places are seen by several cameras to judge the calibration, which is taken as it is".into()]
        }
        Some(refinement) => in_words(refinement, description),
    };
    for line in &lines {
        say(&format!("  {line}"))?;
    }
    if let Some(calibration) = &mut description.calibration {
        calibration.changes.extend(lines);
    }
    Ok(refinement)
}

/// Scales all lengths to a measured distance.
///
/// - returns: the factor
pub fn scale(source: &Path, description: &mut CaptureDescription, scale: &Scale) -> anyhow::Result<f64> {
    let [a, b] = &scale.cameras;
    let factor = scale_cameras(description, [a, b], scale.metres)
        .map_err(|problem| wrong_input(format!("{}: {problem}", source.display())))?;
    let line = format!("lengths are multiplied by {factor:.4}, so that {a} and {b} are {} m apart", scale.metres);
    say(&format!("  {line}"))?;
    if let Some(calibration) = &mut description.calibration {
        calibration.changes.push(line);
    }
    Ok(factor)
}

/// The outcome of a refinement as JSON.
pub fn refinement_json(refinement: &Refinement, description: &CaptureDescription) -> Value {
    let names = description.cameras.iter().map(|camera| &camera.name);
    let of_camera: Vec<Value> = names
        .zip(&refinement.camera_error_px)
        .map(|(name, errors)| json!({ "name": name, "before_px": errors.map(|e| e[0]), "after_px": errors.map(|e| e[1]) }))
        .collect();
    let ([before, after], [fitted, judging]) = (refinement.error_px, refinement.num_tracks);
    let names = |group: &Vec<usize>| group.iter().map(|&i| &description.cameras[i].name).collect::<Vec<_>>();
    json!({
        "taken": refinement.is_taken,
        "before_px": before,
        "after_px": after,
        "num_fitted": fitted,
        "num_judging": judging,
        "cameras": of_camera,
        "mended": refinement.mended,
        "groups": refinement.groups.iter().map(names).collect::<Vec<_>>(),
        "alone": names(&refinement.alone),
    })
}

fn in_words(refinement: &Refinement, description: &CaptureDescription) -> Vec<String> {
    let ([before, after], [fitted, judging]) = (refinement.error_px, refinement.num_tracks);
    let kept = if refinement.is_taken { "refined" } else { "not refined, since that does not make it clearly better" };
    let mut lines: Vec<String> = refinement.mended.iter().cloned().collect();
    for &camera in &refinement.alone {
        let name = &description.cameras[camera].name;
        lines.push(format!(
            "{name} shares hardly any place with the other cameras: is it of another scene, or its pose wrong?"
        ));
    }
    if !refinement.groups.is_empty() {
        let named = |group: &Vec<usize>| -> String {
            group.iter().map(|&i| description.cameras[i].name.as_str()).collect::<Vec<_>>().join(", ")
        };
        lines.push(format!(
            "these cameras share hardly any place with those: {}; are they of two scenes, or is the calibration wrong?",
            refinement.groups.iter().map(named).collect::<Vec<_>>().join(" | ")
        ));
    }
    lines.push(format!(
        "{kept}: {judging} places that were held out are off by {before:.2} pixels before and {after:.2} after a fit to \
         {fitted} others, medians of the cameras on average"
    ));
    let of_camera = |(camera, errors): (&tcgs_capture::DescribedCamera, &Option<[f64; 2]>)| match errors {
        Some([before, after]) => format!("{}: {before:.2} pixels before, {after:.2} after", camera.name),
        None => format!("{}: too few places to judge", camera.name),
    };
    lines.extend(description.cameras.iter().zip(&refinement.camera_error_px).map(of_camera));
    lines
}

/// Shows the progress of a call, and stops it after Ctrl-C.
///
/// - `num_steps`: usual number of steps; the text up to a comma identifies a step
pub fn with_progress<T>(
    name: &'static str,
    num_steps: usize,
    run: impl FnOnce(&mut dyn FnMut(&str) -> ControlFlow<()>) -> Result<T, PrepareError>,
) -> Result<T, PrepareError> {
    let mut progress = Progress::new(name, num_steps);
    let (mut step, mut told) = (0, String::new());
    run(&mut |what: &str| {
        let head = what.split(',').next().unwrap_or_default();
        if told != head {
            (step, told) = ((step + 1).min(num_steps), head.into());
        }
        progress.advance_to(step - 1, || what.into());
        interrupt::asked()
    })
}
