//! The demo's pictures and its report.

use std::fs;
use std::path::Path;

use anyhow::Context;
use image::RgbImage;
use rayon::prelude::*;
use tcgs_capture::{Capture, Split};
use tcgs_core::Attribute;
use tcgs_interchange::create_folders;
use tcgs_pipeline::OpenScene;
use tcgs_render::device::GpuError;
use tcgs_render::{DrawAny, RenderSettings};
use tcgs_report::{CompressionStep, Picture, Report, Series, png};
use tcgs_train::Run;

use super::Outcome;
use crate::output::show_bytes;
use crate::pictures::{series, side_by_side, spread};

/// Number of timesteps in the report, spread over the clip.
const SHOWN: usize = 4;
/// Enlargement of the report's pictures, which makes blur visible.
const ENLARGED: usize = 3;
/// Bins of the masks' histogram.
const MASK_BINS: usize = 20;

/// Writes ground truth beside render of every held-out image; returns the report's pictures.
pub fn write_frames(
    scene: &OpenScene,
    capture: &Capture,
    renderer: &DrawAny,
    folder: &Path,
) -> anyhow::Result<Vec<Picture>> {
    let shown = spread(&scene.frames(), SHOWN);
    let mut pictures = Vec::new();
    for frame in scene.frames() {
        let drawn = scene.drawn(frame - scene.first_frame)?;
        let views = capture.views(Split::Test, frame, 1)?;
        let pairs = views.par_iter().map(|view| {
            let (output, _) = renderer.draw(&drawn.seen_by(&view.camera), &view.camera, &RenderSettings::default())?;
            Ok((view.camera_id, side_by_side(&view.image, &output.image)))
        });
        let pairs: Vec<(usize, RgbImage)> = pairs.collect::<Result<_, GpuError>>()?;
        for (i, (camera, pair)) in pairs.into_iter().enumerate() {
            let of_camera = folder.join(camera.to_string());
            let path = of_camera.join(format!("{frame:06}.png"));
            create_folders(&of_camera)
                .map_err(anyhow::Error::new)
                .and_then(|()| Ok(fs::write(&path, png(&pair)?)?))
                .with_context(|| format!("writing {}", path.display()))?;
            if i == 0 && shown.contains(&frame) {
                let caption = format!("Camera {camera}, frame {frame}: ground truth, and scene.tcgs rendered");
                pictures.push(Picture { caption, png: png(&enlarged(&pair))? });
            }
        }
    }
    Ok(pictures)
}

fn enlarged(image: &RgbImage) -> RgbImage {
    let factor = ENLARGED as u32;
    RgbImage::from_fn(image.width() * factor, image.height() * factor, |x, y| *image.get_pixel(x / factor, y / factor))
}

