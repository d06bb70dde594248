//! From a capture to a file and back, as a user does it: output, written files, and unchanged files.

use std::fs;

use crate::support::*;
use serde_json::Value;
use tcgs_interchange::read_params_npz;
use tempfile::tempdir;

const ATTRIBUTES: [&str; 5] = ["means", "quats", "log_scales", "logit_opacities", "colors"];
const EVAL: [&str; 18] = [
    "scene",
    "protocol",
    "num_gaussians",
    "num_timesteps",
    "bytes",
    "psnr",
    "psnr_per_channel",
    "ssim",
    "ms_ssim",
    "dssim",
    "lpips_vgg",
    "lpips_alex",
    "flicker",
    "fps",
    "fps_device",
    "changed_colors",
    "protocol_metrics",
    "images",
];
const IMAGE: [&str; 9] =
    ["timestep", "camera", "psnr", "psnr_per_channel", "ssim", "ms_ssim", "dssim", "lpips_vgg", "lpips_alex"];

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value}, expected a number"))
}

fn mean_of_images(result: &Value, metric: &str) -> f64 {
    let images = result["images"].as_array().unwrap();
    images.iter().map(|image| number(&image[metric])).sum::<f64>() / images.len() as f64
}

#[test]
fn a_capture_becomes_a_small_file_that_renders() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let (capture, run) = (text(capture()), path("run"));

    let result = path("train.json");
    let said = succeed(&[
        "train",
        capture,
        "--out",
        text(&run),
        "--iterations",
        "60,10",
        "--frames",
        "1..4",
        "--json",
        text(&result),
    ]);
    assert!(said.lines().any(|line| line.starts_with("timestep   frame  Gaussians  test PSNR  seconds")), "{said}");
    assert!(said.contains("next: tcgs compress"), "{said}");
    let trained = json(&result);
    assert_keys(&trained, &["run", "num_gaussians", "timesteps"]);
    let timesteps = trained["timesteps"].as_array().unwrap();
    assert_eq!(timesteps.len(), 3);
    for (t, timestep) in timesteps.iter().enumerate() {
        assert_keys(timestep, &["timestep", "psnr", "seconds"]);
        assert_eq!(timestep["timestep"], t);
        assert!(number(&timestep["psnr"]) > 3.0 && number(&timestep["seconds"]) > 0.0);
    }
    let metrics: Vec<Value> = fs::read_to_string(run.join("metrics.jsonl"))
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(metrics[0]["frame"], 1);
    assert_eq!(metrics[2]["loss_curve"].as_array().unwrap().len(), 10);
    assert!(number(&metrics[2]["losses"]["image"]) > 0.0);

    let result = path("floats.json");
    let csv = path("images.csv");
    let table = succeed(&[
        "eval",
        text(&run),
        "--capture",
        capture,
        "--cameras",
        "all",
        "--json",
        text(&result),
        "--csv",
        text(&csv),
    ]);
    assert!(table.contains("cameras: all, also those that were trained on, which flatters"), "{table}");
    assert_eq!(table.lines().filter(|line| line.trim_start().starts_with(char::is_numeric)).count(), 3 + 1, "{table}");
    let floats = json(&result);
    assert_keys(&floats, &EVAL);
    let n = floats["num_gaussians"].as_u64().unwrap();
    assert_eq!(floats["bytes"], n * (40 * 3 + 16));
    assert_eq!((floats["protocol"].is_null(), floats["lpips_vgg"].is_null()), (true, true));
    let images = floats["images"].as_array().unwrap();
    assert_eq!(images.len(), 3 * (4 + 1));
    for image in images {
        assert_keys(image, &IMAGE);
        assert!(image["ms_ssim"].is_null() && number(&image["psnr"]) <= number(&image["psnr_per_channel"]) + 1e-9);
    }
    for metric in ["psnr", "psnr_per_channel", "ssim"] {
        assert!((mean_of_images(&floats, metric) - number(&floats[metric])).abs() < 1e-9, "{metric}");
    }
    let csv = fs::read_to_string(csv).unwrap();
    let header = "timestep,camera,psnr,psnr_per_channel,ssim,ms_ssim,dssim,lpips_vgg,lpips_alex";
    assert_eq!((csv.lines().count(), csv.lines().next()), (16, Some(header)));
    assert!(csv.lines().skip(1).all(|line| line.ends_with(",,,,")), "what is not measured is empty: {csv}");
    assert!(table.contains("LPIPS: not measured without weights") && table.contains("MS-SSIM, D-SSIM: not"), "{table}");
    assert!(number(&floats["flicker"]) > 0.0);

    let result = path("compress.json");
    let said = succeed(&["compress", text(&run), "--json", text(&result), "--refine", "off"]);
    assert!(said.contains("learned by the run"), "{said}");
    let compressed = json(&result);
    let file = run.join("scene.tcgs");
    let bytes = fs::metadata(&file).unwrap().len();
    assert_keys(&compressed, &["out", "num_gaussians_before", "num_gaussians", "stages", "ratio", "declared_errors"]);
    assert_eq!(compressed["num_gaussians_before"], n);
    let stages = compressed["stages"].as_array().unwrap();
    let names: Vec<&str> = stages.iter().map(|stage| stage["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["raw", "pruned", "quantised", "keypoints", "file"]);
    assert_eq!((&stages[0]["bytes"], &stages[4]["bytes"]), (&floats["bytes"], &Value::from(bytes)));
    assert!((number(&compressed["ratio"]) - number(&floats["bytes"]) / bytes as f64).abs() < 1e-9);

    let result = path("info.json");
    let said = succeed(&["info", text(&file), "--json", text(&result)]);
    assert!(said.contains("(frames 1 to 3)") && !said.contains("WRONG"), "{said}");
    let info = json(&result);
    assert_keys(
        &info,
        &[
            "kind",
            "version",
            "num_gaussians",
            "num_timesteps",
            "first_frame",
            "frame_rate",
            "sh_degree",
            "antialiased",
            "background",
            "bounds",
            "raw_bytes",
            "bytes",
            "bytes_by_attribute",
            "segments",
            "bits_histogram",
            "keypoints_mean",
            "checksums_ok",
            "bytes_before",
            "declared_errors",
            "cohorts",
        ],
    );
    assert_eq!((&info["bytes"], &info["first_frame"], &info["checksums_ok"]), (&bytes.into(), &1.into(), &true.into()));
    for key in ["bytes_by_attribute", "bits_histogram", "keypoints_mean"] {
        assert_keys(&info[key], &ATTRIBUTES);
    }
    let kept = compressed["num_gaussians"].as_u64().unwrap();
    let counted: u64 =
        info["bits_histogram"]["colors"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum();
    assert_eq!(counted, kept);

    let result = path("file.json");
    let arguments = ["eval", text(&file), "--capture", capture, "--cameras", "all", "--json", text(&result)];
    let said = succeed(&[&arguments[..], &["--protocol", "tc3dgs", "--threads", "1"]].concat());
    assert!(said.contains("protocol tc3dgs: PSNR") && said.contains("LPIPS -"), "{said}");
    assert!(said.contains("NOT held out: all); frames 1..4 of 4; 48x36 as captured"), "{said}");
    let decoded = json(&result);
    assert_eq!((&decoded["bytes"], &decoded["num_gaussians"]), (&bytes.into(), &kept.into()));
    assert_eq!((&decoded["protocol"], &decoded["fps_device"]), (&"tc3dgs".into(), &"cpu, 1 threads".into()));
    assert_eq!(decoded["protocol_metrics"]["psnr"], decoded["psnr_per_channel"]);
    assert!(
        (number(&decoded["psnr"]) - number(&floats["psnr"])).abs() < 0.5,
        "compression must not change the pictures"
    );

    let frames = path("frames");
    succeed(&[
        "render",
        text(&file),
        "--out",
        text(&frames),
        "--path",
        "spiral",
        "--size",
        "40x20",
        "--frames",
        "2..4",
    ]);
    let mut names: Vec<_> = fs::read_dir(&frames).unwrap().map(|e| e.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names, ["000002.png", "000003.png"]);
    assert_eq!(image::image_dimensions(frames.join("000002.png")).unwrap(), (40, 20));
    succeed(&["render", text(&run), "--out", text(&frames), "--cameras", capture, "--force"]);
    let pictures: Vec<_> = fs::read_dir(&frames).unwrap().map(|e| e.unwrap().path()).collect();
    assert_eq!(pictures.len(), 1, "one test camera, and nothing of before: {pictures:?}");
    assert_eq!(image::image_dimensions(pictures[0].join("000001.png")).unwrap(), (48, 36));
}

#[test]
fn a_run_goes_to_params_npz_and_from_there_to_a_file() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let run = train(&folder, "run", &["--preset", "d3dgs"]);
    let params = path("params.npz");
    succeed(&["export", text(&run), "--to", text(&params)]);
    let floats = read_params_npz(&params).unwrap();
    assert_eq!(floats.num_timesteps(), 4);

    let said = succeed(&["compress", text(&run), "--json", text(&path("run.json"))]);
    assert!(said.contains("by sensitivity, measured with 4 training cameras of"), "{said}");
    let said = succeed(&["compress", text(&params), "--json", text(&path("around.json"))]);
    assert!(said.contains("16 cameras around the scene"), "{said}");
    let result = json(&path("around.json"));
    assert_eq!(result["num_gaussians"], floats.num_gaussians());
    assert_eq!(result["out"], text(&path("params.tcgs")));
    let out = path("b.tcgs");
    let given = ["compress", text(&params), "--capture", text(capture()), "--out", text(&out)];
    let said =
        succeed(&[&given[..], &["--storage", "plain", "--preset", "paper", "--json", text(&path("b.json"))]].concat());
    assert!(said.contains("measured with 4 training cameras") && said.contains("\nplain "), "{said}");
    let stages = &json(&path("b.json"))["stages"];
    assert_eq!((&stages[4]["name"], &stages[5]["name"]), (&"plain".into(), &"file".into()));
    assert_eq!(stages[4]["bytes"], stages[3]["bytes"]);

    // With 16 bits and every timestep, decoding gives the exported values, in another order.
    let precise = path("precise.tcgs");
    let bits = ["--bits", "16,16", "--position-bits", "16"];
    let given = ["compress", text(&params), "--no-keypoints", "--out", text(&precise)];
    let said = succeed(&[&given[..], &bits].concat());
    assert!(said.contains("bits: 16 for every parameter") && !said.contains("keypoints  "), "{said}");
    let back = path("back.npz");
    succeed(&["export", text(&precise), "--to", text(&back)]);
    let back = read_params_npz(&back).unwrap();
    let sorted = |scene: &tcgs_core::DynamicGaussians| {
        let mut x: Vec<f32> = scene.means(3).iter().map(|mean| mean[0]).collect();
        x.sort_by(f32::total_cmp);
        x
    };
    let far = sorted(&floats).iter().zip(&sorted(&back)).map(|(a, b)| (a - b).abs()).fold(0.0_f32, f32::max);
    assert!(far < 2e-3 && back.num_gaussians() == floats.num_gaussians(), "{far}");

    let bits = |options: &[&str]| {
        let out = path("bits.tcgs");
        succeed(&[&["compress", text(&run), "--out", text(&out), "--force", "--refine", "off"], options].concat());
        succeed(&["info", text(&out), "--json", text(&path("bits.json")), "--force"]);
        let info = json(&path("bits.json"));
        let widths = |attribute| keys(&info["bits_histogram"][attribute]).iter().map(|b| b.parse().unwrap()).collect();
        (widths("means"), widths("colors"), number(&info["keypoints_mean"]["colors"]))
    };
    let (means, colors, _): (Vec<u8>, Vec<u8>, f64) = bits(&["--bits", "2,3", "--position-bits", "12"]);
    assert_eq!((means, colors.iter().min(), colors.iter().max()), (vec![12], Some(&2), Some(&3)));
    let (_, _, all) = bits(&["--no-keypoints"]);
    let (_, _, few) = bits(&["--max-mse", "0", "--max-keypoints", "2"]);
    let (_, _, one) = bits(&["--max-mse", "1000"]);
    assert_eq!((all, one), (4.0, 1.0));
    assert!(few > one && few <= 2.0, "{few}");
}

#[test]
fn masks_prune_and_their_threshold_can_be_given() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &["--set", "mask.enabled=true", "--set", "rates.mask=0.001"]);
    let count = |threshold: &str| {
        let (out, result) = (folder.path().join("a.tcgs"), folder.path().join("a.json"));
        let arguments = ["compress", text(&run), "--prune", threshold, "--out", text(&out), "--force"];
        succeed(&[&arguments[..], &["--json", text(&result)]].concat());
        json(&result)["num_gaussians"].as_u64().unwrap()
    };
    let (all, some) = (count("0"), count("0.3"));
    assert!(all > some && some > 0, "{all}, {some}");
    let message = fail(2, &["compress", text(&run), "--prune", "0.999999"]);
    assert!(message.contains("largest mean mask"), "{message}");
}

