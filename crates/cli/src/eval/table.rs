//! An evaluation for people, for machines, and for spreadsheets.

use std::fmt::Write;

use serde_json::{Value, json};

use super::measure::{Evaluation, ImageScore, mean};
use crate::scene::Scene;

/// Means of every timestep and of all images.
pub fn text(evaluation: &Evaluation) -> String {
    let mut table = String::from("timestep    PSNR  PSNR/channel    SSIM  PSNR of foreground\n");
    let mut row = |name: &str, images: &[ImageScore]| {
        let of = |metric: fn(&ImageScore) -> Option<f64>| mean(images.iter().filter_map(metric));
        let _ = writeln!(
            table,
            "{name:>8}  {:>6}  {:>12}  {:>6}  {:>18}",
            decimal(of(|i| Some(i.psnr)), 2),
            decimal(of(|i| Some(i.psnr_per_channel)), 2),
            decimal(of(|i| Some(i.ssim)), 4),
            decimal(of(|i| i.psnr_foreground), 2)
        );
    };
    for images in evaluation.images.chunk_by(|a, b| a.timestep == b.timestep) {
        row(&images[0].timestep.to_string(), images);
    }
    row("mean", &evaluation.images);
    let ms = evaluation.median_render_ms;
    table + &format!("{:.1} frames a second ({ms:.2} ms an image, {})", 1000.0 / ms, evaluation.device)
}

/// What the TC3DGS protocol calls its metrics.
pub fn protocol_line(evaluation: &Evaluation) -> String {
    let (psnr, ssim) = protocol(evaluation);
    format!("protocol tc3dgs: PSNR {}, SSIM {}", decimal(psnr, 2), decimal(ssim, 4))
}

fn protocol(evaluation: &Evaluation) -> (Option<f64>, Option<f64>) {
    (evaluation.mean(|i| Some(i.psnr_per_channel)), evaluation.mean(|i| Some(i.ssim)))
}

fn decimal(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".into(), |value| format!("{value:.digits$}"))
}

/// One line an image.
pub fn csv(evaluation: &Evaluation) -> String {
    let mut text = String::from("timestep,camera,psnr,psnr_per_channel,ssim\n");
    for i in &evaluation.images {
        let _ = writeln!(text, "{},{},{},{},{}", i.timestep, i.camera, i.psnr, i.psnr_per_channel, i.ssim);
    }
    text
}

/// The result for machines; what is not measured is null.
pub fn json(scene: &Scene, evaluation: &Evaluation, protocol_name: Option<&str>) -> Value {
    let images: Vec<Value> = evaluation
        .images
        .iter()
        .map(|i| {
            json!({
                "timestep": i.timestep,
                "camera": i.camera,
                "psnr": i.psnr,
                "psnr_per_channel": i.psnr_per_channel,
                "ssim": i.ssim,
                "ms_ssim": null,
                "dssim": null,
                "lpips_vgg": null,
                "lpips_alex": null,
            })
        })
        .collect();
    let (psnr, ssim) = protocol(evaluation);
    let protocol_metrics = match protocol_name {
        Some(_) => json!({ "psnr": psnr, "ssim": ssim }),
        None => json!({}),
    };
    json!({
        "scene": scene.path.display().to_string(),
        "protocol": protocol_name,
        "num_gaussians": scene.num_gaussians(),
        "num_timesteps": scene.num_timesteps(),
        "bytes": scene.bytes,
        "psnr": evaluation.mean(|i| Some(i.psnr)),
        "psnr_per_channel": psnr,
        "ssim": ssim,
        "ms_ssim": null,
        "dssim": null,
        "lpips_vgg": null,
        "lpips_alex": null,
        "flicker": null,
        "fps": 1000.0 / evaluation.median_render_ms,
        "fps_device": evaluation.device,
        "protocol_metrics": protocol_metrics,
        "images": images,
    })
}
