//! `tcgs prepare --check`: what the doctor found, in words, numbers and a picture.

use std::path::Path;

use anyhow::Context;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};
use serde_json::{Value, json};
use tcgs_capture::{Capture, Diagnosis};
use tcgs_core::Image;

use crate::options::JobOptions;
use crate::output::{check_file, say, write_file};
use crate::progress::Progress;

/// Steps of a check, for the progress bar.
const NUM_STEPS: usize = 5;

/// Checks a capture. What is found is an error, for the exit code.
pub fn run(path: &Path, sheet: Option<&Path>, job: &JobOptions) -> anyhow::Result<()> {
    if let Some(sheet) = sheet {
        check_file(sheet, job.force)?;
    }
    let capture = Capture::open_unseen(path)?;
    let mut progress = Progress::new("checking", NUM_STEPS);
    let diagnosis = tcgs_capture::check(&capture, &mut |step| progress.step(|| step.into()))?;
    drop(progress);
    if diagnosis.made_points {
        say("the capture has no points; some were made to check with")?;
    }
    for finding in &diagnosis.findings {
        say(&finding.to_string())?;
    }
    if let Some(sheet) = sheet {
        write_file(sheet, &png(&diagnosis.sheet)?, job.force)?;
    }
    job.write_json(&json(path, &diagnosis))?;
    let num_cameras = diagnosis.cameras.len();
    if !diagnosis.undecided.is_empty() {
        let ids: Vec<String> = diagnosis.undecided.iter().map(usize::to_string).collect();
        say(&format!(
            "cannot tell of {} of {num_cameras} cameras ({}): too little texture, or too few points in sight, for a \
             right camera to stand out from a wrong one; the picture of --sheet shows images and points",
            ids.len(),
            ids.join(", ")
        ))?;
    }
    if diagnosis.findings.is_empty() {
        let num_fit = num_cameras - diagnosis.undecided.len();
        let verdict = if num_fit == num_cameras { "healthy" } else { "nothing wrong was found" };
        return say(&format!("{}: {verdict}, {num_fit} cameras fit", path.display()));
    }
    let found = match diagnosis.findings.len() {
        1 => "1 finding".to_owned(),
        count => format!("{count} findings"),
    };
    let hint = if sheet.is_none() { ", --sheet FILE makes a picture" } else { "" };
    anyhow::bail!("{}: {found}, expected a healthy capture{hint}", path.display())
}

fn json(path: &Path, diagnosis: &Diagnosis) -> Value {
    let findings: Vec<Value> = diagnosis
        .findings
        .iter()
        .map(|finding| {
            json!({
                "kind": finding.kind.name(),
                "cameras": finding.cameras,
                "problem": finding.problem,
                "fix": finding.fix,
            })
        })
        .collect();
    let cameras: Vec<Value> =
        diagnosis.cameras.iter().map(|camera| json!({ "camera": camera.camera_id, "fit": camera.fit })).collect();
    json!({
        "capture": path.display().to_string(),
        "healthy": diagnosis.findings.is_empty() && diagnosis.undecided.is_empty(),
        "undecided": diagnosis.undecided,
        "made_points": diagnosis.made_points,
        "findings": findings,
        "cameras": cameras,
    })
}

fn png(image: &Image) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    PngEncoder::new(&mut bytes)
        .write_image(&image.to_rgb8(), image.width as u32, image.height as u32, ExtendedColorType::Rgb8)
        .context("encoding the picture")?;
    Ok(bytes)
}
