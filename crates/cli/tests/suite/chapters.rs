//! A capture divided into chapters. Each chapter is a run that starts from the state of another scene; all are joined
//! into one file.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::support::*;
use serde_json::Value;
use tempfile::{TempDir, tempdir};

/// A folder with a run `base` of frame 0, shared by all tests and never changed.
fn base() -> &'static Path {
    static BASE: OnceLock<TempDir> = OnceLock::new();
    let folder = BASE.get_or_init(|| {
        let folder = tempdir().unwrap();
        train(&folder, "base", &["--frames", "0..2"]);
        folder
    });
    folder.path()
}

/// Trains a chapter from timestep 0 of `base`.
fn chapter(folder: &TempDir, name: &str, frames: &str, more: &[&str]) -> PathBuf {
    let start = format!("{}@0", text(&base().join("base")));
    train(folder, name, &[&["--frames", frames, "--start-from", &start], more].concat())
}

fn metrics(run: &Path) -> Vec<Value> {
    let text = fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn chapters_are_joined_at_a_border_of_segments() {
    let folder = tempdir().unwrap();
    let (one, two) = (chapter(&folder, "one", "0..3", &[]), chapter(&folder, "two", "1..4", &[]));
    let of_base = metrics(&base().join("base"))[0]["num_gaussians"].clone();
    for (run, frames) in [(&one, 0..3), (&two, 1..4)] {
        let metrics = metrics(run);
        assert!(metrics.iter().zip(frames).all(|(m, frame)| m["frame"] == frame && m["num_gaussians"] == of_base));
        // The chapter has the ten iterations of a later timestep, not the thirty of the first.
        assert_eq!(metrics[0]["loss_curve"].as_array().unwrap().len(), 10);
    }
    let out = |name: &str| folder.path().join(name);
    let compress = |runs: [&Path; 2], name: &str, more: &[&str]| {
        let path = out(name);
        // Not refined, so that the file has the pictures of the floats.
        let fixed = ["compress", text(runs[0]), text(runs[1]), "--out", text(&path), "--refine", "off"];
        succeed(&[&fixed[..], more].concat());
        path
    };
    // With segments of two timesteps, the border after frame 1 is where the chapters are joined.
    let short = compress([&one, &two], "short.tcgs", &["--segment-length", "2"]);
    let other_order = compress([&two, &one], "order.tcgs", &["--segment-length", "2"]);
    assert!(fs::read(&short).unwrap() == fs::read(other_order).unwrap());
    compress([&one, &two], "long.tcgs", &[]);
    for segments in [&["--segment-length", "2"][..], &[]] {
        let declared = compress([&one, &two], "declared.tcgs", &[segments, &["--force"]].concat());
        succeed(&["verify", text(&declared), text(&two), text(&one)]);
    }
    let score = |scene: &Path, frames: &str| {
        let json_file = out("eval.json");
        let capture = text(capture());
        let fixed = ["eval", text(scene), "--capture", capture, "--cameras", "test", "--frames", frames];
        succeed(&[&fixed[..], &["--json", text(&json_file), "--force"]].concat());
        json(&json_file)["psnr"].as_f64().unwrap()
    };
    for (file, joint) in [("short.tcgs", 2), ("long.tcgs", 3)] {
        for frame in 0..4 {
            let frames = format!("{frame}..{}", frame + 1);
            let chapter = if frame < joint { &one } else { &two };
            let (joined, alone) = (score(&out(file), &frames), score(chapter, &frames));
            assert!((joined - alone).abs() < 0.5, "{file}, frame {frame}: {joined} dB, as floats {alone} dB");
        }
    }
}

#[test]
fn a_chapter_resumes_as_any_run() {
    let folder = tempdir().unwrap();
    let calm = chapter(&folder, "calm", "1..4", &[]);
    let broken = chapter(&folder, "broken", "1..2", &[]);
    for end in ["1..3", "1..4"] {
        // Without --start-from the run keeps its own start.
        train(&folder, "broken", &["--frames", end, "--resume"]);
    }
    assert!(checkpoints(&calm) == checkpoints(&broken));
    let run = |name: &str| folder.path().join(name);
    assert_eq!(fs::read(run("calm/config.toml")).unwrap(), fs::read(run("broken/config.toml")).unwrap());
    // As if stopped before the first timestep was finished.
    for name in fs::read_dir(run("broken/checkpoints")).unwrap() {
        fs::remove_file(name.unwrap().path()).unwrap();
    }
    train(&folder, "broken", &["--resume"]);
    assert!(checkpoints(&calm) == checkpoints(&broken));
    // The start state is required, and cannot be replaced by another.
    let again = ["train", text(capture()), "--out", text(&broken), "--iterations", "30,10", "--resume"];
    let other = format!("{}@1", text(&base().join("base")));
    assert!(fail(2, &[&again[..], &["--start-from", &other]].concat()).contains("data.start_from differs"));
    fs::write(run("broken/start.npz"), b"PK").unwrap();
    assert!(fail(2, &again).contains("start.npz: not a checkpoint"));
    train(&folder, "broken", &["--force", "--frames", "0..1"]);
    assert!(!run("broken/start.npz").exists());
}

#[test]
fn a_chapter_starts_from_any_scene() {
    let folder = tempdir().unwrap();
    let base = base().join("base");
    let path = |name: &str| folder.path().join(name);
    let [file, params, plys] = ["scene.tcgs", "params.npz", "plys"].map(path);
    succeed(&["compress", text(&base), "--out", text(&file)]);
    succeed(&["export", text(&base), "--to", text(&params)]);
    succeed(&["export", text(&base), "--to", text(&plys)]);
    for (index, scene) in [&base, &file, &params, &plys].into_iter().enumerate() {
        let name = format!("from{index}");
        let run = train(&folder, &name, &["--frames", "2..3", "--start-from", text(scene)]);
        let found = metrics(&run);
        assert_eq!(found.len(), 1);
        // The start state already has frame 1, so PSNR is far above that of thirty iterations from points.
        let psnr = found[0]["psnr"].as_f64().unwrap();
        let before = metrics(&base)[1]["psnr"].as_f64().unwrap();
        assert!(psnr > before - 1.0, "from {}: {psnr} dB after {before} dB", scene.display());
    }
}

#[test]
fn what_cannot_be_joined_or_continued_is_said_in_one_line() {
    let folder = tempdir().unwrap();
    let one = chapter(&folder, "one", "0..2", &[]);
    let far = chapter(&folder, "far", "3..4", &[]);
    let within = chapter(&folder, "within", "0..1", &[]);
    let other = train(&folder, "other", &["--frames", "1..4", "--seed", "5"]);
    let out = folder.path().join("scene.tcgs");
    let refuse = |runs: &[&Path], expected: &[&str]| {
        let runs: Vec<&str> = runs.iter().map(|run| text(run)).collect();
        let message = fail(2, &[&["compress"], &runs[..], &["--out", text(&out)]].concat());
        assert!(expected.iter().all(|part| message.contains(part)), "{message}");
    };
    refuse(&[&one, &far], &["far: begins at frame 3", "expected frame 2 or an earlier one, where", "one ends"]);
    refuse(&[&one, &within], &["within: ends with frame 0"]);
    refuse(
        &[&one, &other],
        &["other: has ", "in the same order", "the same Gaussians at all timesteps", "--start-from"],
    );
    refuse(&[&one, capture()], &["expected a .tcgs file, a run folder"]);
    assert!(fail(2, &["compress", text(&one), text(&far)]).contains("expected --out"));

    let start = |start: &str| {
        let new = folder.path().join("new");
        fail(2, &["train", text(capture()), "--out", text(&new), "--frames", "1..2", "--start-from", start])
    };
    assert!(start("nowhere").contains("--start-from nowhere: no such scene"));
    assert!(start(&format!("{}@9", text(&one))).contains("one: no timestep 9, expected one below 2"));
    assert!(start(text(capture())).contains("expected"));
}
