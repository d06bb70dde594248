//! An evaluation for machines. What is not measured is null.

use serde_json::{Map, Value, json};
use tcgs_metrics::Protocol;
use tcgs_pipeline::OpenScene;

use super::measure::Evaluation;
use super::table::{COLUMNS, protocol_mean};

/// The result of `tcgs eval --json`.
pub fn json(scene: &OpenScene, evaluation: &Evaluation, protocol: Option<Protocol>) -> Value {
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
        "num_gaussians": scene.num_gaussians(),
        "num_timesteps": scene.num_timesteps(),
        "bytes": scene.bytes,
        "flicker": evaluation.flicker,
        "fps": 1000.0 / evaluation.median_render_ms,
        "fps_device": evaluation.device,
        "protocol_metrics": protocol_metrics,
        "images": images.collect::<Vec<_>>(),
    });
    for column in &COLUMNS {
        result[column.key] = json!(evaluation.mean(column.of));
    }
    result
}
