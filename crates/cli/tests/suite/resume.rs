//! Runs that are stopped, cut short by a full disk, or lengthened: their files stay correct.

use std::fs;
use std::path::Path;
#[cfg(unix)]
use std::process::Command;
use std::process::Stdio;
#[cfg(unix)]
use std::time::Duration;
use std::time::Instant;

use crate::support::*;
use tempfile::tempdir;

/// Arguments of the disturbed run: many checkpoints for little work.
fn arguments(out: &Path) -> [&str; 7] {
    ["train", text(capture()), "--out", text(out), "--iterations", "40,12", "--resume"]
}

/// The metrics of a run without times.
fn without_times(run: &Path) -> Vec<serde_json::Value> {
    let metrics = fs::read_to_string(run.join("metrics.jsonl")).unwrap();
    let parse = |line: &str| -> serde_json::Value {
        let mut value: serde_json::Value = serde_json::from_str(line).unwrap();
        value.as_object_mut().unwrap().remove("seconds").unwrap();
        value
    };
    metrics.lines().map(parse).collect()
}

/// Whether a checkpoint is being written, or was when its process was killed.
fn is_writing(run: &Path) -> bool {
    let Ok(entries) = fs::read_dir(run.join("checkpoints")) else { return false };
    entries.flatten().any(|entry| entry.file_name().to_string_lossy().starts_with(".writing-"))
}

#[test]
fn a_run_killed_at_any_moment_ends_as_if_it_had_not_been() {
    let folder = tempdir().unwrap();
    let calm = folder.path().join("calm");
    let begin = Instant::now();
    succeed(&arguments(&calm));
    let duration = begin.elapsed();
    let expected = checkpoints(&calm);
    assert_eq!(expected.len(), 4);

    let mut kills = 0;
    let mut stopped_after = [0; 5];
    let mut while_writing = 0;
    for round in 0..4_u32 {
        let run = folder.path().join(format!("run{round}"));
        for attempt in 0.. {
            assert!(attempt < 200, "the run does not get on");
            let mut child = tcgs().args(arguments(&run)).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            if round % 2 == 0 {
                // Moments spread evenly over the run, different in every round (golden ratio).
                let share = (f64::from(round * 37 + attempt) * 0.618_034).fract();
                std::thread::sleep(duration.mul_f64(0.02 + 0.8 * share));
            } else {
                // Waits until the second checkpoint of this attempt is being written, unless that is missed. A
                // checkpoint that the last attempt left unfinished does not count.
                let (mut seen, mut writing) = (0, true);
                while seen < 2 && child.try_wait().unwrap().is_none() {
                    let before = std::mem::replace(&mut writing, is_writing(&run));
                    seen += u32::from(writing && !before);
                    // Leaves a processor to the run.
                    std::thread::sleep(Duration::from_micros(200));
                }
            }
            child.kill().unwrap();
            let status = child.wait().unwrap();
            let found = checkpoints(&run);
            assert!(found[..] == expected[..found.len()], "a checkpoint is not what it should be");
            if status.success() {
                break;
            }
            #[cfg(unix)]
            assert_eq!(status.code(), None, "killed, not failed: {status}");
            kills += 1;
            stopped_after[found.len()] += 1;
            while_writing += u32::from(is_writing(&run));
        }
        assert!(checkpoints(&run) == expected, "round {round}");
        assert_eq!(fs::read(run.join("config.toml")).unwrap(), fs::read(calm.join("config.toml")).unwrap());
        assert_eq!(without_times(&run), without_times(&calm));
        let leftovers = fs::read_dir(&run).unwrap().chain(fs::read_dir(run.join("checkpoints")).unwrap());
        for entry in leftovers {
            let name = entry.unwrap().file_name().into_string().unwrap();
            assert!(!name.starts_with('.'), "{name} was left behind");
        }
    }
    eprintln!("{kills} kills, {while_writing} while writing a checkpoint; by number there are: {stopped_after:?}");
    assert!(kills >= 5, "only {kills} kills came in time");
}

