//! Suggested next commands run as they are printed.

use std::path::Path;
use std::process::Command;

use crate::support::*;
use tcgs_capture::{SyntheticSettings, write_synthetic};
use tempfile::tempdir;

/// The command of the last line that begins with `next: `.
fn next(said: &str) -> String {
    said.lines().rev().find_map(|line| line.strip_prefix("next: ")).unwrap_or_else(|| panic!("{said}")).to_owned()
}

/// Runs a line in a shell, in a folder, and returns its standard output.
fn shell(line: &str, folder: &Path) -> String {
    let program = Path::new(env!("CARGO_BIN_EXE_tcgs"));
    let path = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap());
    let mut command = Command::new("sh");
    command.args(["-c", line]).current_dir(folder).env("PATH", path).env_remove("TCGS_LPIPS_WEIGHTS");
    let output = command.env("NODEVICE_SELECT", "1").output().unwrap();
    assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[cfg(unix)]
#[test]
fn each_next_line_runs_as_it_is_printed() {
    let folder = tempdir().unwrap();
    let here = folder.path();
    // All cameras are training cameras, so none is held out.
    let settings = SyntheticSettings {
        width: 64,
        height: 48,
        num_train_cameras: 6,
        num_test_cameras: 0,
        num_timesteps: 1,
        ..SyntheticSettings::default()
    };
    write_synthetic(&here.join("my footage"), &settings).unwrap();
    let said = shell("tcgs prepare 'my footage' --out \"it's mine\" --points 2000", here);
    let line = next(&said);
    assert_eq!(line, r"tcgs train 'it'\''s mine' --out 'it'\''s mine_run'");
    let said = shell(&format!("{line} --iterations 30,10 --backend cpu"), here);
    assert!(said.contains("no camera is held out") && said.contains("--hold-out 3 measures"), "{said}");
    assert!(said.contains("Gaussians become fewer (") && said.contains("nearly transparent"), "{said}");
    let line = next(&said);
    assert!(line.ends_with(" --cameras train"), "{line}");
    let said = shell(&line, here);
    assert!(said.contains("cameras: those that were trained on, which flatters"), "{said}");
    // A file that exists is not overwritten.
    let said = shell(r"tcgs train 'it'\''s mine' --out 'it'\''s mine_run' --resume --backend cpu", here);
    let line = next(&said);
    assert!(line.contains(r"--out 'it'\''s mine_run/scene2.tcgs'"), "{line}");
    shell(&line, here);
    let said = shell("tcgs train \"it's mine\" --out held --iterations 30,10 --hold-out 3 --backend cpu", here);
    assert!(next(&said).ends_with(" --cameras 3") && !said.contains("no camera is held out"), "{said}");
}

#[test]
fn training_on_a_folder_of_videos_names_prepare() {
    let folder = tempdir().unwrap();
    let videos = folder.path().join("my videos");
    std::fs::create_dir(&videos).unwrap();
    std::fs::write(videos.join("cam1.mp4"), "x").unwrap();
    std::fs::write(videos.join("cam2.mp4"), "x").unwrap();
    let message = fail(2, &["train", text(&videos), "--out", text(&folder.path().join("run"))]);
    let place = text(folder.path());
    let expected = format!("`tcgs prepare '{place}/my videos' --out '{place}/my videos_capture'` makes one");
    assert!(message.ends_with(&expected), "{message}");
}
