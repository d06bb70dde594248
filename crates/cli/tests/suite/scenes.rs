//! Scenes of every kind: their description by `tcgs info`, scenes below a folder, and refusals of scenes that are not
//! read.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::support::*;
use serde_json::{Value, json};
use tempfile::tempdir;
use zip::{ZipWriter, write::SimpleFileOptions};

fn given(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../testdata/interchange").join(name)
}

/// The output of `tcgs info`: text and JSON.
fn info(scene: &Path) -> (String, Value) {
    let folder = tempdir().unwrap();
    let result = folder.path().join("info.json");
    (succeed(&["info", text(scene), "--json", text(&result)]), json(&result))
}

const BASICS: [&str; 15] = [
    "kind",
    "version",
    "num_gaussians",
    "least_gaussians",
    "most_gaussians",
    "num_timesteps",
    "first_frame",
    "frame_rate",
    "sh_degree",
    "antialiased",
    "background",
    "axes",
    "bounds",
    "raw_bytes",
    "bytes",
];

#[test]
fn info_tells_the_basics_of_files_of_other_programs() {
    for (name, kind, axes, degree) in [
        ("original.ply", "PLY files", "rdf", 3),
        ("splat_transform.compressed.ply", "PLY files", "rdf", 3),
        ("splat_transform_v4.spz", "SPZ files", "rdf", 3),
        ("splat_transform.glb", "glTF files", "luf", 1),
    ] {
        let (said, basics) = info(&given(name));
        assert_keys(&basics, &BASICS);
        assert!(
            said.contains("Gaussians     260\n") && said.contains(&format!("harmonics     degree {degree}\n")),
            "{said}"
        );
        assert_eq!(basics["kind"], kind, "{name}");
        assert_eq!(basics["axes"], axes, "{name}");
        let expected = json!([260, 260, 260, 1, degree]);
        let found = ["num_gaussians", "least_gaussians", "most_gaussians", "num_timesteps", "sh_degree"];
        assert_eq!(json!(found.map(|key| &basics[key])), expected, "{name}");
        for unknown in ["version", "first_frame", "frame_rate"] {
            assert!(basics[unknown].is_null(), "{name}: {unknown}");
        }
        assert_eq!(basics["bytes"], fs::metadata(given(name)).unwrap().len());
        let corner = |which: &str| basics["bounds"][which].as_array().unwrap().clone();
        let is_below = |(a, b): (&Value, &Value)| a.as_f64() < b.as_f64();
        assert!(corner("min").iter().zip(&corner("max")).all(is_below), "{basics}");
    }
    let (said, basics) = info(&given("fourdgs_births.4dgs"));
    assert_keys(&basics, &BASICS);
    assert!(said.contains("Gaussians     35 to 50\n") && said.contains("frame rate    10"), "{said}");
    assert_eq!((&basics["least_gaussians"], &basics["most_gaussians"]), (&35.into(), &50.into()));
    assert_eq!((&basics["num_timesteps"], &basics["axes"]), (&3.into(), &"rdf".into()));
}

#[test]
fn info_tells_the_basics_of_runs_and_what_comes_of_them() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let run = train(&folder, "run", &["--frames", "1..3"]);
    succeed(&["export", text(&run), "--to", text(&path("params.npz"))]);
    succeed(&["export", text(&run), "--to", text(&path("plys"))]);
    let (said, of_run) = info(&run);
    assert!(said.contains("run folder") && said.contains("2 (frames 1 to 2)"), "{said}");
    let checkpoints = fs::read_dir(run.join("checkpoints")).unwrap().map(|entry| entry.unwrap().path());
    let bytes: u64 = checkpoints
        .filter(|path| path.extension().is_some_and(|e| e == "npz"))
        .map(|p| p.metadata().unwrap().len())
        .sum();
    assert!(of_run["bytes"].as_u64().unwrap() <= bytes && of_run["bytes"].as_u64() > Some(0), "{of_run} {bytes}");
    // Masks may prune some Gaussians of a run.
    let [of_params, of_plys] = ["params.npz", "plys"].map(|name| info(&path(name)).1);
    for same in ["num_timesteps", "first_frame", "sh_degree"] {
        assert_eq!((&of_params[same], &of_plys[same]), (&of_run[same], &of_run[same]), "{same}");
    }
    for same in ["num_gaussians", "bounds", "raw_bytes"] {
        assert_eq!(of_params[same], of_plys[same], "{same}");
    }
    assert_eq!((&of_params["frame_rate"], &of_plys["frame_rate"]), (&of_run["frame_rate"], &Value::Null));
    assert_keys(&of_params, &BASICS);
    let files = fs::read_dir(path("plys")).unwrap().map(|entry| entry.unwrap().metadata().unwrap().len());
    assert_eq!(info(&path("plys")).1["bytes"], files.sum::<u64>());

    // The JSON of a .tcgs file has fields of the same names.
    succeed(&["compress", text(&run)]);
    let (said, of_file) = info(&run.join("scene.tcgs"));
    assert!(said.contains("bounds        "), "{said}");
    assert_eq!((&of_file["kind"], &of_file["sh_degree"]), (&"compressed file".into(), &0.into()));
    let x = |of: &Value| of["bounds"]["min"][0].as_f64().unwrap();
    assert!((x(&of_file) - x(&of_params)).abs() < 0.1, "{of_file}");
    assert!(of_file["raw_bytes"].as_u64() > of_file["bytes"].as_u64(), "{of_file}");
}

