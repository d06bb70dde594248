//! Refusals of the command: exit code 2, one line that names the culprit, and no change to any file.

use std::fs;
use std::io::Write;
use std::path::Path;

use crate::support::*;
use tcgs_render::gpu::{Gpu, GpuChoice};
use tempfile::tempdir;

/// Runs a command that must exit with 2 and print all of `expected`.
fn refuse(arguments: &[&str], expected: &[&str]) {
    let message = fail(2, arguments);
    for part in expected {
        assert!(message.contains(part), "{arguments:?}: {message}\nexpected: {part}");
    }
}

#[test]
fn wrong_usage_is_one_line() {
    let capture = text(capture());
    refuse(&["fly"], &["unrecognized subcommand 'fly'", "try '--help'"]);
    refuse(&["train", capture], &["--out <RUN>", "Usage: tcgs train"]);
    refuse(&["train", capture, "--out", "r", "--frames", "3..1"], &["'3..1'", "expected A..B with A below B"]);
    refuse(&["train", capture, "--out", "r", "--bits", "8,4"], &["'8,4'", "1 <= MIN <= MAX <= 16"]);
    refuse(&["train", capture, "--out", "r", "--iterations", "0,1"], &["FIRST,REST"]);
    refuse(&["train", capture, "--out", "r", "--threads", "0"], &["'0'", "a whole number from 1 to 1024"]);
    refuse(&["train", capture, "--out", "r", "--preset", "best"], &["'best'", "d3dgs, paper, default, fast"]);
    refuse(&["compress", "x", "--prune", "2"], &["'2'", "0 to 1"]);
    refuse(&["compress", "x", "--prune", "-1"], &["'-1'", "0 to 1"]);
    refuse(&["compress", "x", "--max-keypoints", "1"], &["2..=65536"]);
    refuse(&["compress", "x", "--max-mse", "nan"], &["0 or more"]);
    refuse(&["compress", "x", "--no-keypoints", "--max-mse", "1"], &["cannot be used with"]);
    refuse(&["compress", "x", "--target-bytes", "2TB"], &["'2TB'", "500000, 500k, 2MB"]);
    refuse(&["compress", "x", "--target-psnr", "nan"], &["'nan'", "0 to 100"]);
    refuse(&["compress", "x", "--target-psnr", "30", "--target-bytes", "9k"], &["cannot be used with"]);
    refuse(&["compress", "x", "--target-psnr", "30", "--bits", "4,8"], &["cannot be used with"]);
    refuse(&["compress", "x", "--target-psnr", "30", "--cameras", "all"], &["--capture"]);
    refuse(&["compress", "x", "--frames", "0..2"], &["--target-bytes", "--target-psnr"]);
    refuse(&["compress", "x", "--quality", "9"], &["'9'", "-6 to 8"]);
    refuse(&["compress", "x", "--quality", "1", "--preset", "paper"], &["--preset paper", "expected --preset default"]);
    refuse(&["compress", "x", "--up", "w"], &["'w'", "-x, -y or -z"]);
    refuse(&["render", "x", "--out", "d", "--size", "0x4"], &["WIDTHxHEIGHT"]);
    refuse(&["bench", "--size", "64x48,4"], &["'4'", "WIDTHxHEIGHT"]);
    refuse(&["bench", "--gaussians", "0"], &["'0'", "a whole number from 1 to 100000000"]);
    refuse(&["bench", "--capture", capture, "--gaussians", "9"], &["cannot be used with"]);
    refuse(&["bench", "--downscale", "2"], &["--capture <CAPTURE>"]);
    refuse(&["bench", "--capture", "nowhere"], &["nowhere", "no such folder", "train_meta.json"]);
    refuse(&["bench", "--backend", "cpu", "--capture", capture, "--downscale", "99"], &["48x36", "99"]);
    assert!(!Path::new("r").exists());
    let help = succeed(&["train", "--help"]);
    assert!(help.contains("Example:") && help.contains("--resume"), "{help}");
}