#[test]
fn checkpoints_depend_on_settings_alone() {
    let folder = tempdir().unwrap();
    let one = checkpoints(&train(&folder, "one", &["--threads", "1"]));
    let three = checkpoints(&train(&folder, "three", &["--threads", "3", "--backend", "cpu"]));
    assert!(one == three, "another number of threads changed the result");
    assert!(one.iter().all(|(_, file)| file[10..14] == [0, 0, 0x21, 0]), "a checkpoint tells when it was written");
    let seed = checkpoints(&train(&folder, "seed", &["--seed", "1"]));
    assert!(one != seed, "the seed changed nothing");

    let again = folder.path().join("again");
    let config = folder.path().join("one/config.toml");
    succeed(&["train", text(capture()), "--out", text(&again), "--config", text(&config)]);
    assert!(one == checkpoints(&again), "a run's config.toml did not repeat it");
    assert_eq!(fs::read(config).unwrap(), fs::read(again.join("config.toml")).unwrap());
}

#[test]
fn settings_come_from_preset_file_and_options_in_this_order() {
    let folder = tempdir().unwrap();
    let file = folder.path().join("settings.toml");
    fs::write(&file, "seed = 5\n[weights]\nrigid = 1.5\niso = 1.5\n[mask]\nthreshold = 0.2\n").unwrap();
    let more = ["--preset", "paper", "--config", text(&file), "--set", "weights.iso=2.5", "--set", "seed=6"];
    let run = train(&folder, "run", &[&more[..], &["--seed", "7", "--bits", "5,5", "--frames", "0..2"]].concat());
    let config = tcgs_train::Run::open(&run).unwrap().config().clone();
    assert_eq!((config.seed, config.weights.rigid, config.weights.iso), (7, 1.5, 2.5));
    assert_eq!((config.mask.threshold, config.quantize.learned_offset), (0.2, false));
    assert_eq!((config.quantize.min_bits, config.quantize.max_bits, config.data.end_frame), (5, 5, 2));
    assert_eq!(config.data.capture, text(&capture().canonicalize().unwrap()));

    let run = train(&folder, "plain", &["--no-mask", "--no-quantize", "--downscale", "2", "--frames", "2..3"]);
    let config = tcgs_train::Run::open(&run).unwrap().config().clone();
    assert_eq!((config.mask.enabled, config.quantize.enabled, config.data.downscale), (false, false, 2));
    let result = folder.path().join("plain.json");
    succeed(&["eval", text(&run), "--capture", text(capture()), "--json", text(&result)]);
    assert_eq!(json(&result)["images"][0]["timestep"], 0);
    succeed(&["compress", text(&run)]);
    succeed(&["info", text(&run.join("scene.tcgs")), "--json", text(&result), "--force"]);
    assert_eq!(json(&result)["first_frame"], 2);
}

