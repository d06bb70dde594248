//! Tables of the paper, on a capture too small to learn from: what is run, kept, written and refused. They need the
//! program `tcgs` beside the laboratory, where `cargo test --workspace` builds it.

// Helpers of tests may unwrap, as tests may.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant, SystemTime};

use serde_json::Value;
use tcgs_capture::SyntheticSettings;
use tempfile::{TempDir, tempdir};

const TRAINING: &str = "--train-args=--frames 0..4 --iterations 30,10 --downscale 1";

/// The laboratory without its arguments.
fn lab() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lab"));
    // LPIPS takes longer than everything else.
    command.env_remove("TCGS_LPIPS_WEIGHTS");
    command
}

fn run(arguments: &[&str]) -> Output {
    lab().args(arguments).output().unwrap()
}

/// Runs a command that must succeed, and returns its standard output.
fn succeed(arguments: &[&str]) -> String {
    let output = run(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {:?}: {message}", output.status);
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a command that must refuse its input, and returns what it said.
fn fail(arguments: &[&str]) -> String {
    let output = run(arguments);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
    message
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// A folder with the capture of one scene of the paper.
fn data() -> TempDir {
    let folder = tempdir().unwrap();
    let settings = SyntheticSettings {
        width: 48,
        height: 36,
        num_train_cameras: 4,
        num_test_cameras: 1,
        num_timesteps: 4,
        num_points: 400,
        seed: 0,
    };
    tcgs_capture::write_synthetic(&folder.path().join("basketball"), &settings).unwrap();
    folder
}

/// Arguments for a table.
fn table<'a>(name: &'a str, data: &'a TempDir, out: &'a Path) -> Vec<&'a str> {
    let (data, out) = (text(data.path()), text(out));
    vec![name, "--data", data, "--out", out, "--scenes", "basketball", "--size", "small", TRAINING]
}

/// Modification times of all results below a folder.
fn results(out: &Path) -> Vec<(PathBuf, SystemTime)> {
    let results = entries(out).into_iter().filter(|path| path.ends_with("result.json"));
    results.map(|path| (path.clone(), fs::metadata(&path).unwrap().modified().unwrap())).collect()
}

#[test]
fn tables_are_made_once_and_only_of_what_was_asked_for() {
    let data = data();
    let folder = tempdir().unwrap();
    let out = folder.path().join("out");
    let ablation = table("ablation", &data, &out);
    let said = succeed(&ablation);
    assert!(said.contains("basketball\n") && said.contains("Dynamic 3DGS") && said.contains("(28.20)"), "{said}");
    for ending in ["txt", "csv", "tex", "json", "html"] {
        assert!(out.join(format!("ablation.{ending}")).is_file(), "{ending}");
    }
    for plot in ["ablation-quality-over-size-basketball.svg", "ablation-psnr-over-time-basketball.svg"] {
        let svg = fs::read_to_string(out.join(plot)).unwrap();
        assert!(svg.starts_with("<svg ") && svg.contains("xmlns=") && svg.trim_end().ends_with("</svg>"), "{plot}");
    }

    // Every number names its producer.
    let json = json(&out.join("ablation.json"));
    let rows = json["blocks"][0]["lines"].as_array().unwrap();
    assert_eq!(rows.len(), 8);
    for row in rows {
        let cell = &row["cells"][0];
        assert!(cell["value"].as_f64().unwrap() > 5.0, "{row}");
        let source = &json["sources"][cell["sources"][0].as_str().unwrap()];
        assert!(!source["commits"][0].as_str().unwrap().is_empty());
        let commands: Vec<&str> = source["commands"].as_array().unwrap().iter().map(|c| c.as_str().unwrap()).collect();
        assert!(commands[0].starts_with("tcgs train ") && commands.last().unwrap().starts_with("tcgs eval "));
    }
    // Masks remove Gaussians, and codes are smaller than floats. With so few timesteps keypoints save nothing.
    let value = |row: usize, column: &str| {
        let head = json["blocks"][0]["head"].as_array().unwrap();
        let at = head.iter().position(|name| name == column).unwrap();
        rows[row]["cells"][at]["value"].as_f64().unwrap()
    };
    assert!(value(2, "storage, MB") < value(1, "storage, MB") && value(1, "storage, MB") < value(0, "storage, MB"));
    assert_eq!(value(2, "Gaussians, k"), value(3, "Gaussians, k"));

    // Finished runs stay; only a missing run is repeated.
    let before = results(&out);
    assert_eq!(before.len(), 8);
    assert_eq!(succeed(&[&ablation[..], &["--print-commands"]].concat()), "");
    assert_eq!(succeed(&ablation), said);
    assert_eq!(results(&out), before);
    let lost = out.join("runs/basketball/tc3dgs/final/result.json");
    fs::remove_file(&lost).unwrap();
    let commands = succeed(&[&ablation[..], &["--print-commands"]].concat());
    assert_eq!(commands.lines().count(), 1);
    assert!(commands.contains("--only basketball/tc3dgs"), "{commands}");
    assert_eq!(first_cells(&succeed(&ablation)), first_cells(&said));
    let after = results(&out);
    let changed: Vec<&PathBuf> = after.iter().zip(&before).filter(|(a, b)| a != b).map(|(a, _)| &a.0).collect();
    assert_eq!(changed, [&lost]);

    // Different arguments are a different experiment.
    let others: Vec<&str> =
        ablation.iter().map(|&a| if a == TRAINING { "--train-args=--frames 0..3" } else { a }).collect();
    let message = fail(&others);
    for part in ["result.json: was made by the arguments", "0..4", "0..3", "choose another --out", "--force"] {
        assert!(message.contains(part), "{message}");
    }
    assert_eq!(results(&out), after);

    // Other tables reuse existing runs.
    for (name, expected) in [
        ("selection", "Algorithm 1"),
        ("polynomials", "degree 1"),
        ("keypoints", "errors and keypoints by limit"),
        ("tolerance", "rotations"),
        ("mask-values", "switched, %"),
        ("pictures", "Dynamic 3DGS"),
    ] {
        let said = succeed(&table(name, &data, &out));
        assert!(said.contains(expected), "{name}: {said}");
        assert!(out.join(format!("{name}.html")).is_file());
    }
    let picture = image::open(out.join("pictures-basketball.png")).unwrap();
    // Ground truth and eight rows, of 48 pixels enlarged seven times.
    assert_eq!((picture.width(), picture.height()), (9 * 336 + 8 * 4, 3 * 252 + 2 * 4));
    let trained = results(&out).iter().filter(|(path, _)| path.ends_with("masked/selection/result.json")).count();
    assert_eq!(trained, 1);

    let anew = [&others[..], &["--force"]].concat();
    succeed(&anew);
    assert!(results(&out).iter().filter(|x| before.iter().any(|b| b.0 == x.0)).all(|x| !before.contains(x)));
    assert_eq!(fs::read_dir(out.join("runs/basketball/ours/train/checkpoints")).unwrap().count(), 3);
}

#[test]
fn what_is_missing_or_wrong_is_named() {
    let data = data();
    let folder = tempdir().unwrap();
    let out = folder.path().join("out");
    let refuse = |arguments: &[&str], expected: &[&str]| {
        let message = fail(arguments);
        for part in expected {
            assert!(message.contains(part), "{arguments:?}: {message}\nexpected: {part}");
        }
    };
    let (data_text, out_text) = (text(data.path()), text(&out));
    let of = |more: &[&'static str]| [&["ablation", "--data", data_text, "--out", out_text], more].concat();
    refuse(&of(&[]), &["has no captures named cook_spinach", "--scenes basketball"]);
    refuse(&of(&["--scenes", "juggle"]), &["has no captures named juggle", "a folder for each"]);
    refuse(&of(&["--scenes", "garden"]), &["has no captures named garden", "--scenes with those that are there"]);
    refuse(&of(&["--scenes", "basketball", "--only", "a/b"]), &["--only a/b: no run", "basketball/tc3dgs"]);
    refuse(&of(&["--size", "tiny"]), &["'tiny'", "full, small"]);
    refuse(&["abblation", "--data", data_text, "--out", out_text], &["abblation: no table", "ablation"]);
    refuse(&["ablation"], &["--data", "--out"]);
    assert!(!out.exists());
    let list = succeed(&["--list"]);
    assert_eq!(list.lines().count(), 14);
    assert!(list.contains("ablation      Contributions of masks"), "{list}");

    // A refused step is reported; the line above has the reason.
    let output = run(&of(&["--scenes", "basketball", "--train-args=--frames 0..99"]));
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("has the frames 0..4, found --frames 0..99"), "{said}");
    assert!(said.lines().last().unwrap().contains("wrong input, see the line above"), "{said}");
    // The refused step leaves no file that would block a correct one.
    let runs: Vec<_> = fs::read_dir(out.join("runs/basketball")).unwrap().map(|run| run.unwrap().path()).collect();
    assert!(!runs.is_empty() && runs.iter().all(|run| !run.join("steps.jsonl").exists()), "{runs:?}");
    refuse(&of(&["--only", "a/b", "--no-run"]), &["cannot be used with"]);
    refuse(&of(&["--scenes", "basketball", "--program", "no/tcgs"]), &["no/tcgs: ", "`cargo build --release` makes"]);
}

#[test]
fn a_killed_command_goes_on_where_it_was() {
    let data = data();
    let folder = tempdir().unwrap();
    let (calm, rough) = (folder.path().join("calm"), folder.path().join("rough"));
    let arguments = |out| [table("ablation", &data, out), vec!["--only", "basketball/tc3dgs"]].concat();
    let begin = Instant::now();
    succeed(&arguments(&calm));
    let duration = begin.elapsed();
    let mut kills = 0;
    for attempt in 0..100 {
        let mut child = lab().args(arguments(&rough)).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        // Kills ever later, so that the run finishes. The first kills are early, since other tests may have slowed down
        // the calm run.
        let end = Instant::now() + duration.mul_f64(0.04 * 1.5_f64.powi(attempt));
        while Instant::now() < end && child.try_wait().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(5));
        }
        if child.try_wait().unwrap().is_some_and(|status| status.success()) {
            break;
        }
        child.kill().unwrap();
        child.wait().unwrap();
        // The kill does not end the child that runs the step; no other process starts the step before the child ends.
        let run = rough.join("runs/basketball/tc3dgs/train");
        while is_locked(&run) {
            std::thread::sleep(Duration::from_millis(5));
        }
        kills += 1;
    }
    assert!(kills >= 2, "only {kills} kills came in time");
    let eval = |out: &Path| json(&out.join("runs/basketball/tc3dgs/final/result.json"))["eval"]["psnr"].clone();
    assert_eq!(eval(&calm), eval(&rough));
}