#[test]
fn info_says_what_is_no_scene() {
    let folder = tempdir().unwrap();
    let message = fail(2, &["info", text(capture())]);
    assert!(message.contains("a panoptic capture, expected a scene; tcgs train"), "{message}");
    let message = fail(2, &["info", text(folder.path())]);
    assert!(message.contains("a folder without config.toml and without PLY, SPZ, glTF or SOG files"), "{message}");
    let output = run(&["info", text(&given("original.ply")), "--data", "tcgs.credits"]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(message.contains("PLY files, which holds no data of applications, expected a .tcgs file"), "{message}");
}

#[test]
fn kinds_that_are_not_read_are_named() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for (name, contents) in [
        ("garden.sog", &["meta.json", "means_l.webp"][..]),
        ("garden.zip", &["meta.json", "means_l.webp"]),
        ("empty.sog", &["notes.txt"]),
        ("model.pth", &["archive/data.pkl"]),
        ("notes.npz", &["notes.txt"]),
    ] {
        let mut writer = ZipWriter::new(File::create(path(name)).unwrap());
        for name in contents {
            writer.start_file(*name, SimpleFileOptions::default()).unwrap();
            writer.write_all(b"content").unwrap();
        }
        writer.finish().unwrap();
    }
    for name in ["cut.splat", "new.ksplat"] {
        fs::write(path(name), [0x1F, 0x8B, 0, 0]).unwrap();
    }
    fs::create_dir(path("unpacked")).unwrap();
    fs::write(path("unpacked/meta.json"), "{}").unwrap();
    fs::write(path("unpacked/means_l.webp"), "RIFF").unwrap();
    let table = "meta.json: expected value at line 1 column 1, expected the table of a SOG file";
    for (name, expected) in [
        ("garden.sog", table),
        ("garden.zip", table),
        ("empty.sog", "has no meta.json, expected a SOG file"),
        ("unpacked/meta.json", "is SOG of version 1, expected version 2"),
        ("cut.splat", "has 4 bytes, expected 32 for each of one or more Gaussians"),
        ("new.ksplat", "ends early, expected a whole .ksplat file"),
        ("model.pth", "a checkpoint of PyTorch, which is not read yet, expected the PLY file or params.npz"),
        ("notes.npz", "a ZIP archive without arrays of NumPy, which is not read yet, expected a params.npz"),
    ] {
        let scene = path(name);
        let out = path("out");
        for arguments in [
            &["info", text(&scene)][..],
            &["render", text(&scene), "--out", text(&out)],
            &["compress", text(&scene), "--out", text(&out)],
            &["export", text(&scene), "--to", text(&out)],
            &["eval", text(&scene), "--capture", text(capture())],
        ] {
            let message = fail(2, arguments);
            assert!(message.contains(&format!("{name}: {expected}")), "{message}");
        }
        assert!(!out.exists());
    }
}

#[test]
fn the_output_folder_of_a_training_is_a_scene() {
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    for (iteration, name) in [("7000", "splat_transform.compressed.ply"), ("30000", "original.ply")] {
        let of = path("garden/point_cloud").join(format!("iteration_{iteration}"));
        fs::create_dir_all(&of).unwrap();
        fs::copy(given(name), of.join("point_cloud.ply")).unwrap();
    }
    fs::write(path("garden/input.ply"), "ply\n").unwrap();
    fs::write(path("garden/cfg_args"), "Namespace()").unwrap();
    let whole = info(&given("original.ply")).1;
    for name in ["garden", "garden/point_cloud"] {
        let scene = path(name);
        let output = run(&["info", text(&scene)]);
        let (said, remarks) = (String::from_utf8(output.stdout).unwrap(), String::from_utf8(output.stderr).unwrap());
        let found = text(&scene).to_owned() + ": reading its highest iteration, ";
        assert_eq!(remarks.lines().filter(|line| line.starts_with(&found)).count(), 1, "{remarks}");
        assert!(remarks.contains("iteration_30000") && said.contains("iteration_30000"), "{said}{remarks}");
        assert_eq!(info(&scene).1, whole);
    }
    let lower = path("garden/point_cloud/iteration_7000");
    let output = run(&["info", text(&lower)]);
    assert!(output.status.success() && !String::from_utf8(output.stderr).unwrap().contains("its highest iteration"));

    let garden = path("garden");
    for (arguments, result) in [
        (["render", text(&garden), "--out", text(&path("frames")), "--size", "32x24"], "frames/000000.png"),
        (["export", text(&garden), "--to", text(&path("one.glb")), "--frames", "0..1"], "one.glb"),
        (["compress", text(&garden), "--bits", "6,6", "--format", "2"], "garden.tcgs"),
    ] {
        let output = run(&arguments);
        let remarks = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success() && remarks.contains("reading its highest iteration"), "{remarks}");
        assert!(path(result).exists(), "{result}");
    }
    succeed(&["verify", text(&path("garden.tcgs")), text(&garden)]);
    succeed(&["eval", text(&garden), "--capture", text(capture())]);

    // Frames that are trained separately are not iterations.
    fs::create_dir_all(path("frames_of/frame_0")).unwrap();
    fs::rename(path("garden/point_cloud"), path("frames_of/frame_0/point_cloud")).unwrap();
    let message = fail(2, &["info", text(&path("frames_of"))]);
    assert!(message.contains("a folder without config.toml"), "{message}");
}
