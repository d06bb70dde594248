//! Limits the work beside a training.

use std::fs;
use std::thread::available_parallelism;
use std::time::{Duration, Instant};

use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

/// Share of a training's time that may be spent.
const SHARE: f64 = 0.015;
/// Shortest interval at which a changed scene is made, seconds.
const MIN_INTERVAL: f64 = 2.0;

/// A bound on the time spent: after work that cost the training a second, nothing is made for 67 seconds.
#[derive(Debug)]
pub(super) struct Budget {
    free_at: Instant,
    /// One thread, so that the work leaves the training's threads alone and its processor time is known.
    thread: ThreadPool,
    num_processors: f64,
}

impl Budget {
    /// A budget that allows work at once, so that a new viewer sees something.
    ///
    /// # Errors
    /// If the system cannot start another thread.
    pub fn new() -> Result<Self, ThreadPoolBuildError> {
        let thread = ThreadPoolBuilder::new().num_threads(1).thread_name(|_| "view".into()).build()?;
        let num_processors = available_parallelism().map_or(1.0, |count| count.get() as f64);
        Ok(Self { free_at: Instant::now(), thread, num_processors })
    }

    pub fn allows(&self) -> bool {
        Instant::now() >= self.free_at
    }

    /// Does some work on one thread, and pays for it. The training has the other processors meanwhile, so it loses the
    /// processor time divided by their number.
    ///
    /// - `lost`: further seconds that the training has lost
    pub fn pay<T: Send>(&mut self, lost: f64, make: impl FnOnce() -> T + Send) -> T {
        let (made, seconds) = self.thread.install(|| {
            let begin = thread_seconds();
            let made = make();
            (made, thread_seconds() - begin)
        });
        self.spend(lost + seconds / self.num_processors);
        made
    }

    /// - `seconds`: that the training has lost
    fn spend(&mut self, seconds: f64) {
        self.free_at = Instant::now() + Duration::from_secs_f64((seconds / SHARE).max(MIN_INTERVAL));
    }
}

/// Processor time of this thread so far, seconds. Systems other than Linux do not tell it; the wall-clock time, which
/// is longer, stands in.
fn thread_seconds() -> f64 {
    let told = fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    static BEGIN: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
    nanoseconds.map_or_else(|| BEGIN.elapsed().as_secs_f64(), |nanoseconds| nanoseconds * 1e-9)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_took_long_is_not_made_again_soon() {
        let mut budget = Budget::new().unwrap();
        assert!(budget.allows());
        assert_eq!(budget.pay(0.0, || 7), 7);
        assert!(!budget.allows(), "twice at once");
        let wait = |budget: &Budget| budget.free_at.saturating_duration_since(Instant::now()).as_secs_f64();
        assert!(wait(&budget) <= MIN_INTERVAL);
        budget.pay(3.0, || ());
        assert!((wait(&budget) - 200.0).abs() < 2.0, "{}", wait(&budget));
    }

    #[test]
    fn work_is_paid_by_its_processor_time() {
        let begin = thread_seconds();
        let mut sum = 0_u64;
        while thread_seconds() - begin < 0.05 {
            sum = (0..10_000).fold(sum, |sum: u64, i| sum.wrapping_mul(31).wrapping_add(i));
        }
        let (spent, clock) = (thread_seconds() - begin, Instant::now());
        assert!(std::hint::black_box(sum) > 0 && (0.05..1.0).contains(&spent), "{spent}");
        std::thread::sleep(Duration::from_millis(200));
        let slept = thread_seconds() - begin - spent;
        assert!(slept <= clock.elapsed().as_secs_f64() + 0.01, "{slept}");
        #[cfg(target_os = "linux")]
        assert!(slept < 0.1, "sleeping costs nothing: {slept}");
    }
}