#[test]
fn what_does_not_exist_yet_says_so() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &[]);
    let out = folder.path().join("out");
    refuse(&["render", text(&run), "--out", "clip.mov"], &["clip.mov", "expected .mp4, .webm"]);
    refuse(&["render", text(&run), "--out", text(&out), "--cameras", "t/transforms.json"], &["transforms.json"]);
    refuse(&["export", text(&run), "--to", "a.gltf"], &["a.gltf", "expected NAME.npz, NAME.ply"]);
    assert!(!out.exists());
}

#[test]
fn what_cannot_compute_is_named() {
    let folder = tempdir().unwrap();
    let (capture, out) = (text(capture()), folder.path().join("out"));
    let train = ["train", capture, "--out", text(&out), "--iterations", "30,10"];
    let render = ["render", "x.tcgs", "--out", text(&out)];
    let eval = ["eval", "x.tcgs", "--capture", capture];
    let demo = ["demo", "--out", text(&out)];
    for command in [&train[..], &render, &eval, &demo, &["bench"]] {
        let with = |more: &[&'static str]| [command, more].concat();
        refuse(&with(&["--device", "Voodoo 2"]), &["--device Voodoo 2: no GPU named Voodoo 2, found "]);
        refuse(&with(&["--backend", "cpu", "--device", "Voodoo 2"]), &["--device Voodoo 2", "found --backend cpu"]);
        refuse(&with(&["--backend", "abacus"]), &["'abacus'", "auto, gpu, cpu"]);
    }
    assert!(!out.exists());

    let Err(missing) = Gpu::open(GpuChoice::Hardware) else {
        // Written past the test harness's capture, so that a skip is visible.
        let _ = writeln!(std::io::stderr(), "skipped: how a computer without a GPU is told of, this one has one");
        return;
    };
    let message = fail(1, &[&train[..], &["--backend", "gpu"]].concat());
    let expected = format!("tcgs: --backend gpu: {missing}, expected --device NAME or --backend cpu");
    assert_eq!(message, expected);
    assert!(!out.exists());
    let note = |more: &[&str]| {
        let output = run(&[&train[..], &["--threads", "2", "--force"], more].concat());
        assert!(output.status.success(), "{output:?}");
        let said = String::from_utf8(output.stderr).unwrap();
        let (device, rest) = said.split_once('\n').unwrap();
        assert!(rest.starts_with("warning: 400 points to start from") && rest.lines().count() == 1, "{rest}");
        device.to_owned()
    };
    assert_eq!(note(&["--backend", "cpu"]), "computing on the CPU, 2 threads");
    assert_eq!(note(&[]), format!("computing on the CPU, 2 threads: {missing}"));
}

#[test]
fn settings_and_frames_that_do_not_fit_are_named() {
    let folder = tempdir().unwrap();
    let (capture, out) = (text(capture()), folder.path().join("run"));
    let train = |more: &[&str], expected: &[&str]| {
        refuse(&[&["train", capture, "--out", text(&out)], more].concat(), expected);
        assert!(!out.exists(), "{more:?}");
    };
    train(&["--set", "weights.rigit=1"], &["unknown setting weights.rigit", "weights.rigid"]);
    train(&["--set", "seed=many"], &["seed", "many", "integer"]);
    train(&["--set", "seed"], &["KEY=VALUE"]);
    train(&["--set", "data.capture=/x"], &["data.capture", "CAPTURE"]);
    train(&["--frames", "2..9"], &["has the frames 0..4", "2..9"]);
    train(&["--downscale", "100"], &["48x36", "100", "expected 1 to 36"]);
    train(&["--config", "nowhere.toml"], &["nowhere.toml", "config.toml"]);
    let file = folder.path().join("settings.toml");
    fs::write(&file, "[densify]\nstop = 3\n").unwrap();
    train(&["--config", text(&file)], &["settings.toml", "unknown setting densify.stop", "densify.start"]);
    refuse(&["train", "nowhere", "--out", text(&out)], &["nowhere", "no such folder", "train_meta.json"]);
    refuse(&["train", capture, "--out", text(&file)], &["settings.toml", "is a file"]);
    refuse(&["train", capture, "--out", text(folder.path())], &["other things in it"]);
    refuse(&["train", capture, "--out", text(&out), "--json", "no/where.json"], &["no: no such folder"]);
    assert!(!out.exists());
}

#[test]
fn scenes_and_captures_that_do_not_fit_are_named() {
    let folder = tempdir().unwrap();
    let (capture, run) = (text(capture()), train(&folder, "run", &["--frames", "1..3"]));
    let path = |name: &str| folder.path().join(name);
    refuse(&["eval", text(&run), "--capture", "nowhere"], &["nowhere", "no such folder"]);
    refuse(&["eval", text(&run), "--capture", capture, "--frames", "1..4"], &["--frames 1..4", "1..3"]);
    refuse(&["eval", text(&run), "--capture", capture, "--protocol", "psnr"], &["'psnr'", "tc3dgs, 4dgs, stg"]);
    let weights = ["eval", text(&run), "--capture", capture, "--lpips-weights"];
    refuse(&[&weights[..], &["nowhere"]].concat(), &["nowhere", "expected LPIPS weights"]);
    let config = run.join("config.toml");
    refuse(&[&weights[..], &[text(&config)]].concat(), &["config.toml: not safetensors", "expected LPIPS weights"]);
    refuse(&["render", text(&run), "--out", text(&path("f")), "--frames", "0..2"], &["--frames 0..2", "1..3"]);
    refuse(&["eval", "nowhere.tcgs", "--capture", capture], &["nowhere.tcgs", "expected a .tcgs file"]);
    refuse(
        &["eval", capture, "--capture", capture],
        &["without config.toml and without PLY, SPZ, glTF or SOG files", "expected a .tcgs file"],
    );
    fs::write(path("a.txt"), "hello").unwrap();
    refuse(&["render", text(&path("a.txt")), "--out", text(&path("f"))], &["a.txt", "another kind"]);
    refuse(&["info", text(&path("a.txt"))], &["a.txt", "another kind"]);
    refuse(&["info", "nowhere.tcgs"], &["nowhere.tcgs", "expected a .tcgs file, a run folder"]);

    let params = path("params.npz");
    succeed(&["export", text(&run), "--to", text(&params)]);
    refuse(&["compress", text(&params), "--prune", "0.1"], &["params.npz", "no masks"]);
    let whole = fs::read(&params).unwrap();
    for share in [0, 1, 3, 9] {
        fs::write(&params, &whole[..whole.len() * share / 10]).unwrap();
        refuse(&["compress", text(&params)], &["params.npz", "expected"]);
        refuse(&["eval", text(&params), "--capture", capture], &["params.npz", "expected"]);
    }
    assert!(!path("params.tcgs").exists() && !path("f").exists());
    succeed(&["compress", text(&run)]);
    refuse(&["compress", text(&run.join("scene.tcgs")), "--out", text(&path("b.tcgs"))], &["compressed already"]);

    let empty = path("empty");
    fs::create_dir(&empty).unwrap();
    fs::copy(run.join("config.toml"), empty.join("config.toml")).unwrap();
    refuse(&["compress", text(&empty)], &["empty", "no checkpoint"]);
    let maskless = train(&folder, "maskless", &["--no-mask"]);
    refuse(&["compress", text(&maskless), "--prune", "0.1"], &["maskless", "without masks"]);
}

#[test]
fn a_capture_without_test_cameras_is_judged_by_its_training_cameras() {
    let folder = tempdir().unwrap();
    let capture = folder.path().join("capture");
    let settings = tcgs_capture::SyntheticSettings { num_test_cameras: 0, num_timesteps: 1, ..SETTINGS };
    tcgs_capture::write_synthetic(&capture, &settings).unwrap();
    let run = folder.path().join("run");
    let said = succeed(&["train", text(&capture), "--out", text(&run), "--iterations", "20,10"]);
    assert!(said.contains("train PSNR"), "{said}");
    refuse(&["eval", text(&run), "--capture", text(&capture)], &["capture", "no test cameras", "--cameras train"]);
    succeed(&["eval", text(&run), "--capture", text(&capture), "--cameras", "train"]);
    let frames = folder.path().join("frames");
    succeed(&["render", text(&run), "--out", text(&frames), "--cameras", text(&capture)]);
    assert_eq!(fs::read_dir(&frames).unwrap().count(), 4);
}

#[test]
fn damaged_files_are_refused_by_section() {
    let folder = tempdir().unwrap();
    let run = train(&folder, "run", &["--frames", "0..2"]);
    succeed(&["compress", text(&run)]);
    let file = run.join("scene.tcgs");
    let whole = fs::read(&file).unwrap();
    let result = folder.path().join("info.json");
    for at in (0..whole.len()).step_by(whole.len() / 20) {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x20;
        fs::write(&file, damaged).unwrap();
        refuse(&["info", text(&file), "--json", text(&result), "--force"], &["scene.tcgs", "expected a whole"]);
        refuse(&["eval", text(&file), "--capture", text(capture())], &["scene.tcgs", "expected a whole .tcgs file"]);
    }
    let info = json(&result);
    assert_eq!((&info["checksums_ok"], info["num_gaussians"].is_null()), (&false.into(), true));
    refuse(&["info", text(&file)], &["the checksum of ", " is wrong"]);
    for length in (0..whole.len()).step_by(whole.len() / 20) {
        fs::write(&file, &whole[..length]).unwrap();
        refuse(&["info", text(&file)], &["scene.tcgs", "expected a whole .tcgs file"]);
    }
}

#[test]
fn nothing_is_overwritten_without_force() {
    let folder = tempdir().unwrap();
    let capture = text(capture());
    let run = train(&folder, "run", &["--frames", "0..2"]);
    let keep = |path: &Path, arguments: &[&str]| {
        fs::write(path, b"precious").unwrap();
        refuse(arguments, &[path.file_name().unwrap().to_str().unwrap(), "exists already", "--force"]);
        assert_eq!(fs::read(path).unwrap(), b"precious");
        succeed(&[arguments, &["--force"]].concat());
        assert_ne!(fs::read(path).unwrap(), b"precious");
    };
    let path = |name: &str| folder.path().join(name);
    keep(&run.join("scene.tcgs"), &["compress", text(&run)]);
    keep(&path("a.tcgs"), &["compress", text(&run), "--out", text(&path("a.tcgs"))]);
    keep(&path("b.json"), &["eval", text(&run), "--capture", capture, "--json", text(&path("b.json"))]);
    keep(&path("c.csv"), &["eval", text(&run), "--capture", capture, "--csv", text(&path("c.csv"))]);
    keep(&path("d.json"), &["info", text(&path("a.tcgs")), "--json", text(&path("d.json"))]);
    keep(&path("e.npz"), &["export", text(&run), "--to", text(&path("e.npz"))]);
    keep(&path("f.ply"), &["export", text(&run), "--frames", "1..2", "--to", text(&path("f.ply"))]);

    let frames = path("frames");
    let render = ["render", text(&run), "--out", text(&frames), "--size", "16x9"];
    succeed(&render);
    refuse(&render, &["frames", "exists already", "--force"]);
    succeed(&[&render[..], &["--force"]].concat());
    fs::write(frames.join("diary.txt"), b"precious").unwrap();
    refuse(&[&render[..], &["--force"]].concat(), &["diary.txt", "not written by this command"]);

    let again = ["train", capture, "--out", text(&run), "--iterations", "30,10", "--frames", "0..1"];
    let before = checkpoints(&run);
    refuse(&again, &["run", "--resume", "--force"]);
    assert!(before == checkpoints(&run));
    let shorter = ["train", capture, "--out", text(&run), "--resume", "--frames", "0..1"];
    let config = fs::read(run.join("config.toml")).unwrap();
    refuse(&shorter, &["run: has trained the frames 0..2", "found 0..1", "no earlier end"]);
    assert!(before == checkpoints(&run) && config == fs::read(run.join("config.toml")).unwrap());
    fs::write(run.join("notes.txt"), b"precious").unwrap();
    // A wrong input is found before anything is replaced.
    refuse(&["train", "nowhere", "--out", text(&run), "--force"], &["nowhere"]);
    assert!(before == checkpoints(&run));
    succeed(&[&again[..], &["--force"]].concat());
    assert!(before[..1] == checkpoints(&run)[..], "the same settings, one timestep");
    assert!(run.join("notes.txt").exists() && !run.join("scene.tcgs").exists());
}
