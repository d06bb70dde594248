//! `tcgs bench`: its output has every figure. The tests do not check speed.

use crate::support::*;
use serde_json::Value;
use tcgs_core::{Camera, activate};
use tcgs_interchange::{NpzReader, ReadSettings, read_ply};
use tcgs_render::gpu::{Gpu, GpuChoice};
use tcgs_render::{CpuRasterizer, Rasterizer, RenderSettings};
use tempfile::tempdir;

const RENDER_STAGES: [&str; 5] = ["project", "sort", "rasterize", "rasterize backward", "project backward"];
const STAGES: [&str; 11] = [
    "activate",
    "project",
    "sort",
    "rasterize",
    "image losses",
    "rasterize backward",
    "project backward",
    "activate backward",
    "motion losses",
    "sums, small Adam",
    "Adam",
];
const SCENE: [&str; 23] = [
    "name",
    "files",
    "gaussians",
    "width",
    "height",
    "images",
    "channels",
    "splats",
    "pairs",
    "iterations",
    "forward_ms",
    "forward_backward_ms",
    "render_stages",
    "iteration_ms",
    "stages",
    "first_iteration_ms",
    "first_stages",
    "part_iteration_ms",
    "part_stages",
    "part_gaussians",
    "part_tiles",
    "wall_ms_per_iteration",
    "wall_iterations",
];

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}, expected a number"))
}

/// Runs the bench on small scenes; returns its output and its JSON.
fn bench(more: &[&str]) -> (String, Value) {
    let folder = tempdir().unwrap();
    let path = folder.path().join("bench.json");
    let said = succeed(&[&["bench", "--json", text(&path)], more].concat());
    (said, json(&path))
}

/// Returns the median of some times, and checks the percentiles.
fn check_spread(value: &Value) -> f64 {
    let [p10, median, p90] = ["p10", "median", "p90"].map(|name| number(&value[name]));
    assert!(0.0 < p10 && p10 <= median && median <= p90, "{value}");
    median
}

/// Sum of the stages' medians.
fn check_stages(stages: &Value, names: &[&str]) -> f64 {
    let stages = stages.as_array().unwrap();
    assert_eq!(stages.iter().map(|stage| stage["name"].as_str().unwrap()).collect::<Vec<_>>(), names);
    stages.iter().map(check_spread).sum()
}

fn check_scene(scene: &Value, stages: &[&str]) {
    assert_keys(scene, &SCENE);
    check_spread(&scene["forward_ms"]);
    assert!(number(&scene["wall_ms_per_iteration"]) > 0.0);
    assert_eq!((&scene["iterations"], &scene["channels"]), (&3.into(), &5.into()));
    let (splats, pairs) = (number(&scene["splats"]), number(&scene["pairs"]));
    assert!(0.0 < splats && splats <= number(&scene["gaussians"]) && splats <= pairs, "{splats} {pairs}");
    for total in ["forward_backward_ms", "iteration_ms", "first_iteration_ms", "part_iteration_ms"] {
        check_spread(&scene[total]);
    }
    assert_eq!(scene["part_gaussians"], 300, "15 % of 2000");
    let tiles = number(&scene["part_tiles"]);
    assert!(0.0 < tiles && tiles <= 1.0, "{tiles}");
    check_stages(&scene["render_stages"], &RENDER_STAGES);
    check_stages(&scene["stages"], stages);
    check_stages(&scene["part_stages"], stages);
    // Without losses on motion this stage may take no time at all.
    let first = scene["first_stages"].as_array().unwrap();
    assert_eq!(first.iter().map(|stage| stage["name"].as_str().unwrap()).collect::<Vec<_>>(), stages);
}

/// Asserts that the stages add up to the total. Uses a single sample: medians of several need not add up.
fn check_sums(arguments: &[&str], stages: &[&str]) {
    let (_, result) = bench(&[arguments, &["--iterations", "1"]].concat());
    let scene = &result["scenes"][0];
    for (total, of_stages) in [
        (&scene["forward_backward_ms"], check_stages(&scene["render_stages"], &RENDER_STAGES)),
        (&scene["iteration_ms"], check_stages(&scene["stages"], stages)),
    ] {
        let total = check_spread(total);
        assert!(of_stages <= total * (1.0 + 1e-6), "the stages take {of_stages} ms of {total}");
        // The time between two stages is short, unless other work takes the processor just then.
        assert!(of_stages > 0.5 * total, "the stages take {of_stages} ms of {total}");
    }
}

