//! Faults outside a command: full disks, signals, illegal outputs, other processes. Each ends in one line that begins
//! with `tcgs:`, and leaves nothing behind.

use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use crate::support::*;
use tempfile::{TempDir, tempdir};

/// A run and its file, which the tests only read: `run` and `scene.tcgs`.
fn trained() -> &'static Path {
    static FOLDER: OnceLock<TempDir> = OnceLock::new();
    let make = || {
        let folder = tempdir().unwrap();
        let run = train(&folder, "run", &["--backend", "cpu"]);
        succeed(&["compress", text(&run), "--out", text(&folder.path().join("scene.tcgs"))]);
        folder
    };
    FOLDER.get_or_init(make).path()
}

/// Content of every file below a folder, by relative name; folders have no content.
fn contents(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(path) = open.pop() {
        for entry in fs::read_dir(&path).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(folder).unwrap().to_path_buf();
            match path.symlink_metadata().unwrap() {
                kind if kind.is_dir() => {
                    found.insert(name, Vec::new());
                    open.push(path);
                }
                kind if kind.is_symlink() => drop(found.insert(name, b"link".to_vec())),
                _ => drop(found.insert(name, fs::read(&path).unwrap())),
            }
        }
    }
    found
}

/// The last line that a command prints; progress lines precede it.
fn last_line(output: &Output) -> String {
    let message = String::from_utf8(output.stderr.clone()).unwrap();
    let is_remark = |line: &&str| {
        let remarks = ["computing on ", "warning: ", "preparing ", "training ", "measuring LPIPS", "ending cleanly"];
        remarks.iter().any(|remark| line.starts_with(remark))
    };
    let lines: Vec<&str> = message.lines().filter(|line| !is_remark(line)).collect();
    let [line] = lines[..] else { panic!("expected one line, found {message}") };
    assert!(line.starts_with("tcgs: "), "{line}");
    line.into()
}

/// Runs a command that must fail with a line that contains `expected`, and must change nothing in a folder.
fn refuse(folder: &Path, arguments: &[&str], expected: &str) {
    let before = contents(folder);
    let output = tcgs().current_dir(folder).args(arguments).output().unwrap();
    let line = last_line(&output);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {line}");
    assert!(line.contains(expected), "{arguments:?}: {line}\nexpected: {expected}");
    assert!(contents(folder) == before, "{arguments:?} changed something");
}

/// Commands whose output has more than a kilobyte: the arguments without the output, and a name for the output.
fn writers() -> Vec<(Vec<&'static str>, &'static str)> {
    let file = |name: &str| -> &'static str { Box::leak(text(&trained().join(name)).to_owned().into_boxed_str()) };
    let (run, scene, capture) = (file("run"), file("scene.tcgs"), text(capture()));
    let cpu = ["--backend", "cpu"];
    let mut all = vec![
        (vec!["compress", run, "--out"], "new.tcgs"),
        (vec!["export", run, "--to"], "plys"),
        (vec!["export", run, "--to"], "new.npz"),
        (vec!["export", run, "--to"], "new.f32"),
        (vec!["export", run, "--frames", "0..1", "--to"], "new.glb"),
        ([&["render", scene], &cpu[..], &["--out"]].concat(), "frames"),
        (["eval", scene, "--capture", capture, "--cameras", "all", "--backend", "cpu", "--csv"].into(), "new.csv"),
        (vec!["info", scene, "--json"], "new.json"),
        (vec!["prepare", capture, "--points", "500", "--points-only"], "points.npz"),
        (vec!["prepare", capture, "--points", "500", "--out"], "capture"),
        (vec!["prepare", "--check", capture, "--page"], "page.html"),
        (
            vec![
                "bench",
                "--gaussians",
                "200",
                "--size",
                "64x48",
                "--iterations",
                "1",
                "--backend",
                "cpu",
                "--write-scene",
            ],
            "bench",
        ),
    ];
    if Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).status().is_ok_and(|status| status.success()) {
        all.push(([&["render", scene], &cpu[..], &["--size", "640x480", "--out"]].concat(), "new.mp4"));
    }
    all
}