/// Whether a process is training into a run.
fn is_locked(run: &Path) -> bool {
    fs::File::open(run).is_ok_and(|folder| matches!(folder.try_lock(), Err(fs::TryLockError::WouldBlock)))
}

// The script needs bash.
#[cfg(unix)]
#[test]
fn schedulers_can_run_it() {
    let data = data();
    let folder = tempdir().unwrap();
    let expected = succeed(&table("ablation", &data, &folder.path().join("alone")));

    let slurm = folder.path().join("slurm");
    let commands = succeed(&[&table("ablation", &data, &slurm)[..], &["--print-commands"]].concat());
    assert_eq!(commands.lines().count(), 6);
    let file = folder.path().join("commands.txt");
    fs::write(&file, &commands).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("scripts/slurm.sh");
    let task = |index: usize| {
        let mut command = Command::new("bash");
        command.arg(&script).arg(&file).env("SLURM_ARRAY_TASK_ID", index.to_string()).output().unwrap()
    };
    // Out of order, and one of the commands twice.
    for index in [6, 1, 3, 2, 5, 4, 3] {
        let output = task(index);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    assert_eq!(task(7).status.code(), Some(2));
    let before = results(&slurm);
    assert_eq!(before.len(), 8);
    let said = succeed(&table("ablation", &data, &slurm));
    assert_eq!(results(&slurm), before, "the table is made of what the tasks left");
    assert_eq!(first_cells(&said), first_cells(&expected));

    if Command::new("parallel").arg("--version").output().is_err() {
        // Written past the test harness's capture, so that a skip is visible.
        let _ = std::io::Write::write_all(&mut std::io::stderr(), b"skipped: GNU parallel is not installed\n");
        return;
    }
    let parallel = folder.path().join("parallel");
    let commands = succeed(&[&table("ablation", &data, &parallel)[..], &["--print-commands"]].concat());
    // Each command runs twice at the same time: the second waits and finds the run finished.
    let twice: String = commands.lines().map(|line| format!("{line}\n{line}\n")).collect();
    fs::write(&file, twice).unwrap();
    let status = Command::new("parallel").args(["-j", "4", "-a"]).arg(&file).stderr(Stdio::null()).status().unwrap();
    assert!(status.success(), "{status}");
    assert_eq!(results(&parallel).len(), 8);
    assert_eq!(first_cells(&succeed(&table("ablation", &data, &parallel))), first_cells(&expected));
}

/// Labels and qualities of the first block: cells that do not depend on time.
fn first_cells(text: &str) -> Vec<String> {
    let rows = text.lines().skip(4).take(8);
    rows.map(|line| line.split_whitespace().take(7).collect::<Vec<_>>().join(" ")).collect()
}

#[test]
fn a_table_is_made_anew_by_relative_names() {
    let folder = data();
    fs::create_dir(folder.path().join("data")).unwrap();
    fs::rename(folder.path().join("basketball"), folder.path().join("data/basketball")).unwrap();
    let begin = ["ablation", "--data", "data", "--out", "out", "--scenes", "basketball", "--size", "small"];
    let begin = [&begin[..], &["--only", "basketball/ours"]].concat();
    let run = |more: &[&str]| lab().current_dir(folder.path()).args(&begin).args(more).output().unwrap();
    let is_done = |output: Output| output.status.success();
    assert!(is_done(run(&["--train-args=--frames 0..2 --iterations 3,1 --downscale 1"])));
    let before = entries(folder.path());
    let others = "--train-args=--frames 0..2 --iterations 4,1 --downscale 1";
    let refused = run(&[others]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("--force"));
    assert!(is_done(run(&[others, "--force"])));
    assert_eq!(entries(folder.path()), before);
}

/// All files and folders below a folder.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path.clone());
            }
            found.push(path);
        }
    }
    found.sort();
    found
}

