//! The times as text and as JSON.

use std::fmt::Write;
use std::path::Path;

use serde_json::{Value, json};
use tcgs_pipeline::Backend;

use super::measure::{Counts, Measured, Samples, Spread};
use super::scene::BenchScene;

/// The device, in one line.
pub fn device_line(backend: &Backend) -> String {
    match backend.gpu_info() {
        None => format!("the CPU, {} threads", rayon::current_num_threads()),
        Some(info) => {
            let kind = if info.is_software { ", software" } else { "" };
            let features = if info.features.is_empty() { "none".into() } else { info.features.join(", ") };
            format!("{} ({}{kind}), driver {}, optional features: {features}", info.name, info.backend, info.driver)
        }
    }
}

/// One scene's times, milliseconds.
pub fn text(scene: &BenchScene, measured: &Measured, counts: Counts) -> String {
    let (n, size, m) = (scene.state.parameters.num_gaussians(), scene.size(), measured);
    let num_images = scene.targets.len();
    let images = if num_images == 1 { String::new() } else { format!(", {num_images} images") };
    let mut table = format!(
        "\n{}: {n} Gaussians, {}x{}{images}; {:.0} splats reach a tile, {:.0} pairs of tile and splat, {:.1} a splat\n",
        scene.name,
        size.width,
        size.height,
        m.splats,
        m.pairs,
        m.pairs / m.splats.max(1.0)
    );
    let samples = if counts.samples == 1 { "1 sample".into() } else { format!("{} samples", counts.samples) };
    let _ = writeln!(table, "{:<34}{:>10}{:>10}{:>10}", format!("milliseconds, {samples}"), "median", "p10", "p90");
    let mut row = |name: &str, s: Spread| {
        let _ = writeln!(table, "{name:<34}{:>10.3}{:>10.3}{:>10.3}", s.median, s.p10, s.p90);
    };
    let mut part = |name: &str, samples: &Samples| {
        row(name, samples.total());
        for (stage, spread) in samples.stages() {
            row(&format!("  {stage}"), spread);
        }
    };
    part("forward, 3 channels", &m.forward);
    part("forward + backward, 3 channels", &m.forward_backward);
    let channels = scene.targets[0].image.num_channels;
    part(&format!("training iteration, {channels} channels"), &m.iteration);
    part(&format!("of the first timestep, {channels} channels"), &m.first_iteration);
    let share = 100.0 * m.part_tiles;
    part(&format!("of {} Gaussians, {share:.0} % of tiles", m.part_gaussians), &m.part_iteration);
    let name = format!("an iteration of {} in a row", counts.in_a_row);
    table + &format!("{name:<34}{:>10.3}", m.wall_ms)
}

fn spread_json(s: Spread) -> Value {
    json!({ "median": s.median, "p10": s.p10, "p90": s.p90 })
}

fn stages_json(samples: &Samples) -> Vec<Value> {
    let stages = samples.stages().into_iter();
    stages.map(|(name, s)| json!({ "name": name, "median": s.median, "p10": s.p10, "p90": s.p90 })).collect()
}

/// One scene's times as JSON, milliseconds.
///
/// - `files`: the folder that the scene was written to
pub fn scene_json(scene: &BenchScene, measured: &Measured, counts: Counts, files: Option<&Path>) -> Value {
    let (size, m) = (scene.size(), measured);
    json!({
        "name": scene.name,
        "files": files,
        "gaussians": scene.state.parameters.num_gaussians(),
        "width": size.width,
        "height": size.height,
        "images": scene.targets.len(),
        "channels": scene.targets[0].image.num_channels,
        "splats": m.splats,
        "pairs": m.pairs,
        "iterations": counts.samples,
        "forward_ms": spread_json(m.forward.total()),
        "forward_backward_ms": spread_json(m.forward_backward.total()),
        "render_stages": stages_json(&m.forward_backward),
        "iteration_ms": spread_json(m.iteration.total()),
        "stages": stages_json(&m.iteration),
        "first_iteration_ms": spread_json(m.first_iteration.total()),
        "first_stages": stages_json(&m.first_iteration),
        "part_iteration_ms": spread_json(m.part_iteration.total()),
        "part_stages": stages_json(&m.part_iteration),
        "part_gaussians": m.part_gaussians,
        "part_tiles": m.part_tiles,
        "wall_ms_per_iteration": m.wall_ms,
        "wall_iterations": counts.in_a_row,
    })
}

/// The whole result as JSON.
pub fn json(backend: &Backend, scenes: Vec<Value>) -> Value {
    let threads = rayon::current_num_threads();
    match backend.gpu_info() {
        None => json!({
            "device": "CPU",
            "driver": null,
            "backend": "cpu",
            "features": [],
            "software": false,
            "threads": threads,
            "scenes": scenes,
        }),
        Some(info) => json!({
            "device": info.name,
            "driver": info.driver,
            "backend": info.backend,
            "features": info.features,
            "software": info.is_software,
            "threads": threads,
            "scenes": scenes,
        }),
    }
}