/// `ulimit -f` sends a signal that would end the process; the write must fail instead, as on a full disk.
#[test]
fn a_write_that_fails_is_told_in_one_line() {
    let folder = tempdir().unwrap();
    let limited = |arguments: &[&str]| {
        let program = ["-c", "ulimit -f 1; exec \"$@\"", "bash", env!("CARGO_BIN_EXE_tcgs")];
        Command::new("bash").args(program).args(arguments).current_dir(folder.path()).output().unwrap()
    };
    for (arguments, name) in writers() {
        // The capture's images are linked, not written.
        if name == "capture" {
            continue;
        }
        let output = limited(&[&arguments[..], &[name]].concat());
        let line = last_line(&output);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {line}");
        assert!(line.contains(name) && line.contains("too large"), "{arguments:?}: {line}");
        assert!(!line.contains(".writing-"), "a name that is gone by then: {line}");
        assert!(contents(folder.path()).is_empty(), "{arguments:?} left {:?}", contents(folder.path()).keys());
    }
    let output = limited(&["train", text(capture()), "--out", "a/run", "--iterations", "3,1", "--backend", "cpu"]);
    assert!(last_line(&output).contains("a/run/config.toml: File too large"), "{output:?}");
    assert!(contents(folder.path()).is_empty(), "a run that did not begin left {:?}", contents(folder.path()).keys());
}

#[test]
fn a_device_that_is_full_is_named() {
    let scene = trained().join("scene.tcgs");
    let output = run(&["info", text(&scene), "--json", "/dev/full"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(last_line(&output).contains("writing /dev/full: No space left"));
    for arguments in [&["info", text(&scene)][..], &["info", text(&scene), "--data", "tcgs.views"]] {
        let full = fs::File::options().write(true).open("/dev/full").unwrap();
        let output = tcgs().args(arguments).stdout(full).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments:?}");
        assert!(last_line(&output).contains("standard output: No space left"), "{arguments:?}");
    }
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let scene = trained().join("scene.tcgs");
    for arguments in [&["info", text(&scene)][..], &["info", text(&scene), "--data", "tcgs.views"], &["--help"]] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let output = tcgs().args(arguments).stdout(writer).output().unwrap();
        assert!(output.status.success() && output.stderr.is_empty(), "{arguments:?}: {output:?}");
        let closed = ["-c", "exec \"$@\" >&- 2>&-", "bash", env!("CARGO_BIN_EXE_tcgs")];
        assert!(Command::new("bash").args(closed).args(arguments).status().unwrap().success(), "{arguments:?}");
    }
}

fn send(signal: &str, child: &std::process::Child) {
    assert!(Command::new("kill").args([format!("-{signal}"), child.id().to_string()]).status().unwrap().success());
}

/// Starts a command and waits until it has begun to write into a folder.
fn begun(folder: &Path, arguments: &[&str]) -> std::process::Child {
    let mut command = tcgs();
    command.current_dir(folder).args(arguments).stdout(Stdio::null()).stderr(Stdio::piped());
    // These tests may run under `nohup` themselves.
    // SAFETY: the action is not a function.
    unsafe {
        command.pre_exec(|| {
            libc::signal(libc::SIGHUP, libc::SIG_DFL);
            Ok(())
        })
    };
    let mut child = command.spawn().unwrap();
    let end = Instant::now() + Duration::from_secs(60);
    while fs::read_dir(folder).unwrap().next().is_none() {
        assert!(child.try_wait().unwrap().is_none() && Instant::now() < end, "{arguments:?} did not begin");
        std::thread::sleep(Duration::from_millis(1));
    }
    child
}

