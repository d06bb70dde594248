//! The memory of training does not grow with the length of the capture.

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use crate::support::*;
use tcgs_capture::{SyntheticSettings, write_synthetic};
use tempfile::tempdir;

/// Few pixels, many timesteps.
fn long(num_timesteps: usize) -> SyntheticSettings {
    SyntheticSettings { width: 24, height: 18, num_timesteps, num_points: 3000, ..SETTINGS }
}

fn arguments<'a>(capture: &'a Path, run: &'a Path, frames: &'a str) -> Vec<&'a str> {
    let fixed = ["--iterations", "8,2", "--threads", "2", "--backend", "cpu", "--frames", frames];
    [&["train", text(capture), "--out", text(run)], &fixed[..]].concat()
}

/// Peak address space of a command, kilobytes.
fn peak(arguments: &[&str]) -> u64 {
    let mut child = tcgs().args(arguments).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let mut peak = 0;
    while child.try_wait().unwrap().is_none() {
        let status = fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
        let line = status.lines().find_map(|line| line.strip_prefix("VmPeak:"));
        peak = line.and_then(|line| line.trim().trim_end_matches(" kB").parse().ok()).unwrap_or(peak);
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    peak
}

fn limited(kilobytes: u64, arguments: &[&str]) -> Output {
    let script = format!("ulimit -v {kilobytes}; exec \"$@\"");
    Command::new("bash").args(["-c", &script, "bash", env!("CARGO_BIN_EXE_tcgs")]).args(arguments).output().unwrap()
}

#[test]
fn hundreds_of_timesteps_fit_where_thirty_do() {
    let num_timesteps = 250;
    let folder = tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    write_synthetic(&path("capture"), &long(num_timesteps)).unwrap();
    let (capture, short, long, tight) = (path("capture"), path("short"), path("long"), path("tight"));
    let most = peak(&arguments(&capture, &short, "0..30"));
    assert!(most > 0);
    // The floats of 220 more timesteps would be 27 MB.
    let slack = (16 * 1024).min(most / 10);
    let output = limited(most + slack, &arguments(&capture, &long, &format!("0..{num_timesteps}")));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(checkpoints(&long).len(), num_timesteps);
    eprintln!("{num_timesteps} timesteps within {} kB, 30 take {most} kB", most + slack);

    // The limit takes effect: a small part of it is too little. Threads reserve more addresses than they need.
    let output = limited(most / 16, &arguments(&capture, &tight, "0..10"));
    assert!(!output.status.success(), "a limit of {} kB limits nothing", most / 16);
}
