//! Pages of results: one HTML file each, without scripts or external resources.
//!
//! [`html`] makes the page of one run. [`document`], [`section`] and [`pictures`] make other pages in the same style.
//! What lives here: the choice and order of a page's figures; [`plot`] draws them. What does not: training, measuring,
//! and any model. The command line and the laboratory (`lab/`) share this crate.
//!
//! ```
//! let report = tcgs_report::Report { title: "a run".into(), ..Default::default() };
//! assert!(tcgs_report::html(&report).contains("<h1>a run</h1>"));
//! ```

pub mod plot;

use std::fmt::Write;
use std::io::Cursor;

use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use image::{ImageFormat, RgbImage};

use plot::{Axes, Line, Row, columns, escape, lines, rows, short};

/// The content of a run's page. A plot without values says that it was not measured.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Heading of the page.
    pub title: String,
    /// Headline figures: name and value, most important first.
    pub summary: Vec<(String, String)>,
    /// Results of the compression steps, in order; the first is the uncompressed model.
    pub stages: Vec<CompressionStep>,
    /// Seconds spent on each part of the run.
    pub seconds: Vec<(String, f64)>,
    /// Iteration, counted over the whole run, and training loss.
    pub loss: Vec<(u64, f32)>,
    /// PSNR in dB of every timestep, one series per model or subset of pixels.
    pub psnr_over_time: Vec<Series>,
    /// For each attribute: number of tracks with 0, 1, 2, … keypoints.
    pub keypoints_histogram: Vec<Series>,
    /// Lower end of each bin, and the Gaussians and timesteps whose mask lies in it.
    pub mask_histogram: Vec<(f32, u64)>,
    /// For each attribute: number of parameters stored with 0, 1, 2, … bits.
    pub bits_histogram: Vec<Series>,
    /// Pictures, shown first and in order.
    pub pictures: Vec<Picture>,
}

/// A step of the compression.
#[derive(Clone, Debug, Default)]
pub struct CompressionStep {
    /// Name of the step.
    pub name: String,
    /// Size of the model after the step.
    pub bytes: u64,
    /// PSNR on the test cameras, dB, if measured.
    pub psnr: Option<f64>,
    /// SSIM on the test cameras, if measured.
    pub ssim: Option<f64>,
}

/// A named series of numbers; the index is the abscissa.
#[derive(Clone, Debug, Default)]
pub struct Series {
    /// Name in the legend.
    pub name: String,
    /// Values that are not finite are left out.
    pub values: Vec<f64>,
}

/// A picture with its caption.
#[derive(Clone, Debug, Default)]
pub struct Picture {
    /// Text below the picture, read by screen readers.
    pub caption: String,
    /// A PNG file.
    pub png: Vec<u8>,
}

/// Most points of the loss curve: more than the plot's pixels can show would only add bytes.
const MAX_LOSS_POINTS: usize = 300;

/// The page of a run as HTML.
pub fn html(report: &Report) -> String {
    let mut page = summary(&report.summary);
    section(&mut page, "Pictures", "", &pictures(&report.pictures));
    section(&mut page, "Size", "What each step leaves of the model.", &sizes(&report.stages));
    let note = "On the test cameras, which training never saw.";
    section(&mut page, "Quality over time", note, &psnr_over_time(&report.psnr_over_time));
    section(&mut page, "Training", "Loss of the training images.", &loss(&report.loss));
    section(&mut page, "Time", "", &seconds(&report.seconds));
    let note = "How many samples each track of a value over time keeps; lines join them.";
    section(&mut page, "Keypoints", note, &histograms(&report.keypoints_histogram, "keypoints", "tracks"));
    let note = "How many bits each parameter is stored with, by how much the images depend on it.";
    section(&mut page, "Bits", note, &histograms(&report.bits_histogram, "bits", "parameters"));
    section(&mut page, "Masks", "Gaussians near 0 have been switched off.", &masks(&report.mask_histogram));
    document(&report.title, &page)
}

/// A complete page.
///
/// - `body`: HTML below the heading
pub fn document(title: &str, body: &str) -> String {
    let title = escape(title);
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n<title>{title}</title>\n<style>{}</style>\n</head>\n\
         <body>\n<main>\n<h1>{title}</h1>\n{body}</main>\n</body>\n</html>\n",
        include_str!("style.css")
    )
}

/// Appends a section with a heading.
pub fn section(page: &mut String, name: &str, note: &str, body: &str) {
    let id = name.to_lowercase().replace(' ', "-");
    let note = if note.is_empty() { String::new() } else { format!("<p class=\"note\">{note}</p>\n") };
    let body = if body.is_empty() { "<p class=\"note\">Not measured.</p>\n" } else { body };
    *page += &format!("<section aria-labelledby=\"{id}\">\n<h2 id=\"{id}\">{name}</h2>\n{note}{body}</section>\n");
}

/// Headline figures: name and value.
pub fn summary(figures: &[(String, String)]) -> String {
    let tiles = figures.iter().fold(String::new(), |mut tiles, (name, value)| {
        let _ = write!(tiles, "<div><dt>{}</dt><dd>{}</dd></div>", escape(name), escape(value));
        tiles
    });
    format!("<dl class=\"summary\">{tiles}</dl>\n")
}