#[test]
fn signals_end_commands_and_leave_nothing() {
    let scene = trained().join("scene.tcgs");
    let render: Vec<&str> = vec!["render", text(&scene), "--size", "4000x3000", "--backend", "cpu", "--out"];
    let mut commands = vec![
        ([&render[..], &["frames"]].concat(), "frames"),
        (vec!["prepare", text(capture()), "--out", "capture"], "capture"),
        (vec!["demo", "--out", "demo"], "demo"),
    ];
    if writers().iter().any(|(_, name)| name.ends_with(".mp4")) {
        commands.push(([&render[..], &["clip.mp4"]].concat(), "clip.mp4"));
    }
    for (arguments, name) in commands {
        // The second of two signals ends the process before the work has noticed the first.
        for signals in [&["TERM"][..], &["HUP"], &["INT", "INT"]] {
            let folder = tempdir().unwrap();
            let child = begun(folder.path(), &arguments);
            for signal in signals {
                send(signal, &child);
                std::thread::sleep(Duration::from_millis(20));
            }
            let output = child.wait_with_output().unwrap();
            assert_eq!(output.status.code(), Some(130), "{arguments:?} {signals:?}: {output:?}");
            assert!(last_line(&output).starts_with("tcgs: stopped"), "{output:?}");
            assert!(!folder.path().join(name).exists());
            assert!(
                contents(folder.path()).is_empty(),
                "{arguments:?} {signals:?}: {:?}",
                contents(folder.path()).keys()
            );
        }
    }
}

#[test]
fn a_training_ends_after_its_step_by_any_signal_but_not_under_nohup() {
    let folder = tempdir().unwrap();
    for signal in ["TERM", "HUP"] {
        let place = folder.path().join(signal);
        fs::create_dir(&place).unwrap();
        let child =
            begun(&place, &["train", text(capture()), "--out", "run", "--iterations", "100000,1", "--backend", "cpu"]);
        while !place.join("run/config.toml").exists() {
            std::thread::sleep(Duration::from_millis(1));
        }
        send(signal, &child);
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(130), "{output:?}");
        assert_eq!(last_line(&output), "tcgs: stopped: 0 of 4 timesteps are trained; --resume goes on after them");
    }
    let run = folder.path().join("run");
    let program = ["-c", "trap '' HUP; exec \"$@\"", "bash", env!("CARGO_BIN_EXE_tcgs"), "train", text(capture())];
    let mut command = Command::new("bash");
    command
        .args(program)
        .args(["--out", text(&run), "--iterations", "60,10", "--backend", "cpu"])
        .stdout(Stdio::null());
    let mut child = command.spawn().unwrap();
    while !run.join("config.toml").exists() {
        std::thread::sleep(Duration::from_millis(1));
    }
    send("HUP", &child);
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_source_is_never_replaced() {
    let folder = tempdir().unwrap();
    let path = folder.path();
    tcgs_capture::write_synthetic(&path.join("capture"), &SETTINGS).unwrap();
    fs::copy(trained().join("scene.tcgs"), path.join("scene.tcgs")).unwrap();
    symlink("scene.tcgs", path.join("link.tcgs")).unwrap();
    fs::hard_link(path.join("scene.tcgs"), path.join("hard.tcgs")).unwrap();
    succeed(&["export", text(&path.join("scene.tcgs")), "--to", text(&path.join("plys"))]);
    succeed(&[
        "train",
        text(&path.join("capture")),
        "--out",
        text(&path.join("run")),
        "--iterations",
        "3,1",
        "--frames",
        "0..1",
        "--backend",
        "cpu",
    ]);
    let source = "is what this command reads";
    for json in ["scene.tcgs", "./scene.tcgs", "link.tcgs", "hard.tcgs", "plys/../scene.tcgs"] {
        refuse(path, &["info", "scene.tcgs", "--force", "--json", json], source);
    }
    refuse(path, &["info", "link.tcgs", "--force", "--json", "scene.tcgs"], source);
    refuse(path, &["verify", "scene.tcgs", "plys", "--force", "--json", "scene.tcgs"], source);
    refuse(path, &["compress", "plys/000000.ply", "--force", "--out", "plys/000000.ply"], source);
    refuse(path, &["export", "scene.tcgs", "--force", "--to", "scene.tcgs"], "not a kind of file");
    refuse(path, &["export", "plys/000000.ply", "--force", "--to", "plys/000000.ply"], source);
    refuse(path, &["export", "plys", "--force", "--to", "plys"], source);
    refuse(path, &["render", "scene.tcgs", "--force", "--out", "scene.tcgs"], source);
    refuse(path, &["eval", "scene.tcgs", "--capture", "capture", "--force", "--csv", "scene.tcgs"], source);
    refuse(path, &["prepare", "capture", "--force", "--out", "capture"], source);
    let part = "is a part of";
    refuse(path, &["compress", "run", "--force", "--out", "run/config.toml"], part);
    refuse(path, &["compress", "run", "--force", "--out", "run/checkpoints/000000.npz"], part);
    refuse(path, &["export", "plys", "--force", "--frames", "0..1", "--to", "plys/000001.ply"], part);
    refuse(path, &["eval", "scene.tcgs", "--capture", "capture", "--force", "--json", "capture/train_meta.json"], part);
    refuse(path, &["train", "capture", "--out", "run", "--force", "--start-from", "run@0"], source);
    let twice = "is to be written twice";
    refuse(path, &["compress", "run", "--out", "new.tcgs", "--json", "./new.tcgs"], twice);
    refuse(path, &["eval", "scene.tcgs", "--capture", "capture", "--csv", "a", "--json", "a"], twice);
    // Results beside the files of a run are not part of it.
    for _ in 0..2 {
        let run = text(&path.join("run")).to_owned();
        succeed(&["compress", &run, "--json", &format!("{run}/compress.json"), "--force"]);
    }
}

