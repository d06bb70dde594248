//! The diagnosis as a self-contained HTML page: each camera with its pictures and numbers.

use std::fmt::Write as _;
use std::path::Path;

use tcgs_capture::{Capture, CaptureDescription, DescribedCamera, Split};
use tcgs_prepare::{CameraFit, Diagnosis, Finding};
use tcgs_report::plot::escape;

use super::check::verdict;
use crate::pictures::{description, jpeg_uri};
use crate::progress::Progress;

const STYLE: &str = include_str!("page.css");

/// One camera of the page.
struct Entry<'a> {
    name: String,
    is_test: bool,
    /// The camera's entry in `capture.toml`.
    described: Option<&'a DescribedCamera>,
    findings: Vec<&'a Finding>,
    is_undecided: bool,
    fit: Option<f64>,
    brightness: Option<[f64; 3]>,
}

impl Entry<'_> {
    /// CSS class and text of the badge.
    fn state(&self) -> (&'static str, &'static str) {
        match (self.findings.is_empty(), self.is_undecided) {
            (false, _) => ("bad", "problem"),
            (true, true) => ("open", "cannot tell"),
            (true, false) => ("good", "fits"),
        }
    }

    /// Names and values of the measurements.
    fn numbers(&self, has_gains: bool) -> Vec<(&'static str, String)> {
        let shown = |value: Option<String>| value.unwrap_or_else(|| "–".into());
        let mut numbers = Vec::new();
        if let Some(camera) = self.described {
            numbers.push(("starts at", format!("{:.3} s", camera.start_secs)));
            numbers.push(("error", shown(camera.error_px.map(|error| format!("{error:.2} px")))));
            if has_gains {
                let [r, g, b] = camera.gains;
                numbers.push(("gains", format!("{r:.3} {g:.3} {b:.3}")));
                let [r, g, b] = camera.offsets;
                numbers.push(("offsets", format!("{r:.3} {g:.3} {b:.3}")));
            }
        }
        let percent = |factor: f64| format!("{:+.0}", 100.0 * (factor - 1.0));
        let brightness = self.brightness.map(|factors| format!("{} %", factors.map(percent).join(" ")));
        numbers.push(("brightness", shown(brightness)));
        numbers.push(("likeness", shown(self.fit.map(|fit| format!("{fit:.2}")))));
        numbers
    }
}

/// Builds the page.
///
/// - `path`: of the capture
pub fn html(path: &Path, capture: &Capture, diagnosis: &Diagnosis) -> anyhow::Result<String> {
    let description = description(path, capture)?;
    let entries = entries(capture, diagnosis, description.as_ref())?;
    let has_gains = entries
        .iter()
        .any(|entry| entry.described.is_some_and(|camera| camera.gains != [1.0; 3] || camera.offsets != [0.0; 3]));
    let mut page = String::new();
    // Writing to a string does not fail.
    let _ = write!(
        page,
        "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\">\n<meta name=\"color-scheme\" content=\"light dark\">\n\
         <title>{name}: check</title>\n<style>\n{STYLE}</style>\n<h1>{name}</h1>\n<p>{facts}</p>\n",
        name = escape(&capture.name()),
        facts = escape(&facts(capture, entries.len())),
    );
    problems(&mut page, path, diagnosis);
    if let Some(description) = &description {
        sources(&mut page, description);
    }
    overview(&mut page, &entries, has_gains);
    page += "<h2>Cameras</h2>\n<p class=\"legend\">Left the image of the first frame with the points that fall on it: \
             <b class=\"fg\">foreground</b>, <b class=\"bg\">background</b>. Beside it the points as they are seen from \
             there. Where a camera is right the two look alike.</p>\n<div class=\"cameras\">\n";
    let mut progress = Progress::new("drawing", entries.len());
    for (place, entry) in entries.iter().enumerate() {
        progress.step(|| entry.name.clone());
        let pictures = diagnosis.pictures(capture, place)?;
        let (class, state) = entry.state();
        let name = escape(&entry.name);
        let held_out = if entry.is_test { " <small>held out</small>" } else { "" };
        let _ = write!(
            page,
            "<section id=\"camera-{place}\" class=\"{class}\">\n<h3>{name}{held_out} <span class=\"badge\">{state}</span></h3>\n"
        );
        for finding in &entry.findings {
            let _ = writeln!(page, "<p class=\"problem\">{}</p>", escape(&finding.problem));
        }
        page += "<div class=\"pictures\">\n";
        let shown = [
            ("image with points", Some(&pictures.image)),
            ("points", Some(&pictures.points)),
            ("mask", pictures.mask.as_ref()),
        ];
        for (what, image) in shown {
            if let Some(image) = image {
                let (width, height) = (image.width, image.height);
                let source = jpeg_uri(image)?;
                let _ = writeln!(
                    page,
                    "<img alt=\"{name}: {what}\" width=\"{width}\" height=\"{height}\" loading=\"lazy\" src=\"{source}\">"
                );
            }
        }
        page += "</div>\n<dl>\n";
        for (what, value) in entry.numbers(has_gains) {
            let _ = writeln!(page, "<div><dt>{what}</dt><dd>{value}</dd></div>");
        }
        page += "</dl>\n</section>\n";
    }
    page += "</div>\n";
    Ok(page)
}