#[test]
fn every_protocol_has_its_names_and_lpips_where_there_are_weights() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &["--frames", "0..1"]);
    let weights = std::env::var("TCGS_LPIPS_WEIGHTS").unwrap_or_default();
    if weights.is_empty() {
        skip("REQUIRE_GOLDEN", "TCGS_LPIPS_WEIGHTS names no file");
    }
    let names: [(&str, &[&str]); 3] = [
        ("tc3dgs", &["psnr", "ssim", "lpips"]),
        ("4dgs", &["psnr", "ssim", "lpips_vgg", "lpips_alex", "ms_ssim", "dssim"]),
        ("stg", &["psnr", "ssim", "ssimsv2", "lpips", "lpips_vgg"]),
    ];
    for (protocol, names) in names {
        let (result, csv) = (folder.path().join(format!("{protocol}.json")), folder.path().join(protocol));
        let common = ["eval", text(&run), "--capture", text(capture()), "--protocol", protocol];
        let more = ["--json", text(&result), "--csv", text(&csv), "--lpips-weights", &weights];
        let more = if weights.is_empty() { &more[..4] } else { &more[..] };
        let said = succeed(&[&common[..], more].concat());
        assert!(said.contains(&format!("\nprotocol {protocol} (")) && said.contains("\n  cameras "), "{said}");
        assert_eq!(said.contains("LPIPS: not measured"), weights.is_empty(), "{said}");
        let result = json(&result);
        assert_keys(&result["protocol_metrics"], names);
        assert!(result["flicker"].is_null(), "one frame does not flicker");
        for (name, value) in result["protocol_metrics"].as_object().unwrap() {
            let small = ["ms_ssim", "dssim"].contains(&name.as_str());
            let blind = small || name.starts_with("lpips") && weights.is_empty();
            assert_eq!(value.is_null(), blind, "{protocol} {name}: {value}");
        }
        assert_eq!(result["lpips_vgg"].is_null(), weights.is_empty());
        let header = fs::read_to_string(csv).unwrap().lines().next().unwrap().to_owned();
        assert!(names.iter().all(|name| header.contains(&format!(",{protocol}_{name}"))), "{header}");
    }
}