#[test]
fn what_cannot_be_written_is_refused_before_the_work() {
    let folder = tempdir().unwrap();
    let path = folder.path();
    for (arguments, name) in writers() {
        fs::create_dir_all(path.join("folder")).unwrap();
        let ending =
            Path::new(name).extension().map_or(String::new(), |ending| format!(".{}", text(Path::new(ending))));
        let (link, taken) = (format!("link{ending}"), format!("taken{ending}"));
        let _ = symlink("no/such/place", path.join(&link));
        refuse(path, &[&arguments[..], &[&link]].concat(), "does not exist");
        let parent = format!("no/such/{name}");
        refuse(path, &[&arguments[..], &[&parent]].concat(), "no such folder");
        fs::create_dir_all(path.join(&taken)).unwrap();
        fs::write(path.join(&taken).join("x"), "").unwrap();
        let expected = if ending.is_empty() { "" } else { "folder" };
        refuse(path, &[&arguments[..], &[&taken, "--force"]].concat(), expected);
        let long = format!("{}{ending}", "x".repeat(300));
        refuse(path, &[&arguments[..], &[&long]].concat(), "too long");
    }
    for json in ["link", "folder", "folder/", "no/such.json"] {
        let _ = symlink("nothing", path.join("link"));
        refuse(path, &["info", text(&trained().join("scene.tcgs")), "--json", json], "expected");
    }
    refuse(path, &["train", text(capture()), "--out", "link"], "a link to a folder that does not exist");
    refuse(path, &["demo", "--out", "link"], "does not exist");
}

