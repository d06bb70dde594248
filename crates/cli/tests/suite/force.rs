//! `--force` of every command, onto names relative to the working directory, and on another file system; also the
//! unfinished output of killed commands.
//!
//! `demo` is not tested here, since it takes a minute: continuous integration runs it onto an earlier one's folder.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};
use std::time::{Duration, Instant, SystemTime};

use crate::support::*;
use tempfile::TempDir;

/// A folder with a capture, a run of it and its file, named `capture`, `run` and `scene.tcgs`.
fn workplace() -> TempDir {
    workplace_in(&std::env::temp_dir())
}

fn workplace_in(parent: &Path) -> TempDir {
    let folder = tempfile::tempdir_in(parent).unwrap();
    tcgs_capture::write_synthetic(&folder.path().join("capture"), &SETTINGS).unwrap();
    let train = ["train", "capture", "--out", "run", "--iterations", "30,10", "--frames", "0..2"];
    // A params.npz holds the same Gaussians at every timestep.
    succeed_in(folder.path(), &[&train[..], &CPU, &["--set", "births.enabled=false"]].concat());
    succeed_in(folder.path(), &["compress", "run", "--out", "scene.tcgs"]);
    folder
}

const CPU: [&str; 2] = ["--backend", "cpu"];

fn run_in(folder: &Path, arguments: &[&str]) -> Output {
    tcgs().current_dir(folder).args(arguments).output().unwrap()
}

