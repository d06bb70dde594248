//! How long the stages of one computation took, for those who measure.

use std::time::Instant;

/// Milliseconds of each stage of one computation, in the order in which they ran.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StageTimes {
    /// By name.
    pub stages: Vec<(&'static str, f64)>,
    /// From the first stage's begin to the last one's end: more than their sum where time passes between them.
    pub total: f64,
}

/// Names of the stages of drawing and its gradient; every renderer has these.
pub const RENDER_STAGES: [&str; 5] = ["project", "sort", "rasterize", "rasterize backward", "project backward"];

/// A clock of the CPU, read where one stage ends and the next begins.
#[derive(Clone, Debug)]
pub struct Laps {
    begin: Instant,
    last: Instant,
    stages: Vec<(&'static str, f64)>,
}

impl Laps {
    /// Begins the first stage.
    pub fn begin() -> Self {
        let now = Instant::now();
        Self { begin: now, last: now, stages: Vec::new() }
    }

    /// Ends a stage, and begins the next.
    pub fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        self.stages.push((stage, ms(now - self.last)));
        self.last = now;
    }

    /// The times so far.
    pub fn finish(self) -> StageTimes {
        StageTimes { stages: self.stages, total: ms(self.last - self.begin) }
    }
}

fn ms(duration: std::time::Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// How much there is to blend, which decides how long it takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PairCounts {
    /// Combinations of a tile and a splat that may reach it.
    pub pairs: usize,
    /// Splats that are in at least one pair.
    pub splats: usize,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn laps_add_up() {
        let mut laps = Laps::begin();
        laps.lap("one");
        std::thread::sleep(std::time::Duration::from_millis(2));
        laps.lap("two");
        let times = laps.finish();
        assert_eq!(times.stages.iter().map(|s| s.0).collect::<Vec<_>>(), ["one", "two"]);
        assert!(times.stages[1].1 >= 2.0);
        assert!((times.stages.iter().map(|s| s.1).sum::<f64>() - times.total).abs() < 1e-9);
    }
}
