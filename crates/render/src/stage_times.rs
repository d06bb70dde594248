//! Times of the stages of one computation, for measurements.

use std::time::Instant;

/// Milliseconds of each stage of one computation, in the order in which they ran.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StageTimes {
    /// Name and milliseconds of each stage.
    pub stages: Vec<(&'static str, f64)>,
    /// Milliseconds from the start of the first stage to the end of the last. It exceeds the sum of the stages if time
    /// passes between them.
    pub total: f64,
}

/// Names of the stages of drawing and its gradient, the same for every renderer.
pub const RENDER_STAGES: [&str; 5] = ["project", "sort", "rasterize", "rasterize backward", "project backward"];

/// A stopwatch on the CPU, read between stages.
///
/// ```
/// use tcgs_render::Laps;
/// let mut laps = Laps::begin();
/// laps.lap("project");
/// laps.lap("sort");
/// assert_eq!(laps.finish().stages.len(), 2);
/// ```
#[derive(Clone, Debug)]
pub struct Laps {
    begin: Instant,
    last: Instant,
    stages: Vec<(&'static str, f64)>,
}

impl Laps {
    /// Starts the stopwatch: the first stage begins.
    pub fn begin() -> Self {
        let now = Instant::now();
        Self { begin: now, last: now, stages: Vec::new() }
    }

    /// Ends the running stage, gives it a name, and begins the next.
    pub fn lap(&mut self, stage: &'static str) {
        let now = Instant::now();
        self.stages.push((stage, ms(now - self.last)));
        self.last = now;
    }

    /// The stages that ended, in their order.
    pub fn finish(self) -> StageTimes {
        StageTimes { stages: self.stages, total: ms(self.last - self.begin) }
    }
}

fn ms(duration: std::time::Duration) -> f64 {
    duration.as_secs_f64() * 1e3
}

/// Numbers of pairs and splats in an image, which determine the drawing time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PairCounts {
    /// Pairs of a tile and a splat that may reach it.
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