#[test]
fn every_stage_is_timed_on_the_cpu() {
    let (said, result) =
        bench(&["--backend", "cpu", "--gaussians", "2000", "--size", "64x48,32x24", "--iterations", "3"]);
    assert_keys(&result, &["device", "driver", "backend", "features", "software", "threads", "scenes"]);
    assert_eq!(
        (&result["device"], &result["backend"], &result["software"]),
        (&"CPU".into(), &"cpu".into(), &false.into())
    );
    let stages: Vec<&str> = STAGES.into_iter().filter(|&stage| stage != "sums, small Adam").collect();
    let scenes = result["scenes"].as_array().unwrap();
    assert_eq!(scenes.iter().map(|scene| scene["width"].as_u64().unwrap()).collect::<Vec<_>>(), [64, 32]);
    for scene in scenes {
        check_scene(scene, &stages);
        assert_eq!((&scene["name"], &scene["gaussians"]), (&"random".into(), &2000.into()));
    }
    check_sums(&["--backend", "cpu", "--gaussians", "2000", "--size", "64x48"], &stages);
    assert!(said.starts_with("the CPU, ") && said.contains("random: 2000 Gaussians, 64x48; "), "{said}");
    assert!(stages.iter().all(|stage| said.contains(stage)), "{said}");
}

#[test]
fn a_capture_is_a_scene() {
    let (said, result) =
        bench(&["--backend", "cpu", "--capture", text(capture()), "--downscale", "2", "--iterations", "3"]);
    let scene = &result["scenes"][0];
    assert_keys(scene, &SCENE);
    assert_eq!((&scene["width"], &scene["height"], &scene["images"]), (&24.into(), &18.into(), &4.into()));
    assert!(said.contains(", 4 images; "), "{said}");
}

#[test]
fn a_scene_is_written_as_it_is_drawn() {
    let folder = tempdir().unwrap();
    let place = folder.path().join("scenes");
    let arguments = ["--backend", "cpu", "--gaussians", "500", "--size", "64x48,32x24", "--iterations", "1"];
    let arguments = [&arguments[..], &["--write-scene", text(&place)]].concat();
    let (_, result) = bench(&arguments);
    for (i, (width, height)) in [(64, 48), (32, 24)].into_iter().enumerate() {
        let files = place.join(format!("random-{width}x{height}"));
        assert_eq!(result["scenes"][i]["files"], text(&files));
        let gaussians = read_ply(&files.join("gaussians.ply"), ReadSettings::default()).unwrap();
        assert_eq!(gaussians.num_gaussians(), 500);
        let camera = json(&files.join("camera.json"));
        let pair = |name: &str| [0, 1].map(|i| number(&camera[name][i]));
        let ([fx, fy], [cx, cy]) = (pair("focal"), pair("principal"));
        let rows = [0, 1, 2, 3].map(|i| [0, 1, 2, 3].map(|j| number(&camera["camera_from_world"][i][j])));
        let intrinsics = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
        let camera = Camera::new(width, height, intrinsics, rows).unwrap();
        let (drawn, _) = CpuRasterizer.forward(&activate(&gaussians), &camera, &RenderSettings::default()).unwrap();
        let image = NpzReader::open(&files.join("image.npz")).unwrap().array("image").unwrap();
        assert_eq!(image.shape, [height, width, 3]);
        let close = |at: usize| (image.values[at] - drawn.image.plane(at % 3)[at / 3]).abs() < 1e-5;
        assert!((0..image.values.len()).all(close), "colours of a PLY file differ by 3e-8, and no more");
        assert!(image.values.iter().any(|&value| value > 0.1));
    }
    let again = [&["bench"], &arguments[..]].concat();
    let said = fail(2, &again);
    assert!(said.contains("scenes: exists already") && said.contains("--force"), "{said}");
    succeed(&[&again[..], &["--force"]].concat());
}

#[test]
fn every_stage_is_timed_on_a_gpu() {
    let name = std::env::var("TCGS_TEST_GPU").unwrap_or_else(|_| "llvmpipe".into());
    let gpu = match Gpu::open(GpuChoice::Named(&name)) {
        Ok(gpu) => gpu,
        Err(error) => {
            return skip("REQUIRE_GPU", error);
        }
    };
    let small = ["--gaussians", "2000", "--size", "64x48"];
    let on_gpu = [&small[..], &["--device", &name]].concat();
    let (said, result) = bench(&[&on_gpu[..], &["--iterations", "3"]].concat());
    let info = gpu.info();
    assert_eq!((&result["device"], &result["driver"]), (&info.name.clone().into(), &info.driver.clone().into()));
    assert_eq!(result["features"].as_array().unwrap().len(), info.features.len());
    assert!(said.starts_with(&info.name), "{said}");
    let scene = &result["scenes"][0];
    if info.features.contains(&"timestamps") {
        check_scene(scene, &STAGES);
        check_sums(&on_gpu, &STAGES);
    } else {
        assert_keys(scene, &SCENE);
        check_stages(&scene["render_stages"], &["render"]);
        check_stages(&scene["stages"], &["iteration"]);
    }
    // Only the GPU omits tiles in which a splat reaches no pixel.
    let (_, on_cpu) = bench(&[&small[..], &["--backend", "cpu", "--iterations", "1"]].concat());
    let cpu = &on_cpu["scenes"][0];
    assert_eq!(scene["gaussians"], cpu["gaussians"]);
    assert!(number(&scene["pairs"]) <= number(&cpu["pairs"]) && number(&scene["pairs"]) > 0.5 * number(&cpu["pairs"]));
}
