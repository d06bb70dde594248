//! Progress of a long command on standard error: a bar on a terminal, occasional lines elsewhere.

use std::fmt::Write;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use tcgs_core::printable;

use crate::output::show_time;
use crate::terminal::{note, say};

/// Least time between two lines where there is no terminal.
const LINE_INTERVAL: Duration = Duration::from_secs(10);

/// Least number of steps for an estimate of the time left: with fewer, steps are too unequal.
const FINE: u64 = 20;

/// The job of several commands that the tasks belong to; none if a command runs alone.
static JOB: Mutex<Option<JobStep>> = Mutex::new(None);

/// A step of a job of several commands, such as `tcgs make`. Every task shows it from now on.
#[derive(Clone, Copy, Debug)]
pub struct JobStep {
    /// Number of the step, from 1.
    pub number: usize,
    /// Number of steps.
    pub of: usize,
    /// When the job ends.
    pub end: JobEnd,
}

/// When a job of several commands ends.
#[derive(Clone, Copy, Debug)]
pub enum JobEnd {
    /// Nothing tells it yet.
    Unknown,
    /// At this moment.
    At(Instant),
    /// As long after the end of the present task.
    After(Duration),
}

impl JobStep {
    /// Makes this the step of all tasks that begin from now on.
    pub fn begin(self) {
        *JOB.lock().expect("no thread panics with the step") = Some(self);
    }

    /// - `left`: time that the present task still takes; none if that is unknown
    fn time_left(self, left: Option<Duration>) -> Option<Duration> {
        match self.end {
            JobEnd::Unknown => None,
            // A task may take longer than the job has left.
            JobEnd::At(end) => Some(end.saturating_duration_since(Instant::now()).max(left.unwrap_or_default())),
            JobEnd::After(rest) => Some(left? + rest),
        }
    }

    /// The time that the whole job still takes, in words, as a suffix.
    fn words(self, left: Option<Duration>) -> String {
        self.time_left(left).map_or(String::new(), |left| format!(" ({} for everything)", show_time(left)))
    }
}

/// A task in progress.
pub struct Progress {
    bar: ProgressBar,
    name: String,
    job: Option<JobStep>,
    total: u64,
    begin: Instant,
    /// Time of the last line or message.
    last: Instant,
}

impl Progress {
    /// Begins a task.
    ///
    /// - `name`: of the task, such as `rendering`
    /// - `total`: its number of steps
    pub fn new(name: &'static str, total: usize) -> Self {
        let bar = ProgressBar::with_draw_target(Some(total as u64), ProgressDrawTarget::stderr_with_hz(8));
        let job = *JOB.lock().expect("no thread panics with the step");
        let name = job.map_or(name.into(), |job| format!("{}/{} {name}", job.number, job.of));
        let style = ProgressStyle::with_template("{prefix} {bar:30} {percent:>3} %  {eta} left{job}  {wide_msg}");
        let write_job = move |state: &ProgressState, out: &mut dyn Write| {
            let words = job.map_or(String::new(), |job| job.words(Some(state.eta())));
            // A terminal that fails is not the task's concern.
            let _ = out.write_str(&words);
        };
        let style = style.expect("a template that is right").progress_chars("━╸─").with_key("job", write_job);
        bar.set_style(style);
        bar.set_prefix(name.clone());
        let begin = Instant::now();
        Self { bar, name, job, total: total as u64, begin, last: begin }
    }

    /// Completes one more step; otherwise as [`Self::advance_to`].
    pub fn step(&mut self, detail: impl FnOnce() -> String) {
        self.advance_to(self.bar.position() as usize + 1, detail);
    }

    /// Sets the number of completed steps.
    ///
    /// - `detail`: text behind the bar
    pub fn advance_to(&mut self, num_done: usize, detail: impl FnOnce() -> String) {
        self.bar.set_position(num_done as u64);
        if self.bar.is_hidden() {
            if self.last.elapsed() >= LINE_INTERVAL {
                self.last = Instant::now();
                let done = self.bar.position() as f64 / self.total.max(1) as f64;
                let left = (self.total >= FINE).then(|| time_left(self.begin.elapsed(), done)).flatten();
                let of_job = self.job.map_or(String::new(), |job| job.words(left));
                let left = left.map_or(String::new(), |left| format!("  {} left", show_time(left)));
                note(&format!("{} {:.0} %{left}{of_job}  {}", self.name, (100.0 * done).floor(), detail()));
            }
        } else if self.last.elapsed() >= Duration::from_millis(100) {
            self.last = Instant::now();
            self.bar.set_message(printable(&detail()).into_owned());
        }
    }

    /// Prints a line on standard output without breaking the bar.
    pub fn say(&self, text: &str) -> anyhow::Result<()> {
        self.bar.suspend(|| say(text))
    }
}

/// The estimated time left, at the mean speed so far. `None` where too little is done to tell.
///
/// - `done`: share of the work, 0 to 1
fn time_left(elapsed: Duration, done: f64) -> Option<Duration> {
    const FEW: f64 = 0.02;
    let secs = (FEW..1.0).contains(&done).then(|| elapsed.as_secs_f64() * (1.0 - done) / done)?;
    Some(Duration::from_secs_f64(secs))
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
        let left = |secs, done| time_left(Duration::from_secs(secs), done).map(show_time);
        assert_eq!(left(30, 0.25).as_deref(), Some("2 min"));
        assert_eq!(left(30, 0.5).as_deref(), Some("30 s"));
        assert_eq!(left(600, 0.2).as_deref(), Some("40 min"));
        assert_eq!(left(3600, 0.1).as_deref(), Some("9.0 h"));
        assert_eq!((left(5, 0.0), left(5, 0.01), left(5, 1.0)), (None, None, None));
    }

    #[test]
    fn a_job_ends_after_its_task_or_at_a_given_time() {
        let words = |end, left: Option<u64>| JobStep { number: 2, of: 4, end }.words(left.map(Duration::from_secs));
        let after = JobEnd::After(Duration::from_secs(60));
        assert_eq!((words(after, Some(60)).as_str(), words(after, None).as_str()), (" (2 min for everything)", ""));
        assert_eq!(words(JobEnd::Unknown, Some(60)), "");
        assert_eq!(words(JobEnd::At(Instant::now()), None), " (0 s for everything)");
        assert_eq!(words(JobEnd::At(Instant::now()), Some(60)), " (60 s for everything)");
    }
}