/// A bar for each stage, and the same numbers as a table.
fn sizes(stages: &[CompressionStep]) -> String {
    let Some(first) = stages.first() else { return String::new() };
    let bars: Vec<Row> = stages
        .iter()
        .map(|stage| Row { name: stage.name.clone(), value: stage.bytes as f64, text: bytes(stage.bytes) })
        .collect();
    let mut table = String::from(
        "<div class=\"scroll\"><table><thead><tr><th scope=\"col\">Step</th><th scope=\"col\">Size</th>\
         <th scope=\"col\">Ratio</th><th scope=\"col\">PSNR, dB</th><th scope=\"col\">SSIM</th></tr></thead><tbody>",
    );
    for stage in stages {
        let ratio = first.bytes as f64 / stage.bytes as f64;
        let _ = write!(
            table,
            "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            escape(&stage.name),
            bytes(stage.bytes),
            decimal(Some(ratio), 1),
            decimal(stage.psnr, 2),
            decimal(stage.ssim, 4)
        );
    }
    format!("{}{table}</tbody></table></div>\n", rows("Bytes after each step, logarithmic scale", &bars, true))
}

/// PSNR in dB of every timestep.
pub fn psnr_over_time(all: &[Series]) -> String {
    let series: Vec<Line> = all
        .iter()
        .map(|series| Line {
            name: series.name.clone(),
            points: series.values.iter().enumerate().map(|(i, &value)| (i as f64, value)).collect(),
        })
        .collect();
    let axes = Axes { x: "timestep".into(), y: "PSNR, dB".into(), ..Axes::default() };
    lines("PSNR of each timestep", &axes, &series)
}

fn loss(loss: &[(u64, f32)]) -> String {
    let run = loss.len().div_ceil(MAX_LOSS_POINTS).max(1);
    let points = loss
        .chunks(run)
        .map(|chunk| {
            let mean = |value: fn(&(u64, f32)) -> f64| chunk.iter().map(value).sum::<f64>() / chunk.len() as f64;
            (mean(|p| p.0 as f64), mean(|p| f64::from(p.1)))
        })
        .collect();
    let line = Line { name: "loss".into(), points };
    let axes = Axes { x: "iteration".into(), y: "loss".into(), log_x: false, log_y: true };
    lines("Training loss over iterations, logarithmic scale", &axes, &[line])
}

/// Seconds spent on each part.
pub fn seconds(seconds: &[(String, f64)]) -> String {
    let bars: Vec<Row> = seconds
        .iter()
        .map(|(name, value)| Row { name: name.clone(), value: *value, text: format!("{} s", decimal(Some(*value), 1)) })
        .collect();
    rows("Seconds spent on each part", &bars, false)
}

/// One small plot per series, over the range in which any of them has a value.
fn histograms(all: &[Series], x_label: &str, y_label: &str) -> String {
    let used =
        |series: &Series| -> Vec<usize> { (0..series.values.len()).filter(|&i| series.values[i] > 0.0).collect() };
    let indices: Vec<usize> = all.iter().flat_map(used).collect();
    let (Some(&low), Some(&high)) = (indices.iter().min(), indices.iter().max()) else { return String::new() };
    let mut plots = String::from("<div class=\"grid\">");
    for series in all {
        let bars: Vec<(String, f64)> =
            (low..=high).map(|i| (i.to_string(), series.values.get(i).copied().unwrap_or(0.0))).collect();
        let plot = columns(&format!("{}: {y_label} by {x_label}", series.name), x_label, y_label, &bars);
        let _ = write!(plots, "<figure>{plot}<figcaption>{}</figcaption></figure>", escape(&series.name));
    }
    plots + "</div>\n"
}

fn masks(histogram: &[(f32, u64)]) -> String {
    let bars: Vec<(String, f64)> =
        histogram.iter().map(|&(start, count)| (format!("{start:.2}"), count as f64)).collect();
    let plot = columns("Gaussians by mask value", "mask, from", "Gaussians", &bars);
    if plot.is_empty() { plot } else { format!("<div class=\"grid\"><figure>{plot}</figure></div>\n") }
}

/// Pictures with their captions.
pub fn pictures(pictures: &[Picture]) -> String {
    if pictures.is_empty() {
        return String::new();
    }
    let mut grid = String::from("<div class=\"grid\">");
    for picture in pictures {
        let caption = escape(&picture.caption);
        let data = BASE64_STANDARD.encode(&picture.png);
        let class = if is_wide(&picture.png) { " class=\"wide\"" } else { "" };
        let _ = write!(
            grid,
            "<figure{class}><img alt=\"{caption}\" src=\"data:image/png;base64,{data}\"><figcaption>{caption}</figcaption></figure>"
        );
    }
    grid + "</div>\n"
}

/// Texts as items of a list.
pub fn list<'a>(items: impl IntoIterator<Item = &'a str>) -> String {
    let items = items.into_iter().fold(String::new(), |all, item| all + "<li>" + &escape(item) + "</li>\n");
    if items.is_empty() { items } else { format!("<ul>\n{items}</ul>\n") }
}

/// A picture as a PNG file.
///
/// # Errors
/// If the picture has no pixels, or more than a PNG file can hold.
pub fn png(image: &RgbImage) -> Result<Vec<u8>, image::ImageError> {
    let mut bytes = Cursor::new(Vec::new());
    image.write_to(&mut bytes, ImageFormat::Png)?;
    Ok(bytes.into_inner())
}

/// Whether a PNG is more than twice as wide as high, such as pictures side by side: they get a row of their own.
fn is_wide(png: &[u8]) -> bool {
    // The header is the first chunk, and width and height are its first fields.
    let field = |at: usize| png.get(at..at + 4).map_or(0, |b| b.iter().fold(0u64, |n, &b| n << 8 | u64::from(b)));
    field(16) > 2 * field(20)
}

fn bytes(bytes: u64) -> String {
    format!("{}B", short(bytes as f64))
}

fn decimal(value: Option<f64>, digits: usize) -> String {
    value.filter(|value| value.is_finite()).map_or_else(|| "–".into(), |value| format!("{value:.digits$}"))
}

#[cfg(test)]
mod tests;
