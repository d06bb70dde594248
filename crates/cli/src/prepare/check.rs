//! `tcgs prepare --check`: the diagnosis in words, numbers, a picture and a page.

use std::path::Path;

use serde_json::{Value, json};
use tcgs_capture::{Capture, MOSTLY_MEASURED};
use tcgs_core::Trust;
use tcgs_pipeline::{CHECK_PAGE, examine};
use tcgs_prepare::{CameraFit, Diagnosis};

use super::page;
use crate::options::JobOptions;
use crate::output::write_file;
use crate::pictures::rgb;
use crate::teller::Teller;
use crate::terminal::say;

/// Checks a capture. A finding is an error, for the exit code.
pub fn run(path: &Path, sheet: Option<&Path>, page: Option<&Path>, job: &JobOptions) -> anyhow::Result<()> {
    let capture = Capture::open_unseen(path)?;
    let diagnosis = Teller::default().watch(|teller| examine(&capture, teller))?;
    for line in remarks(&diagnosis) {
        say(&line)?;
    }
    for finding in &diagnosis.findings {
        say(&finding.to_string())?;
    }
    if let Some(sheet) = sheet {
        write_file(sheet, &tcgs_report::png(&rgb(&diagnosis.sheet))?, job.force)?;
    }
    if let Some(page) = page {
        write_file(page, page::html(path, &capture, &diagnosis)?.as_bytes(), job.force)?;
    }
    job.write_json(&json(path, &diagnosis))?;
    let verdict = verdict(path, &diagnosis);
    if diagnosis.findings.is_empty() {
        return say(&verdict);
    }
    let hint = if page.is_none() && sheet.is_none() { ", --page FILE shows it" } else { "" };
    anyhow::bail!("{verdict}{hint}")
}

/// Prints the check of a new capture and writes the page into it. Findings are no error.
///
/// - returns: the diagnosis as JSON
pub fn after_preparing(path: &Path, capture: &Capture, diagnosis: &Diagnosis) -> anyhow::Result<Value> {
    for line in remarks(diagnosis) {
        say(&format!("check: {line}"))?;
    }
    for finding in &diagnosis.findings {
        say(&format!("check: {finding}"))?;
    }
    let file = path.join(CHECK_PAGE);
    write_file(&file, page::html(path, capture, diagnosis)?.as_bytes(), true)?;
    say(&format!("check: {}; {} shows it", verdict(path, diagnosis), file.display()))?;
    if let Some(share) = diagnosis.measured_share {
        say(&expectation(share))?;
    }
    Ok(json(path, diagnosis))
}

/// The limits of a diagnosis, one sentence each.
pub fn remarks(diagnosis: &Diagnosis) -> Vec<String> {
    let mut lines = Vec::new();
    if diagnosis.made_points {
        lines.push("the capture has no points; some were made to check with".into());
    }
    if let Some(share) = diagnosis.measured_share.filter(|&share| share < 1.0) {
        let percent = 100.0 * (1.0 - share);
        lines.push(format!("{percent:.0} % of the points have no measured depth, and prove nothing of a camera"));
    }
    let num_cameras = diagnosis.cameras.len();
    let undecided = || {
        let cameras = diagnosis.names.iter().zip(&diagnosis.cameras);
        cameras.filter(|(_, camera)| diagnosis.undecided.contains(&camera.camera_id))
    };
    let unlike = |fit: Option<f64>| fit.filter(|&fit| fit <= Diagnosis::MIN_FIT);
    let hidden: Vec<&str> =
        undecided().filter(|(_, camera)| unlike(camera.fit).is_none()).map(|(name, _)| name.as_str()).collect();
    if !hidden.is_empty() {
        lines.push(format!(
            "cannot tell of {} of {num_cameras} cameras ({}): too little texture, or too few points in sight, for a right \
             camera to stand out from a wrong one; the pictures show images and points",
            hidden.len(),
            hidden.join(", ")
        ));
    }
    let shown = |(name, camera): (&String, &CameraFit)| unlike(camera.fit).map(|fit| format!("{name} {fit:.2}"));
    let unlike: Vec<String> = undecided().filter_map(shown).collect();
    if !unlike.is_empty() {
        lines.push(format!(
            "warning: cannot tell of {} of {num_cameras} cameras, whose image and points are too little alike ({}): right \
             cameras usually have a likeness above {}; the pictures show both",
            unlike.len(),
            unlike.join(", "),
            Diagnosis::MIN_FIT
        ));
    }
    lines
}

/// The expected quality of pictures after a training, from the share of points with a measured depth.
pub fn expectation(measured_share: f64) -> String {
    let where_good = match measured_share {
        MOSTLY_MEASURED.. => "between the cameras".into(),
        _ => format!("within {}° of each camera", Trust::ASIDE_DEGREES),
    };
    let percent = 100.0 * (1.0 - measured_share);
    format!("{percent:.0} % of the points have no measured depth: expect good pictures {where_good}")
}

/// The diagnosis in one line.
pub fn verdict(path: &Path, diagnosis: &Diagnosis) -> String {
    let num_cameras = diagnosis.cameras.len();
    let words = match diagnosis.findings.len() {
        0 => {
            let num_fit = num_cameras - diagnosis.undecided.len();
            match num_fit == num_cameras {
                true => format!("healthy, {num_fit} cameras fit"),
                false => format!("nothing wrong was found, {num_fit} of {num_cameras} cameras fit"),
            }
        }
        1 => "1 finding, expected a healthy capture".into(),
        count => format!("{count} findings, expected a healthy capture"),
    };
    format!("{}: {words}", path.display())
}

fn json(path: &Path, diagnosis: &Diagnosis) -> Value {
    let findings: Vec<Value> = diagnosis
        .findings
        .iter()
        .map(|finding| {
            json!({
                "kind": finding.kind.name(),
                "cameras": finding.cameras,
                "names": finding.names,
                "problem": finding.problem,
                "fix": finding.fix,
            })
        })
        .collect();
    let cameras: Vec<Value> = diagnosis
        .cameras
        .iter()
        .zip(&diagnosis.names)
        .map(|(camera, name)| {
            json!({ "camera": camera.camera_id, "name": name, "fit": camera.fit, "brightness": camera.brightness })
        })
        .collect();
    json!({
        "capture": path.display().to_string(),
        "healthy": diagnosis.findings.is_empty() && diagnosis.undecided.is_empty(),
        "undecided": diagnosis.undecided,
        "made_points": diagnosis.made_points,
        "measured_share": diagnosis.measured_share,
        "findings": findings,
        "cameras": cameras,
    })
}