/// Antialiasing and the background pass from the training into the file, and the file is drawn with both.
#[test]
fn a_file_is_drawn_as_its_training_drew() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let run = train(
        &folder,
        "run",
        &["--set", "render.antialiased=true", "--set", "render.background=true", "--frames", "0..2"],
    );
    // A resumed run keeps the setting that it reads from the disk.
    let resumed = ["train", text(capture()), "--out", text(&run), "--resume", "--frames", "0..3"];
    succeed(&[&resumed[..], &["--iterations", "30,10"], &["--set", "births.enabled=false"]].concat());
    let (file, result) = (path("scene.tcgs"), path("result.json"));
    let said = succeed(&["compress", text(&run), "--quality", "4", "--refine", "off", "--out", text(&file)]);
    assert!(said.contains("Gaussians, antialiased, "), "{said}");
    succeed(&["info", text(&file), "--json", text(&result)]);
    assert_eq!((&json(&result)["antialiased"], &json(&result)["version"]), (&true.into(), &2.into()));
    let background = json(&result)["background"].clone();
    assert_ne!(background, serde_json::json!([0, 0, 0]));
    succeed(&["info", text(&run), "--json", text(&result), "--force"]);
    assert_eq!(json(&result)["background"], background);
    let psnr = |scene: &std::path::Path| {
        let given = ["eval", text(scene), "--capture", text(capture()), "--cameras", "train", "--json", text(&result)];
        succeed(&[&given[..], &["--force"]].concat());
        json(&result)["psnr"].as_f64().unwrap()
    };
    let (of_run, of_file) = (psnr(&run), psnr(&file));
    assert!((of_run - of_file).abs() < 0.1, "{of_run} dB of the run, {of_file} dB of the file");
    // Version 1 cannot hold antialiased scenes.
    let message = fail(2, &["compress", text(&run), "--format", "1", "--out", text(&path("1.tcgs"))]);
    assert!(message.contains("antialiasing"), "{message}");
}