#[test]
fn the_folders_of_strangers_stay_as_they_are() {
    let folder = tempdir().unwrap();
    let path = folder.path();
    let train = ["train", text(capture()), "--force", "--iterations", "3,1", "--backend", "cpu", "--out"];
    let write = |name: &str, text: &str| {
        fs::create_dir_all(path.join(name).parent().unwrap()).unwrap();
        fs::write(path.join(name), text).unwrap();
    };
    write("start/start.npz", "another program's");
    write("trained/config.toml", "model = 'resnet'\n");
    write("trained/checkpoints/000001.npz", "weights");
    write("trained/metrics.jsonl", "{}");
    write("empty/config.toml", "");
    write("empty/scene.tcgs", "mine");
    write("marked/.tcgs-demo", "notes on the demo");
    write("marked/run/config.toml", "");
    write("prepared/prepare.json", "[]");
    write("prepared/diary.txt", "mine");
    // A run that is killed at its beginning does not change its start scene.
    let start = trained().join("run@0").to_str().unwrap().to_owned();
    let chapter = ["--start-from", &start, "--frames", "0..1", "--out", "chapter"];
    let chapter = [&train[..2], &["--iterations", "3,1", "--backend", "cpu"], &chapter].concat();
    for _ in 0..2 {
        assert!(tcgs().current_dir(path).args(&chapter).status().unwrap().success());
        let names = ["config.toml", "metrics.jsonl", "resume0.npz", "checkpoints/000000.npz"];
        names.iter().for_each(|name| fs::remove_file(path.join("chapter").join(name)).unwrap());
        assert!(path.join("chapter/start.npz").is_file());
    }
    for name in ["start", "trained", "empty", "marked"] {
        refuse(path, &[&train[..], &[name]].concat(), "expected a run, an empty folder or a new name");
    }
    for name in ["start", "trained", "marked", "prepared"] {
        refuse(path, &["demo", "--force", "--out", name], "was not made by demo");
        refuse(path, &["prepare", text(capture()), "--force", "--out", name], "was not made by prepare");
        refuse(
            path,
            &["render", text(&trained().join("scene.tcgs")), "--force", "--out", name],
            "not written by this command",
        );
    }
}

#[test]
fn of_several_that_make_the_same_one_wins() {
    for (arguments, name) in
        writers().into_iter().filter(|(_, name)| ["frames", "plys", "capture", "bench"].contains(name))
    {
        race(&[&arguments[..], &[name]].concat(), name);
    }
    race(&["export", text(&trained().join("run")), "--to", "new.f32"], "new.f32");
    race(
        &["train", text(capture()), "--iterations", "3,1", "--frames", "0..1", "--backend", "cpu", "--out", "a/run"],
        "a",
    );
}

fn race(arguments: &[&str], name: &str) {
    let folder = tempdir().unwrap();
    let start = |_| {
        let mut command = tcgs();
        command.current_dir(folder.path()).args(arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
    };
    let children: Vec<_> = (0..4).map(start).collect();
    let ends: Vec<Output> = children.into_iter().map(|child| child.wait_with_output().unwrap()).collect();
    let losers: Vec<&Output> = ends.iter().filter(|end| !end.status.success()).collect();
    assert_eq!(losers.len(), 3, "{arguments:?}: {losers:?}");
    for loser in losers {
        assert_eq!(loser.status.code(), Some(2), "{arguments:?}: {loser:?}");
        let line = last_line(loser);
        assert!(
            ["another process", "exists already", "holds a run"].iter().any(|cause| line.contains(cause)),
            "{line}"
        );
    }
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, [name], "{arguments:?}");
}

/// Decoders limit the memory by the length of the file. So many equal Gaussians exceed the limit of so short a file.
#[test]
fn what_decoders_would_refuse_is_not_written() {
    let folder = tempdir().unwrap();
    let (ply, file) = (folder.path().join("alike.ply"), folder.path().join("alike.tcgs"));
    let made = fs::File::create(&ply).unwrap();
    tcgs_interchange::write_ply_to(std::io::BufWriter::new(made), &tcgs_core::Gaussians::zeros(100_000)).unwrap();
    let line = fail(2, &["compress", text(&ply), "--out", text(&file), "--position-bits", "4", "--bits", "1,1"]);
    assert!(line.contains("alike.ply: decoders refuse its file of ") && line.contains("limit is"), "{line}");
    assert!(!file.exists());
}
