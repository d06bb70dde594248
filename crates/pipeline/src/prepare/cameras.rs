//! Poses of the cameras of a folder of videos: found by COLMAP, refined, scaled, and reported.

use std::path::Path;

use serde_json::{Value, json};
use tcgs_capture::{CalibrationSource, CaptureDescription};
use tcgs_prepare::{FoundCameras, Refinement, find_cameras, moving_cameras, refine_cameras, same_poses, scale_cameras};

use super::steps::stoppable;
use super::{MODEL, fault, say, unwritable};
use crate::error::PipelineError;
use crate::observe::{Observer, PrepareStep, Work};

/// Refuses moving cameras.
pub fn check_still(source: &Path, description: &CaptureDescription) -> Result<(), PipelineError> {
    let moving = moving_cameras(source, description)?;
    if moving.is_empty() {
        return Ok(());
    }
    let problem = "what it shows is elsewhere later on, expected a camera that stands still";
    Err(fault(source, format!("{}: {problem}; cameras that move are not supported", moving.join(", "))))
}

/// Reports cameras of a calibration that share one pose, before any computation uses it.
pub fn note_same_poses(description: &CaptureDescription, observer: &mut dyn Observer) -> Result<(), PipelineError> {
    let poses: Vec<_> = description.cameras.iter().map(|camera| camera.camera_from_world).collect();
    for group in same_poses(&poses) {
        let names: Vec<&str> = group.iter().map(|&i| description.cameras[i].name.as_str()).collect();
        say(observer, PrepareStep::SamePose(&names))?;
    }
    Ok(())
}

/// Finds the poses of the cameras by COLMAP.
///
/// - `temporary`: a folder that the caller removes
pub fn find(
    source: &Path,
    description: &mut CaptureDescription,
    temporary: &Path,
    observer: &mut dyn Observer,
) -> Result<FoundCameras, PipelineError> {
    let work = temporary.join("work");
    std::fs::create_dir(&work).map_err(unwritable(&work))?;
    let found = stoppable(observer, Work::FindingCameras, 6, |tell| find_cameras(source, description, &work, tell))?;
    let mut calibration = CalibrationSource::default();
    (calibration.file, calibration.format) = (MODEL.into(), "colmap".into());
    let how = format!(
        "found by COLMAP from the images alone, by {} points: median error {:.2} pixels",
        found.num_points(),
        found.error_px
    );
    say(observer, PrepareStep::CamerasFound(&how))?;
    calibration.changes.push(how);
    description.calibration = Some(calibration);
    Ok(found)
}

/// Refines a calibration if that lowers its errors, and reports by how much.
pub fn refine(
    source: &Path,
    description: &mut CaptureDescription,
    observer: &mut dyn Observer,
) -> Result<Option<Refinement>, PipelineError> {
    let refinement = stoppable(observer, Work::RefiningCameras, 3, |tell| refine_cameras(source, description, tell))?;
    let lines = match &refinement {
        None => {
            vec!["too few places are seen by several cameras to judge the calibration, which is taken as it is".into()]
        }
        Some(refinement) => in_words(refinement, description),
    };
    say(observer, PrepareStep::Refined(&lines))?;
    if let Some(calibration) = &mut description.calibration {
        calibration.changes.extend(lines);
    }
    Ok(refinement)
}

/// Scales all lengths to a measured distance of two cameras.
///
/// - returns: the factor
pub fn scale(
    source: &Path,
    description: &mut CaptureDescription,
    [a, b]: &[String; 2],
    metres: f64,
    observer: &mut dyn Observer,
) -> Result<f64, PipelineError> {
    let factor = scale_cameras(description, [a, b], metres).map_err(|problem| fault(source, problem))?;
    let line = format!("lengths are multiplied by {factor:.4}, so that {a} and {b} are {metres} m apart");
    say(observer, PrepareStep::Scaled(&line))?;
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
