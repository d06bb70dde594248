//! Captures and programs beside the checkout. Tests that need an absent one are skipped.

use std::fmt::Display;
use std::io::Write;
use std::path::PathBuf;
#[cfg(feature = "video")]
use std::process::{Command, Stdio};

/// The folder of a real or rendered capture. `None` skips the test, unless `REQUIRE_GOLDEN` is set.
pub fn real_folder(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")).join(name);
    if !path.is_dir() {
        skip("REQUIRE_GOLDEN", format_args!("{} is absent", path.display()));
        return None;
    }
    Some(path)
}

/// Whether `ffmpeg` is installed; without it a test is skipped, unless `REQUIRE_FFMPEG` is set.
#[cfg(feature = "video")]
pub fn has_ffmpeg() -> bool {
    let found = Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).status().is_ok();
    if !found {
        skip("REQUIRE_FFMPEG", "there is no ffmpeg");
    }
    found
}

/// Says that a test is skipped. Fails if the variable `requirement` is set: then no test may be skipped for this
/// reason.
fn skip(requirement: &str, reason: impl Display) {
    assert!(std::env::var_os(requirement).is_none(), "{requirement} is set, and {reason}");
    // Written past the test harness's capture, so that a skip is visible.
    let _ = writeln!(std::io::stderr(), "skipped: {reason}");
}
