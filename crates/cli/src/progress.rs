//! How far a long command is: a bar on a terminal, now and then a line elsewhere; on standard error.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use tcgs_core::printable;

use crate::terminal::{note, say};

/// Where there is no terminal, at most a line in this time.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// Work being done.
pub struct Progress {
    bar: ProgressBar,
    name: &'static str,
    total: u64,
    /// Of the last plain line.
    last: Instant,
}

impl Progress {
    /// Begins.
    ///
    /// - `name`: what is done, such as `rendering`
    /// - `total`: how many steps of it
    pub fn new(name: &'static str, total: usize) -> Self {
        let bar = ProgressBar::with_draw_target(Some(total as u64), ProgressDrawTarget::stderr_with_hz(8));
        let style = ProgressStyle::with_template("{prefix} {bar:30} {percent:>3} %  {eta} left  {wide_msg}");
        bar.set_style(style.expect("a template that is right").progress_chars("━╸─"));
        bar.set_prefix(name);
        Self { bar, name, total: total as u64, last: Instant::now() }
    }

    /// One step more; otherwise as [`Self::advance_to`].
    pub fn step(&mut self, detail: impl FnOnce() -> String) {
        self.advance_to(self.bar.position() as usize + 1, detail);
    }

    /// So many steps are done.
    ///
    /// - `detail`: behind the bar
    pub fn advance_to(&mut self, num_done: usize, detail: impl FnOnce() -> String) {
        self.bar.set_position(num_done as u64);
        if self.bar.is_hidden() {
            if self.last.elapsed() >= LINE_INTERVAL {
                self.last = Instant::now();
                let percent = 100 * self.bar.position() / self.total.max(1);
                note(&format!("{} {percent} %  {}", self.name, detail()));
            }
        } else if self.last.elapsed() >= Duration::from_millis(100) {
            self.last = Instant::now();
            self.bar.set_message(printable(&detail()).into_owned());
        }
    }

    /// Prints a line on standard output without tearing the bar.
    pub fn say(&self, text: &str) -> anyhow::Result<()> {
        self.bar.suspend(|| say(text))
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
