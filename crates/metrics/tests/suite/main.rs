//! Metrics against their definitions and against values of other programs.

// Test helpers may unwrap, like tests.
#![allow(clippy::unwrap_used)]

use std::io::Write;

mod definition;
mod golden;
#[cfg(feature = "lpips")]
mod lpips;
mod similarity;
mod ssim;

/// Says that a test is skipped, for lack of files that may not be passed on with the project. Fails if `REQUIRE_GOLDEN`
/// is set.
fn skip(reason: &str) {
    assert!(std::env::var_os("REQUIRE_GOLDEN").is_none(), "REQUIRE_GOLDEN is set, and {reason}");
    // Written past the test harness's capture, so that a skip is visible.
    let _ = writeln!(std::io::stderr(), "skipped: {reason}");
}
