//! Runs the command on a small capture.

pub mod server;
pub mod videos;

use std::fmt::Display;
use std::fs;
use std::io::{ErrorKind, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use std::thread;
use std::time::Duration;

use serde_json::Value;
use tcgs_capture::{SyntheticSettings, write_synthetic};
use tempfile::TempDir;

/// Settings of [`capture`].
pub const SETTINGS: SyntheticSettings = SyntheticSettings {
    width: 48,
    height: 36,
    num_train_cameras: 4,
    num_test_cameras: 1,
    num_timesteps: 4,
    num_points: 400,
    seed: 0,
};

/// A capture shared by all tests of a file, never changed.
pub fn capture() -> &'static Path {
    static CAPTURE: OnceLock<TempDir> = OnceLock::new();
    CAPTURE
        .get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            write_synthetic(folder.path(), &SETTINGS).unwrap();
            folder
        })
        .path()
}

/// The `tcgs` command without its arguments.
pub fn tcgs() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_tcgs"));
    // A layer of Mesa's Vulkan drivers writes to standard error if there is no desktop.
    command.env("NODEVICE_SELECT", "1");
    // Each test itself decides whether LPIPS is measured.
    command.env_remove("TCGS_LPIPS_WEIGHTS");
    command
}

/// Says that a test is skipped. Fails if the variable `requirement` is set: then no test may be skipped for this
/// reason.
pub fn skip(requirement: &str, reason: impl Display) {
    assert!(std::env::var_os(requirement).is_none(), "{requirement} is set, and {reason}");
    // Written past the test harness's capture, so that a skip is visible.
    let _ = writeln!(std::io::stderr(), "skipped: {reason}");
}

/// A file or folder that may not be passed on with the project. `None` skips the test, unless `REQUIRE_GOLDEN` is set.
pub fn shared(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared")).join(name);
    if !path.exists() {
        skip("REQUIRE_GOLDEN", format_args!("{} is absent", path.display()));
        return None;
    }
    Some(path)
}

/// An argument for [`run`].
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Runs the command; returns its output and exit status.
pub fn run(arguments: &[&str]) -> Output {
    tcgs().args(arguments).output().unwrap()
}

/// Runs a command that must succeed, and returns its standard output.
pub fn succeed(arguments: &[&str]) -> String {
    let output = run(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{arguments:?}: {:?}: {message}", output.status);
    String::from_utf8(output.stdout).unwrap()
}

/// Runs a command that must fail with an exit code, and returns its message of one line.
pub fn fail(code: i32, arguments: &[&str]) -> String {
    let output = run(arguments);
    let message = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
    let is_remark =
        |line: &&str| ["computing on ", "warning: ", "note: "].iter().any(|remark| line.starts_with(remark));
    let lines: Vec<&str> = message.lines().filter(|line| !is_remark(line)).collect();
    let [line] = lines[..] else { panic!("{arguments:?}: expected one line, found {message}") };
    assert!(line.starts_with("tcgs: "), "{line}");
    line.to_owned()
}

/// Trains a short run in `folder` and returns its path. A training this short leaves large errors, where births would
/// add Gaussians. Without births their number is constant, which some formats require.
pub fn train(folder: &TempDir, name: &str, more: &[&str]) -> PathBuf {
    let run = folder.path().join(name);
    let whole = ["train", text(capture()), "--out", text(&run), "--iterations", "30,10"];
    let arguments = [&whole[..], &["--set", "births.enabled=false"]].concat();
    succeed(&[&arguments[..], more].concat());
    run
}

/// Reads a JSON result.
pub fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

/// Names of an object's fields, sorted.
pub fn keys(value: &Value) -> Vec<&str> {
    let mut keys: Vec<&str> = value.as_object().unwrap().keys().map(String::as_str).collect();
    keys.sort_unstable();
    keys
}

/// Asserts that an object has these fields and no others.
pub fn assert_keys(value: &Value, expected: &[&str]) {
    let mut expected = expected.to_vec();
    expected.sort_unstable();
    assert_eq!(keys(value), expected);
}

/// Files of a run's checkpoints, by name.
pub fn checkpoints(run: &Path) -> Vec<(String, Vec<u8>)> {
    let Ok(entries) = fs::read_dir(run.join("checkpoints")) else { return Vec::new() };
    let mut files: Vec<(String, Vec<u8>)> = entries
        .map(|entry| entry.unwrap())
        .filter(|entry| !entry.file_name().to_string_lossy().starts_with('.'))
        .map(|entry| (entry.file_name().into_string().unwrap(), fs::read(entry.path()).unwrap()))
        .collect();
    files.sort();
    files
}

/// Writes a shell script that is found as a program and ends at once when it is asked for its version.
pub fn write_program(place: &Path, script: &str) {
    fs::write(place, format!("#!/bin/sh\n[ \"$1\" = -version ] && exit\n{script}\n")).unwrap();
    fs::set_permissions(place, fs::Permissions::from_mode(0o755)).unwrap();
    // A process that another test starts meanwhile holds the file open for a moment: until then it cannot be run.
    while let Err(error) = Command::new(place).arg("-version").status() {
        assert_eq!(error.kind(), ErrorKind::ExecutableFileBusy, "{}: {error}", place.display());
        thread::sleep(Duration::from_millis(5));
    }
}