/// The report.
pub fn html(outcome: &Outcome, run: &Run, pictures: Vec<Picture>) -> anyhow::Result<String> {
    let quality = outcome.quality();
    let raw = outcome.stages[0].bytes;
    let frozen = super::psnr_foreground(&outcome.frozen);
    let summary = [
        ("PSNR, held-out cameras", format!("{:.2} dB", quality.psnr)),
        ("before compressing and refining", format!("{:.2} dB", outcome.uncompressed_quality().psnr)),
        ("size", show_bytes(outcome.compressed.file.len() as u64)),
        ("smaller than raw", format!("{:.0} times", outcome.ratio())),
        ("raw", show_bytes(raw)),
        ("moving objects", format!("{:.2} dB (frozen {:.2})", quality.psnr_foreground, frozen)),
        ("arrives later", format!("{:.2} dB", quality.late.arrived)),
        ("uncovered later", format!("{:.2} dB", quality.late.uncovered)),
        ("SSIM", format!("{:.4}", quality.ssim)),
        (
            "Gaussians",
            format!("{} of {}", outcome.compressed.compact.num_identities(), outcome.compressed.num_gaussians_before),
        ),
        ("time", format!("{:.0} s", outcome.seconds_total())),
    ];
    let stages = outcome
        .stages
        .iter()
        .map(|s| CompressionStep {
            name: s.name.into(),
            bytes: s.bytes,
            psnr: Some(s.quality.psnr),
            ssim: Some(s.quality.ssim),
        })
        .collect();
    Ok(tcgs_report::html(&Report {
        title: "tcgs demo".into(),
        summary: summary.into_iter().map(|(name, value)| (name.into(), value)).collect(),
        stages,
        seconds: outcome.seconds.iter().map(|(name, s)| ((*name).into(), *s)).collect(),
        loss: loss_curve(run)?,
        psnr_over_time: vec![
            series("uncompressed", &outcome.uncompressed, |i| Some(i.psnr)),
            series("scene.tcgs", &outcome.final_, |i| Some(i.psnr)),
            series("scene.tcgs, foreground", &outcome.final_, |i| i.psnr_foreground),
            series("first timestep frozen, foreground", &outcome.frozen, |i| i.psnr_foreground),
        ],
        keypoints_histogram: keypoints_histogram(outcome),
        mask_histogram: mask_histogram(run)?,
        bits_histogram: bits_histogram(outcome),
        pictures,
    }))
}

/// Losses over the iterations of the whole run, from the run's metrics.
fn loss_curve(run: &Run) -> anyhow::Result<Vec<(u64, f32)>> {
    let mut curve = Vec::new();
    let mut done = 0;
    for metrics in run.metrics()? {
        let metrics = metrics?;
        for point in metrics["loss_curve"].as_array().into_iter().flatten() {
            if let (Some(iteration), Some(loss)) = (point[0].as_u64(), point[1].as_f64()) {
                curve.push((done + iteration, loss as f32));
            }
        }
        let schedule = &run.config().schedule;
        done += if done == 0 { schedule.first_iterations } else { schedule.rest_iterations } as u64;
    }
    Ok(curve)
}

fn keypoints_histogram(outcome: &Outcome) -> Vec<Series> {
    let compact = &outcome.compressed.compact.cohorts[0];
    Attribute::BASE
        .into_iter()
        .filter(|a| compact.varies[a.index()])
        .map(|attribute| {
            let tracks = &compact.tracks[attribute.index()];
            let mut counts = vec![0.0; compact.num_timesteps() + 1];
            for track in 0..tracks.len() {
                counts[tracks.track(track).0.len()] += 1.0;
            }
            Series { name: attribute.name().into(), values: trimmed(counts) }
        })
        .collect()
}

fn bits_histogram(outcome: &Outcome) -> Vec<Series> {
    let histogram = outcome.compressed.compact.cohorts[0].bit_map.histogram();
    Attribute::BASE
        .into_iter()
        .filter(|&a| a != Attribute::Mean)
        .map(|attribute| {
            let mut counts = vec![0.0; 17];
            for (&width, &count) in &histogram[attribute.index()] {
                counts[usize::from(width)] = (count * attribute.components()) as f64;
            }
            Series { name: attribute.name().into(), values: trimmed(counts) }
        })
        .collect()
}

/// Drops trailing zeros.
fn trimmed(mut counts: Vec<f64>) -> Vec<f64> {
    let used = counts.iter().rposition(|&c| c > 0.0).map_or(0, |i| i + 1);
    counts.truncate(used);
    counts
}

fn mask_histogram(run: &Run) -> anyhow::Result<Vec<(f32, u64)>> {
    let mut counts = [0; MASK_BINS];
    for &logit in run.trained()?.mask_logits.iter().flatten() {
        let bin = (tcgs_core::sigmoid(logit) * MASK_BINS as f32) as usize;
        counts[bin.min(MASK_BINS - 1)] += 1;
    }
    Ok((0..MASK_BINS).map(|i| (i as f32 / MASK_BINS as f32, counts[i])).collect())
}
