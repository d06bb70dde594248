//! `tcgs prepare --check`: the diagnosis in words, numbers, a picture and a page.

use std::path::Path;

use serde_json::{Value, json};
use tcgs_capture::{BETWEEN_DEGREES, Capture, MOSTLY_MEASURED, Split};
use tcgs_core::{Camera, Trust, dot};
use tcgs_pipeline::{CHECK_PAGE, examine};
use tcgs_prepare::{CameraFit, Diagnosis};

use super::page;
use crate::options::JobOptions;
use crate::output::write_file;
use crate::pictures::rgb;
use crate::teller::Teller;
use crate::terminal::say;

/// Most pairs of cameras that are named.
const MAX_GAPS: usize = 4;

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
    let mut result = json(path, diagnosis);
    if let Some(share) = diagnosis.measured_share {
        let names = capture.camera_names(Split::Train, 0)?;
        let cameras: Vec<Camera> = capture.cameras(Split::Train, 0, 1)?.into_iter().map(|(_, camera)| camera).collect();
        let expectation = expectation(share, &gaps(&names, &cameras));
        say(&expectation)?;
        result["expectation"] = expectation.into();
    }
    Ok(result)
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

/// The expected quality of pictures after a training.
///
/// - `measured_share`: of the points, the share with a measured depth
/// - `gaps`: pairs of cameras between which surfaces are guessed, in words
fn expectation(measured_share: f64, gaps: &[String]) -> String {
    let where_good = match (measured_share, gaps) {
        (MOSTLY_MEASURED.., []) => "between the cameras".into(),
        (MOSTLY_MEASURED.., _) => {
            let more = match gaps.len().saturating_sub(MAX_GAPS) {
                0 => String::new(),
                more => format!(" and {more} more pairs"),
            };
            let named = gaps[..gaps.len().min(MAX_GAPS)].join(", ");
            format!("between the cameras, but not between {named}{more}, where surfaces are guessed")
        }
        _ => format!("within {}° of each camera", Trust::ASIDE_DEGREES),
    };
    let percent = 100.0 * (1.0 - measured_share);
    format!("{percent:.0} % of the points have no measured depth: expect good pictures {where_good}")
}

/// Pairs of neighbouring cameras that look in too different directions for pictures from between them, the widest
/// first: `3 and 7 (92°)`. Two cameras are neighbours unless a third one's direction is nearer to both than they are
/// to each other.
///
/// - `names`: of the cameras, likewise ordered
fn gaps(names: &[String], cameras: &[Camera]) -> Vec<String> {
    let forward: Vec<[f64; 3]> = cameras.iter().map(Camera::forward).collect();
    let angle = |i: usize, j: usize| dot(forward[i], forward[j]).clamp(-1.0, 1.0).acos().to_degrees();
    let mut found = Vec::new();
    for i in 0..cameras.len() {
        for j in i + 1..cameras.len() {
            let apart = angle(i, j);
            let is_between = |k: usize| k != i && k != j && angle(i, k).max(angle(k, j)) < apart;
            if apart > BETWEEN_DEGREES && !(0..cameras.len()).any(is_between) {
                found.push((apart, format!("{} and {} ({apart:.0}°)", names[i], names[j])));
            }
        }
    }
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    found.into_iter().map(|(_, words)| words).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(degrees: &[f64]) -> (Vec<String>, Vec<Camera>) {
        let camera = |&around: &f64| {
            let (sin, cos) = around.to_radians().sin_cos();
            Camera::look_at([4.0 * sin, 0.0, -4.0 * cos], [0.0; 3], [0.0, -1.0, 0.0], 50.0, 64, 48)
        };
        (degrees.iter().map(|at| format!("at{at}")).collect(), degrees.iter().map(camera).collect())
    }

    #[test]
    fn gaps_are_between_neighbours_alone() {
        let gaps_of = |degrees: &[f64]| {
            let (names, cameras) = ring(degrees);
            gaps(&names, &cameras)
        };
        assert_eq!(gaps_of(&[0.0, 50.0, 100.0, 30.0]), Vec::<String>::new());
        // The widest first; no pair across the ring.
        let expected = ["at200 and at290 (90°)", "at116 and at200 (84°)", "at0 and at290 (70°)"];
        assert_eq!(gaps_of(&[0.0, 58.0, 116.0, 200.0, 290.0]), expected);
    }

    #[test]
    fn what_to_expect_names_a_few_gaps() {
        let pairs: Vec<String> = (0..6).map(|i| format!("a and b{i} (90°)")).collect();
        assert!(
            expectation(0.9, &[])
                .ends_with("10 % of the points have no measured depth: expect good pictures between the cameras")
        );
        let said = expectation(0.9, &pairs);
        assert!(
            said.contains("but not between a and b0 (90°),") && said.contains("b3 (90°) and 2 more pairs, where"),
            "{said}"
        );
        assert!(expectation(0.2, &pairs).ends_with("within 10° of each camera"));
    }
}