fn succeed_in(folder: &Path, arguments: &[&str]) -> String {
    let output = run_in(folder, arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {:?}: {message}", output.status);
    String::from_utf8(output.stdout).unwrap()
}

/// All files and folders below a folder, hidden ones included.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![folder.to_owned()];
    while let Some(folder) = open.pop() {
        // A temporary folder may have been renamed meanwhile.
        for entry in fs::read_dir(&folder).into_iter().flatten() {
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

fn unfinished(folder: &Path) -> Vec<PathBuf> {
    let is_unfinished = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().starts_with(".writing-");
    entries(folder).into_iter().filter(is_unfinished).collect()
}

/// Runs a command whose outputs lie in the folder, then runs it again without and with `--force`.
fn twice(folder: &Path, arguments: &[&str], outputs: &[&str]) {
    succeed_in(folder, arguments);
    let before = entries(folder);
    for output in outputs {
        assert!(folder.join(output).exists(), "{arguments:?} left no {output}");
    }
    // A file from an earlier run, which replacing must remove.
    let stale = outputs.iter().map(|output| folder.join(output)).find(|path| path.is_dir());
    let stale = stale.map(|output| match arguments[0] {
        "export" => output.join("123456.ply"),
        "render" => output.join("123456.png"),
        _ => output.join("init_pt_cld.npz"),
    });
    if let Some(stale) = &stale {
        fs::write(stale, b"stale").unwrap();
    }
    let refused = run_in(folder, arguments);
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert_eq!(refused.status.code(), Some(2), "{arguments:?}: {message}");
    assert!(message.contains("--force"), "{message}");
    succeed_in(folder, &[arguments, &["--force"]].concat());
    assert_eq!(entries(folder), before, "{arguments:?}");
    assert!(stale.is_none_or(|stale| !stale.exists() || fs::read(stale).unwrap() != b"stale"));
}

/// Every command that writes, except `demo`.
fn every_command(folder: &Path) {
    let with_json = |arguments: &[&str], name: &str, outputs: &[&str]| {
        let json = format!("{name}.json");
        twice(folder, &[arguments, &["--json", &json]].concat(), &[outputs, &[&json]].concat());
    };
    let train = ["train", "capture", "--out", "again", "--iterations", "3,1", "--frames", "0..2"];
    with_json(&[&train[..], &CPU].concat(), "train", &["again/config.toml", "again/checkpoints/000001.npz"]);
    with_json(&["compress", "run", "--out", "other.tcgs"], "compress", &["other.tcgs"]);
    twice(folder, &["compress", "again"], &["again/scene.tcgs"]);
    with_json(&["info", "scene.tcgs"], "info", &[]);
    with_json(&["export", "scene.tcgs", "--to", "plys"], "export", &["plys", "plys/000000.ply"]);
    twice(folder, &["export", "scene.tcgs", "--to", "./params.npz"], &["params.npz"]);
    twice(folder, &["export", "scene.tcgs", "--to", "one.ply", "--frames", "0..1"], &["one.ply"]);
    let render = ["render", "scene.tcgs", "--size", "16x12", "--frames", "0..1", "--out"];
    with_json(&[&render[..], &["frames"], &CPU].concat(), "render", &["frames", "frames/000000.png"]);
    twice(folder, &[&render[..], &["capture/../frames2/"], &CPU].concat(), &["frames2"]);
    let eval = ["eval", "scene.tcgs", "--capture", "capture", "--csv", "eval.csv"];
    with_json(&[&eval[..], &CPU].concat(), "eval", &["eval.csv"]);
    with_json(&["prepare", "capture", "--out", "prepared", "--points", "500"], "prepare", &["prepared"]);
    twice(folder, &["prepare", "capture", "--points-only", "points.npz", "--points", "500"], &["points.npz"]);
    let bench = ["bench", "--gaussians", "50", "--size", "16x12", "--iterations", "1"];
    with_json(&[&bench[..], &CPU].concat(), "bench", &[]);
    assert_eq!(unfinished(folder), [] as [PathBuf; 0]);
}

#[test]
fn every_command_replaces_what_is_named_relatively() {
    every_command(workplace().path());
}

#[test]
fn every_command_replaces_on_another_file_system() {
    let Some(folder) = on_another_file_system() else { return };
    every_command(folder.path());
}

#[test]
fn outputs_may_lie_on_another_file_system_than_where_one_stands() {
    let Some(other) = on_another_file_system() else { return };
    let here = workplace();
    // Outputs under their own names, and through links.
    let elsewhere = text(other.path());
    let frames = format!("{elsewhere}/frames2");
    let render = ["render", "scene.tcgs", "--size", "16x12", "--frames", "0..1", "--out", &frames];
    twice_elsewhere(here.path(), &[&render[..], &CPU].concat(), other.path());
    let capture = format!("{elsewhere}/prepared2");
    twice_elsewhere(here.path(), &["prepare", "capture", "--out", &capture, "--points", "500"], other.path());
    let params = format!("{elsewhere}/params2.npz");
    twice_elsewhere(here.path(), &["export", "scene.tcgs", "--to", &params], other.path());
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(other.path().join("params2.npz"), here.path().join("linked.npz")).unwrap();
        std::os::unix::fs::symlink(other.path().join("frames2"), here.path().join("linked")).unwrap();
        let before = entries(other.path());
        succeed_in(here.path(), &["export", "scene.tcgs", "--to", "linked.npz", "--force"]);
        let render = ["render", "scene.tcgs", "--size", "16x12", "--frames", "0..1", "--out", "linked", "--force"];
        succeed_in(here.path(), &[&render[..], &CPU].concat());
        assert!(here.path().join("linked.npz").is_symlink() && here.path().join("linked").is_symlink());
        assert_eq!(entries(other.path()), before);
    }
    assert_eq!(unfinished(here.path()), [] as [PathBuf; 0]);
}

/// As [`twice`], for one output in another folder.
fn twice_elsewhere(here: &Path, arguments: &[&str], elsewhere: &Path) {
    succeed_in(here, arguments);
    let before = entries(elsewhere);
    assert_eq!(run_in(here, arguments).status.code(), Some(2), "{arguments:?}");
    succeed_in(here, &[arguments, &["--force"]].concat());
    assert_eq!(entries(elsewhere), before, "{arguments:?}");
}

/// A [`workplace`] in memory, if temporary files lie on a disk; `None`, with a message, if that is impossible.
fn on_another_file_system() -> Option<TempDir> {
    let skip = |reason: &str| {
        let _ = writeln!(std::io::stderr(), "skipped: {reason}");
        None
    };
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt;
        let memory = Path::new("/dev/shm");
        let device = |path: &Path| fs::metadata(path).map(|found| found.dev());
        match (device(memory), device(&std::env::temp_dir())) {
            (Ok(memory_device), Ok(disk)) if memory_device != disk => {}
            _ => return skip("no /dev/shm that is another file system than that of temporary files"),
        }
        // The memory of a container is often too small for a test.
        match tempfile::tempdir_in(memory).and_then(|probe| fs::write(probe.path().join("probe"), vec![1; 32 << 20])) {
            Ok(()) => Some(workplace_in(memory)),
            Err(error) => skip(&format!("/dev/shm: {error}")),
        }
    }
    #[cfg(not(unix))]
    skip("another file system is not looked for here")
}

#[test]
fn a_link_to_nothing_is_refused_before_the_work() {
    #[cfg(unix)]
    {
        let folder = workplace();
        std::os::unix::fs::symlink("no/such/file.npz", folder.path().join("link.npz")).unwrap();
        let output = run_in(folder.path(), &["export", "scene.tcgs", "--to", "link.npz"]);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{message}");
        assert!(message.contains("link.npz: a link to a file that does not exist"), "{message}");
    }
}

/// A command removes the output of a killed rendering after a day, and not before.
#[test]
fn what_a_killed_command_left_is_removed_after_a_day() {
    let folder = workplace();
    let path = folder.path();
    let render = |out: &str| {
        let mut render = tcgs();
        render.current_dir(path).args(["render", "scene.tcgs", "--out", out, "--size", "640x480"]).args(CPU);
        render.stdout(Stdio::null()).stderr(Stdio::null());
        render
    };
    // One rendering is killed; another continues to write, or is suspended until the end of the test.
    let begun = |out: &str, earlier: &[PathBuf]| {
        let mut child = render(out).args(["--path", "orbit"]).spawn().unwrap();
        let end = Instant::now() + Duration::from_secs(60);
        let found = loop {
            let new = unfinished(path).into_iter().find(|path| !earlier.contains(path));
            // Waits until the folder has content: then its mark is whole as well.
            if let Some(new) = new.filter(|new| entries(new).len() > 1) {
                break new;
            }
            assert!(child.try_wait().unwrap().is_none() && Instant::now() < end, "rendering was over too early");
            std::thread::sleep(Duration::from_millis(1));
        };
        (child, found)
    };
    let (mut killed, left) = begun("killed", &[]);
    killed.kill().unwrap();
    killed.wait().unwrap();
    assert!(left.is_dir() && !path.join("killed").exists());
    let another = path.join(".writing-of-another-program");
    fs::create_dir(&another).unwrap();

    // The folder stays for an hour, so that a user can look for lost work.
    set_age(&left, Duration::from_secs(3600));
    set_age(&another, Duration::from_secs(1_000_000));
    succeed_in(path, &["info", "scene.tcgs", "--json", "1.json"]);
    assert!(left.is_dir());
    set_age(&left, Duration::from_secs(25 * 3600));
    succeed_in(path, &["info", "scene.tcgs", "--json", "2.json"]);
    assert!(!left.exists() && another.is_dir());

    #[cfg(target_os = "linux")]
    {
        // A process that is suspended for days still owns its folder.
        let (mut stopped, used) = begun("stopped", std::slice::from_ref(&another));
        signal(&stopped, "STOP");
        set_age(&used, Duration::from_secs(1_000_000));
        succeed_in(path, &["info", "scene.tcgs", "--json", "3.json"]);
        assert!(used.is_dir());
        signal(&stopped, "CONT");
        assert!(stopped.wait().unwrap().success());
        assert!(path.join("stopped").is_dir());
    }
    assert_eq!(unfinished(path), [another]);
}

#[cfg(target_os = "linux")]
fn signal(child: &std::process::Child, name: &str) {
    let status = std::process::Command::new("kill").args([format!("-{name}"), child.id().to_string()]).status();
    assert!(status.unwrap().success());
}

/// Sets the age of a folder and of everything in it.
fn set_age(path: &Path, age: Duration) {
    let times = SystemTime::now() - age;
    for entry in entries(path) {
        open_for_times(&entry).set_modified(times).unwrap();
    }
    open_for_times(path).set_modified(times).unwrap();
}

#[cfg(not(windows))]
fn open_for_times(path: &Path) -> File {
    File::open(path).unwrap()
}

/// Windows sets times only through a handle opened for writing, and opens folders only with a flag.
#[cfg(windows)]
fn open_for_times(path: &Path) -> File {
    use std::os::windows::fs::OpenOptionsExt;
    const FILE_FLAG_BACKUP_SEMANTICS: u32 = 0x0200_0000;
    File::options().write(true).custom_flags(FILE_FLAG_BACKUP_SEMANTICS).open(path).unwrap()
}
