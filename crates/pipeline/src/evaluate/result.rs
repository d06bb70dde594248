//! The JSON output of an evaluation, and the metrics that every evaluation has.

use serde_json::{Map, Value, json};
use tcgs_core::SceneReader;
use tcgs_metrics::Protocol;

use super::{Evaluation, ImageScore};
use crate::OpenScene;

/// A metric that every evaluation has.
#[derive(Clone, Copy, Debug)]
pub struct MetricColumn {
    /// The name of the metric in JSON and CSV.
    pub key: &'static str,
    /// The name of the metric in the table.
    pub title: &'static str,
    /// Digits after the point in the table.
    pub decimals: usize,
    /// The metric of an image.
    pub of: fn(&ImageScore) -> Option<f64>,
}

/// The metrics that the table, the CSV and the JSON of an evaluation have in common, in this order.
pub const COLUMNS: [MetricColumn; 7] = [
    MetricColumn { key: "psnr", title: "PSNR", decimals: 2, of: |i| Some(i.psnr) },
    MetricColumn { key: "psnr_per_channel", title: "PSNR/channel", decimals: 2, of: |i| Some(i.psnr_per_channel) },
    MetricColumn { key: "ssim", title: "SSIM", decimals: 4, of: |i| Some(i.ssim) },
    MetricColumn { key: "ms_ssim", title: "MS-SSIM", decimals: 4, of: |i| i.ms_ssim },
    MetricColumn { key: "dssim", title: "D-SSIM", decimals: 4, of: |i| i.dssim },
    MetricColumn { key: "lpips_vgg", title: "LPIPS-VGG", decimals: 4, of: |i| i.lpips_vgg },
    MetricColumn { key: "lpips_alex", title: "LPIPS-Alex", decimals: 4, of: |i| i.lpips_alex },
];

/// An evaluation as a JSON object: the means, and the metrics of every image. A metric that was not measured is null,
/// never 0.
pub fn evaluation_json(scene: &OpenScene, evaluation: &Evaluation, protocol: Option<Protocol>) -> Value {
    let images = evaluation.images.iter().map(|image| {
        let mut object = Map::new();
        object.insert("timestep".into(), image.timestep.into());
        object.insert("camera".into(), image.camera.into());
        object.extend(COLUMNS.iter().map(|column| (column.key.to_owned(), json!((column.of)(image)))));
        Value::Object(object)
    });
    let protocol_metrics: Map<String, Value> = protocol.map_or_else(Map::new, |protocol| {
        let metrics = protocol.rules().metrics.iter().enumerate();
        metrics.map(|(index, metric)| (metric.key.to_owned(), json!(protocol_mean(evaluation, index)))).collect()
    });
    let mut result = json!({
        "scene": scene.path.display().to_string(),
        "protocol": protocol.map(|protocol| protocol.rules().name),
        "num_gaussians": scene.num_identities().unwrap_or_else(|| scene.max_gaussians()),
        "num_timesteps": scene.num_timesteps(),
        "bytes": scene.bytes,
        "flicker": evaluation.flicker,
        "fps": 1000.0 / evaluation.median_render_ms,
        "fps_device": evaluation.device,
        "changed_colors": evaluation.changed_colors,
        "protocol_metrics": protocol_metrics,
        "images": images.collect::<Vec<_>>(),
    });
    for column in &COLUMNS {
        result[column.key] = json!(evaluation.mean(column.of));
    }
    result
}

/// Mean of a protocol's metric over the images that have it.
///
/// - `index`: in the rules of the protocol
pub fn protocol_mean(evaluation: &Evaluation, index: usize) -> Option<f64> {
    evaluation.mean(|image| image.protocol.get(index).copied().flatten())
}