/// The training of a table is a child process: it ends before the laboratory does, and its lock is released.
#[cfg(target_os = "linux")]
#[test]
fn a_signal_to_a_table_ends_its_training() {
    use std::os::unix::process::CommandExt;
    let data = data();
    // In a terminal, Ctrl-C goes to the whole process group.
    for (signal, is_of_group) in [("TERM", false), ("INT", true)] {
        let out = tempdir().unwrap();
        // If this test runs in the background, child processes would ignore SIGINT.
        let mut command = Command::new("env");
        command.args(["--default-signal=INT", env!("CARGO_BIN_EXE_lab"), "ablation"]);
        command.args(["--data", text(data.path()), "--out", text(out.path()), "--scenes", "basketball"]);
        command.args(["--backend", "cpu", "--train-args", "--iterations 100000,1 --frames 0..4"]);
        let mut child = command.process_group(0).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        let run = out.path().join("runs/basketball/d3dgs/train");
        while !run.join("config.toml").exists() {
            assert!(child.try_wait().unwrap().is_none(), "nothing to end");
            std::thread::sleep(Duration::from_millis(5));
        }
        let begin = Instant::now();
        let target = if is_of_group { format!("-{}", child.id()) } else { child.id().to_string() };
        let kill = Command::new("kill").args([&format!("-{signal}"), "--", &target]).status().unwrap();
        assert!(kill.success());
        assert_eq!(child.wait().unwrap().code(), Some(130), "{signal}");
        assert!(begin.elapsed() < Duration::from_secs(5), "{signal}");
        assert!(fs::File::open(&run).unwrap().try_lock().is_ok(), "{signal}: the training goes on");
        assert!(!entries(&run).iter().any(|path| text(path).contains("/.writing-")), "{signal}");
    }
}