fn entries<'a>(
    capture: &Capture,
    diagnosis: &'a Diagnosis,
    description: Option<&'a CaptureDescription>,
) -> anyhow::Result<Vec<Entry<'a>>> {
    let num_train = capture.cameras(Split::Train, 0, 1)?.len();
    let names = capture.camera_names(Split::All, 0)?;
    let entry = |(place, (name, camera)): (usize, (String, &CameraFit))| {
        let id = camera.camera_id;
        Entry {
            name,
            is_test: place >= num_train,
            described: description.and_then(|of| of.cameras.iter().find(|camera| camera.id == id)),
            findings: diagnosis.findings.iter().filter(|finding| finding.cameras.contains(&id)).collect(),
            is_undecided: diagnosis.undecided.contains(&id),
            fit: camera.fit,
            brightness: camera.brightness,
        }
    };
    Ok(names.into_iter().zip(&diagnosis.cameras).enumerate().map(entry).collect())
}

fn facts(capture: &Capture, num_cameras: usize) -> String {
    let (frames, rate) = (capture.num_frames(), capture.frame_rate());
    let masks = if capture.has_segmentation() { ", with masks" } else { "" };
    format!("{num_cameras} cameras, {frames} frames at {rate:.2} a second{masks}")
}

fn problems(page: &mut String, path: &Path, diagnosis: &Diagnosis) {
    let class = if diagnosis.findings.is_empty() { "good" } else { "bad" };
    let _ = writeln!(page, "<p class=\"verdict {class}\">{}</p>", escape(&verdict(path, diagnosis)));
    if !diagnosis.findings.is_empty() {
        *page += "<ul class=\"findings\">\n";
        for finding in &diagnosis.findings {
            let _ = writeln!(page, "<li>{}</li>", escape(&finding.to_string()));
        }
        *page += "</ul>\n";
    }
    for line in super::check::remarks(diagnosis) {
        let _ = writeln!(page, "<p>{}</p>", escape(&line));
    }
}

/// Writes the sources of clocks, colours and calibration.
fn sources(page: &mut String, description: &CaptureDescription) {
    if let Some(clock) = &description.clock {
        let _ = writeln!(page, "<p>Clocks: {}.</p>", escape(&clock.from));
    }
    if let Some(colors) = &description.colors {
        let used = if colors.used { "" } else { " Gains and offsets are not used." };
        let found: Vec<String> = colors.found.iter().map(|found| escape(found)).collect();
        let _ = writeln!(page, "<p>Colours: {}.{used}</p>", found.join("; "));
    }
    if let Some(source) = &description.calibration {
        let (file, format) = (escape(&source.file), escape(&source.format));
        let _ = writeln!(page, "<details><summary>Calibration: {file} ({format})</summary>\n<ul>");
        for change in &source.changes {
            let _ = writeln!(page, "<li>{}</li>", escape(change));
        }
        *page += "</ul></details>\n";
    }
}

/// Writes a table with the numbers of all cameras.
fn overview(page: &mut String, entries: &[Entry<'_>], has_gains: bool) {
    let Some(first) = entries.first() else { return };
    let heads: String = first.numbers(has_gains).iter().map(|(what, _)| format!("<th>{what}</th>")).collect();
    let _ = writeln!(page, "<div class=\"wide\"><table>\n<tr><th>camera</th>{heads}<th></th></tr>");
    for (place, entry) in entries.iter().enumerate() {
        let (class, state) = entry.state();
        let cells: String = entry.numbers(has_gains).iter().map(|(_, value)| format!("<td>{value}</td>")).collect();
        let name = escape(&entry.name);
        let _ = writeln!(
            page,
            "<tr class=\"{class}\"><td><a href=\"#camera-{place}\">{name}</a></td>{cells}<td><span class=\"badge\">{state}</span></td></tr>"
        );
    }
    *page += "</table></div>\n<p class=\"legend\">";
    if first.described.is_some() {
        *page += "Starts at: when the capture begins in the camera's file. Error: median distance between where places are \
                  seen and where the camera should see them. ";
    }
    *page += "Brightness: of red, green and blue against the camera in the middle. Likeness: correlation of the image with the points whose depth is measured, 1 at most; below 0.5 no camera is said to fit.</p>\n";
}
