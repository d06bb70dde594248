//! How far a long command is: a bar on a terminal, now and then a line elsewhere; on standard error.

use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use tcgs_core::printable;

use crate::terminal::{note, say};

/// Where there is no terminal, at most a line in this time.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// Work of fewer steps has long and short ones, which do not tell how long the rest takes.
const FINE: u64 = 20;

/// Work being done.
pub struct Progress {
    bar: ProgressBar,
    name: &'static str,
    total: u64,
    begin: Instant,
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
        let begin = Instant::now();
        Self { bar, name, total: total as u64, begin, last: begin }
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
                let done = self.bar.position() as f64 / self.total.max(1) as f64;
                let left = (self.total >= FINE).then(|| time_left(self.begin.elapsed(), done)).flatten();
                let left = left.map_or(String::new(), |left| format!("  {left} left"));
                note(&format!("{} {:.0} %{left}  {}", self.name, (100.0 * done).floor(), detail()));
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

/// About how long the rest takes, in words, if it goes on as it went so far. `None` where too little is done to tell.
///
/// - `done`: share of the work, 0 to 1
fn time_left(elapsed: Duration, done: f64) -> Option<String> {
    const FEW: f64 = 0.02;
    let secs = (FEW..1.0).contains(&done).then(|| elapsed.as_secs_f64() * (1.0 - done) / done)?;
    Some(match secs {
        ..90.0 => format!("{secs:.0} s"),
        ..5400.0 => format!("{:.0} min", secs / 60.0),
        _ => format!("{:.1} h", secs / 3600.0),
    })
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rest_takes_as_long_as_what_is_done() {
        let left = |secs, done| time_left(Duration::from_secs(secs), done);
        assert_eq!(left(30, 0.25).as_deref(), Some("2 min"));
        assert_eq!(left(30, 0.5).as_deref(), Some("30 s"));
        assert_eq!(left(600, 0.2).as_deref(), Some("40 min"));
        assert_eq!(left(3600, 0.1).as_deref(), Some("9.0 h"));
        assert_eq!((left(5, 0.0), left(5, 0.01), left(5, 1.0)), (None, None, None));
    }
}