/// Sends Ctrl-C to a process.
#[cfg(unix)]
fn interrupt(child: &std::process::Child) {
    let status = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(status.success());
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_a_run_cleanly_and_it_resumes_to_the_same_bytes() {
    let folder = tempdir().unwrap();
    let (calm, run) = (folder.path().join("calm"), folder.path().join("run"));
    let arguments = |out| ["train", text(capture()), "--out", out, "--iterations", "60,60", "--resume"];
    succeed(&arguments(text(&calm)));
    let expected = checkpoints(&calm);
    let mut stops = 0;
    // Within the first timestep, then within the timesteps after 1, 2 and 3 checkpoints.
    for before in 0..expected.len() {
        let child = tcgs().args(arguments(text(&run))).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        while !run.join("config.toml").exists() || checkpoints(&run).len() < before {
            std::thread::sleep(Duration::from_millis(1));
        }
        std::thread::sleep(Duration::from_millis(20));
        interrupt(&child);
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        let found = checkpoints(&run);
        assert!(found[..] == expected[..found.len()], "a checkpoint is not what it should be");
        if output.status.success() {
            continue;
        }
        stops += 1;
        assert_eq!(output.status.code(), Some(130), "{message}");
        let said = format!("tcgs: stopped: {} of 4 timesteps are trained; --resume goes on", found.len());
        assert!(message.contains("ending cleanly") && message.contains(&said), "{message}");
        assert!(!is_writing(&run));
    }
    assert!(stops >= 2, "only {stops} interruptions came in time");
    succeed(&arguments(text(&run)));
    assert!(checkpoints(&run) == expected);
    assert_eq!(without_times(&run), without_times(&calm));
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_nothing_half_written() {
    let folder = tempdir().unwrap();
    let run = folder.path().join("run");
    succeed(&arguments(&run));
    let (frames, plys) = (folder.path().join("frames"), folder.path().join("plys"));
    let (file, prepared) = (folder.path().join("small.tcgs"), folder.path().join("prepared"));
    let commands: [&[&str]; 4] = [
        // Rendering pictures of this size takes longer than the test waits.
        &["render", text(&run), "--out", text(&frames), "--size", "4000x3000"],
        &["render", text(&run), "--out", text(&plys), "--size", "4000x3000", "--path", "spiral"],
        &["compress", text(&run), "--out", text(&file), "--target-psnr", "30"],
        &["prepare", text(capture()), "--out", text(&prepared)],
    ];
    // These may be whole before the signal comes.
    let mut whole = vec![text(&file), text(&prepared)];
    for arguments in commands {
        let child = tcgs().args(arguments).stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        std::thread::sleep(Duration::from_millis(150));
        interrupt(&child);
        let output = child.wait_with_output().unwrap();
        if output.status.success() {
            // A process that starts in the background ignores the signal until it catches it.
            whole.push(arguments[3]);
            continue;
        }
        let message = String::from_utf8(output.stderr).unwrap();
        // The signal ends the process if it is not caught yet.
        assert!(matches!(output.status.code(), Some(130) | None), "{arguments:?}: {}: {message}", output.status);
        let mut left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        left.retain(|name| !whole.iter().any(|path| Path::new(path).ends_with(name)));
        assert_eq!(left, ["run"], "{arguments:?}: {message}");
    }
}

/// A command that writes only at its end.
#[cfg(unix)]
#[test]
fn ctrl_c_ends_other_commands_at_once() {
    let folder = tempdir().unwrap();
    let json = folder.path().join("bench.json");
    // If this test runs in the background, its processes would ignore the signal.
    let mut command = Command::new("env");
    command.args(["--default-signal=INT", env!("CARGO_BIN_EXE_tcgs")]);
    command.args(["bench", "--backend", "cpu", "--json", text(&json)]).stdout(Stdio::null()).stderr(Stdio::null());
    let mut child = command.spawn().unwrap();
    std::thread::sleep(Duration::from_millis(300));
    let signalled = Instant::now();
    interrupt(&child);
    assert_eq!(child.wait().unwrap().code(), Some(130));
    assert!(signalled.elapsed() < Duration::from_secs(5));
    assert!(!json.exists());
}

#[test]
fn a_damaged_last_checkpoint_is_set_aside() {
    let folder = tempdir().unwrap();
    let run = folder.path().join("run");
    succeed(&arguments(&run));
    let expected = checkpoints(&run);
    let last = run.join("checkpoints/000003.npz");
    fs::write(&last, &expected[3].1[..expected[3].1.len() / 2]).unwrap();
    fs::write(run.join("checkpoints/.writing-abc"), b"x").unwrap();
    let output = tcgs().args(arguments(&run)).output().unwrap();
    assert!(output.status.success());
    assert!(String::from_utf8(output.stderr).unwrap().contains("000003.npz: not a checkpoint"), "it says so");
    assert_eq!(fs::read(&last).unwrap(), expected[3].1);
    assert!(!run.join("checkpoints/.writing-abc").exists());

    // The optimizer's state of the last timestep is damaged, too; that of the timestep before is intact.
    let states = ["resume0.npz", "resume1.npz"].map(|name| run.join(name));
    fs::write(&states[1], b"PK").unwrap();
    let output = tcgs().args(arguments(&run)).output().unwrap();
    assert!(output.status.success());
    assert!(String::from_utf8(output.stderr).unwrap().contains("resume1.npz: not a checkpoint"), "it says so");
    let is_whole = |(name, _): &(String, Vec<u8>)| !name.ends_with(".damaged");
    assert!(checkpoints(&run).into_iter().filter(is_whole).eq(expected.iter().cloned()));
    // Without either state the run cannot continue, and no timestep is discarded.
    let saved = states.each_ref().map(|path| fs::read(path).unwrap());
    states.iter().for_each(|path| fs::remove_file(path).unwrap());
    let more = [&arguments(&run)[..], &["--frames", "0..4"]].concat();
    assert!(fail(2, &more).contains("resume1.npz: not a checkpoint"));
    assert!(checkpoints(&run).into_iter().filter(is_whole).eq(expected.iter().cloned()));
    states.iter().zip(saved).for_each(|(path, bytes)| fs::write(path, bytes).unwrap());

    // A damaged checkpoint in the middle is an error: later timesteps depend on it.
    fs::write(run.join("checkpoints/000000.npz"), b"PK").unwrap();
    let message = fail(2, &arguments(&run));
    assert!(message.contains("000000.npz"), "{message}");
}

#[test]
fn a_run_can_be_lengthened_and_nothing_else() {
    let folder = tempdir().unwrap();
    let (short, long) = (folder.path().join("short"), folder.path().join("long"));
    succeed(&arguments(&long));
    succeed(&[&arguments(&short)[..], &["--frames", "0..2"]].concat());
    let result = folder.path().join("result.json");
    let refuse = |more: &[&str], expected: &str| {
        let message = fail(2, &[&["train", text(capture()), "--out", text(&short), "--resume"], more].concat());
        assert!(message.contains(expected), "{message}");
    };
    refuse(&["--iterations", "40,13"], "schedule.rest_iterations differs");
    refuse(&["--preset", "paper"], "preset differs");
    refuse(&["--frames", "1..4"], "data.first_frame differs");
    refuse(&["--seed", "3"], "seed differs");
    refuse(&["--frames", "0..5"], "has the frames 0..4");
    assert_eq!(checkpoints(&short).len(), 2);

    let said = succeed(&["train", text(capture()), "--out", text(&short), "--resume"]);
    assert!(said.contains("complete: 2 timesteps"), "{said}");
    let more = ["--frames", "0..4", "--json", text(&result)];
    let said = succeed(&[&["train", text(capture()), "--out", text(&short), "--resume"], &more[..]].concat());
    assert!(said.contains("going on after 2 of 4 timesteps"), "{said}");
    assert!(checkpoints(&short) == checkpoints(&long));
    assert_eq!(without_times(&short), without_times(&long));
    let timesteps = json(&result)["timesteps"].as_array().unwrap().clone();
    assert_eq!(timesteps.len(), 4, "those from before the stop too");
    assert!(timesteps.iter().all(|t| t["psnr"].is_f64() && t["seconds"].is_f64()));
}

/// Runs a command whose files may not grow beyond a limit in kilobytes; returns exit code and message.
#[cfg(unix)]
fn with_file_limit(kilobytes: u32, arguments: &[&str]) -> (Option<i32>, String) {
    let script = format!("ulimit -f {kilobytes}; exec \"$@\"");
    let output = Command::new("bash")
        .args(["-c", &script, "bash", env!("CARGO_BIN_EXE_tcgs")])
        .args(arguments)
        .output()
        .unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[cfg(unix)]
#[test]
fn a_write_that_fails_leaves_nothing_half_done() {
    let folder = tempdir().unwrap();
    let (calm, run) = (folder.path().join("calm"), folder.path().join("run"));
    succeed(&arguments(&calm));
    let expected = checkpoints(&calm);
    let first_kilobytes = expected[0].1.len() as u32 / 1024;

    let (code, message) = with_file_limit(first_kilobytes - 1, &arguments(&run));
    assert_eq!(code, Some(1), "{message}");
    assert!(message.contains("000000.npz") && message.contains("too large"), "{message}");
    assert!(checkpoints(&run).is_empty());
    succeed(&arguments(&run));
    assert!(checkpoints(&run) == expected);

    let file = run.join("scene.tcgs");
    let (code, message) = with_file_limit(1, &["compress", text(&run)]);
    assert_eq!(code, Some(1), "{message}");
    assert!(message.contains("scene.tcgs") && !file.exists(), "{message}");
    let exported = folder.path().join("plys");
    let (code, message) = with_file_limit(1, &["export", text(&run), "--to", text(&exported)]);
    assert_eq!(code, Some(1), "{message}");
    assert!(!exported.exists());
    let frames = folder.path().join("frames");
    let (code, message) = with_file_limit(1, &["render", text(&run), "--out", text(&frames)]);
    assert_eq!(code, Some(1), "{message}");
    assert!(!frames.exists());
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_ends_a_run_whose_checkpoints_stay_right() {
    use std::io::Write;
    struct Mounted(tempfile::TempDir);
    impl Drop for Mounted {
        fn drop(&mut self) {
            let _ = Command::new("umount").arg(self.0.path()).status();
        }
    }
    let folder = tempdir().unwrap();
    let calm = folder.path().join("calm");
    succeed(&arguments(&calm));
    let expected = checkpoints(&calm);
    // The limit has space for two and a half checkpoints.
    let sizes: Vec<usize> = expected.iter().map(|(_, file)| file.len()).collect();
    let room = (sizes[0] + sizes[1] + sizes[2] / 2) / 4096 * 4096 + 5 * 4096;
    let disk = tempdir().unwrap();
    let options = format!("size={room}");
    let mount = Command::new("mount").args(["-t", "tmpfs", "-o", &options, "tmpfs"]).arg(disk.path()).output();
    if !mount.is_ok_and(|mount| mount.status.success()) {
        // Written past the test harness's capture, so that a skip is visible.
        let _ = writeln!(std::io::stderr(), "skipped: mounting a small disk needs rights that this process lacks");
        return;
    }
    let disk = Mounted(disk);
    let run = disk.0.path().join("run");
    let output = tcgs().args(arguments(&run)).output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{message}");
    let is_remark = |line: &&str| line.starts_with("computing on ") || line.starts_with("warning: ");
    assert_eq!(message.lines().filter(|line| !is_remark(line)).count(), 1, "{message}");
    assert!(message.contains("No space left") && message.contains("make room, then --resume goes on"), "{message}");
    let found = checkpoints(&run);
    assert!(!found.is_empty() && found.len() < 4 && found[..] == expected[..found.len()], "{} found", found.len());
    let compressed = tcgs().args(["compress", text(&run)]).output().unwrap();
    if !compressed.status.success() {
        assert_eq!(compressed.status.code(), Some(1));
        assert!(!run.join("scene.tcgs").exists());
    }
}

#[test]
fn a_run_that_diverges_stops_with_its_checkpoints() {
    let folder = tempdir().unwrap();
    let run = folder.path().join("run");
    let message = fail(1, &[&arguments(&run)[..], &["--set", "rates.color_rest=1e38"]].concat());
    assert!(message.contains("timestep 1") && message.contains("iteration"), "{message}");
    assert!(message.contains("begin again with lower rates"), "{message}");
    assert_eq!(checkpoints(&run).len(), 1);
    tcgs_train::Run::open(&run).unwrap().trained().unwrap();
}

#[test]
fn a_frame_that_cannot_be_read_is_named_and_costs_nothing_before_it() {
    let folder = tempdir().unwrap();
    let (capture, run) = (folder.path().join("capture"), folder.path().join("run"));
    tcgs_capture::write_synthetic(&capture, &SETTINGS).unwrap();
    let image = capture.join("ims/3/000002.png");
    let whole = fs::read(&image).unwrap();
    fs::write(&image, &whole[..whole.len() / 2]).unwrap();
    let arguments = ["train", text(&capture), "--out", text(&run), "--iterations", "40,12"];
    let message = fail(2, &arguments);
    assert!(message.contains("000002.png"), "{message}");
    assert_eq!(checkpoints(&run).len(), 2);
    fs::write(&image, whole).unwrap();
    succeed(&[&arguments[..], &["--resume"]].concat());
    assert_eq!(checkpoints(&run).len(), 4);
}
