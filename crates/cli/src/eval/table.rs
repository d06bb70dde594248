//! An evaluation as a text table and as CSV.

use std::fmt::Write;

use tcgs_metrics::{Backbone, MIN_MS_SSIM_SIDE, Protocol};

use tcgs_pipeline::{COLUMNS, Evaluation, ImageScore, MetricColumn, protocol_mean};

/// Appears in the table only: few captures have the foreground masks that it needs.
const FOREGROUND: MetricColumn =
    MetricColumn { key: "psnr_foreground", title: "PSNR of foreground", decimals: 2, of: |i| i.psnr_foreground };

/// Means of every timestep and of all images, and the reason for each empty column.
pub fn text(evaluation: &Evaluation, has_weights: bool) -> String {
    let columns = || COLUMNS.iter().chain([&FOREGROUND]);
    let width = |column: &MetricColumn| column.title.len().max(6);
    let mut table = String::from("timestep");
    columns().for_each(|column| table += &format!("  {:>1$}", column.title, width(column)));
    let mut row = |name: &str, images: &[ImageScore]| {
        let _ = write!(table, "\n{name:>8}");
        for column in columns() {
            let value = decimal(ImageScore::mean(images, column.of), column.decimals);
            let _ = write!(table, "  {value:>0$}", width(column));
        }
    };
    for images in evaluation.images.chunk_by(|a, b| a.timestep == b.timestep) {
        row(&images[0].timestep.to_string(), images);
    }
    row("mean", &evaluation.images);
    let [image_width, image_height] = evaluation.size;
    if !has_weights {
        table += "\nLPIPS: not measured without weights: --lpips-weights FILE or TCGS_LPIPS_WEIGHTS names the file that \
                  scripts/fetch_lpips_weights.py makes";
    } else if let Some(blind) = Backbone::ALL.iter().find(|b| !b.sees(image_width, image_height)) {
        let _ = write!(table, "\nLPIPS: {} sees nothing in images of {image_width}x{image_height}", blind.name());
    }
    if image_width.min(image_height) < MIN_MS_SSIM_SIDE {
        let found = format!("images are {image_width}x{image_height}");
        let _ = write!(table, "\nMS-SSIM, D-SSIM: not measured, {found}, expected {MIN_MS_SSIM_SIDE} pixels a side");
    }
    let _ = match evaluation.flicker {
        Some(flicker) => write!(table, "\nflicker {flicker:.5}: mean error of changes where the scene stands still"),
        None => write!(table, "\nflicker: not measured, expected two frames of a camera with parts that stand still"),
    };
    if evaluation.changed_colors {
        table += "\ncolours: compared as capture.toml evens them out; a --protocol compares with what was recorded";
    }
    let ms = evaluation.median_render_ms;
    table + &format!("\n{:.1} frames a second ({ms:.2} ms an image, {})", 1000.0 / ms, evaluation.device)
}

/// The metrics of a protocol under their published names.
pub fn protocol_line(protocol: Protocol, evaluation: &Evaluation) -> String {
    let rules = protocol.rules();
    let metrics = rules.metrics.iter().enumerate().map(|(index, metric)| {
        let decimals = if metric.key == "psnr" { 2 } else { 4 };
        format!("{} {}", metric.title, decimal(protocol_mean(evaluation, index), decimals))
    });
    format!("protocol {}: {}", rules.name, metrics.collect::<Vec<_>>().join(", "))
}

fn decimal(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".into(), |value| format!("{value:.digits$}"))
}

/// One line per image; a metric that was not measured is empty. A protocol's metrics come last.
pub fn csv(evaluation: &Evaluation, protocol: Option<Protocol>) -> String {
    let rules = protocol.map(Protocol::rules);
    let mut text = String::from("timestep,camera");
    COLUMNS.iter().for_each(|column| text += &format!(",{}", column.key));
    if let Some(rules) = rules {
        rules.metrics.iter().for_each(|metric| text += &format!(",{}_{}", rules.name, metric.key));
    }
    text.push('\n');
    for image in &evaluation.images {
        let _ = write!(text, "{},{}", image.timestep, image.camera);
        for value in COLUMNS.iter().map(|column| (column.of)(image)).chain(image.protocol.iter().copied()) {
            let _ = write!(text, ",{}", value.map_or_else(String::new, |value| value.to_string()));
        }
        text.push('\n');
    }
    text
}
