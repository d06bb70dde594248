//! How many iterations a timestep gets: as many as its losses go on falling.
//!
//! A timestep has settled when its losses fall, over a pass through the views, by less than a share of the greatest
//! fall. The schedule then goes on faster instead of ending, so that learning rates still come down.

use crate::config::GateConfig;

/// Fewest iterations over which losses are averaged. A whole number of passes through the views, since the loss depends
/// on the view.
const MIN_STRETCH: usize = 20;
/// How many times as fast a timestep goes through the rest of its schedule once its losses have settled.
pub(crate) const SETTLED_PACE: f64 = 3.0;

/// Progress of one timestep through its schedule: one place per iteration, and several once its losses have settled, so
/// that the learning rates still come down.
#[derive(Clone, Debug)]
pub(crate) struct Pace {
    settle: f64,
    faster: f64,
    /// Places in the schedule.
    length: usize,
    position: f64,
    is_settled: bool,
    /// Iterations that losses are averaged over.
    stretch: usize,
    /// Sum of the losses of the stretch under way, and its iterations.
    sum: (f64, usize),
    /// Mean loss of each finished stretch.
    means: Vec<f64>,
    /// Iterations begun.
    begun: usize,
}

impl Pace {
    /// - `length`: iterations of a timestep that does not settle
    /// - `views`: number of views that the iterations go round
    pub fn new(config: &GateConfig, length: usize, views: usize) -> Self {
        let stretch = views * MIN_STRETCH.div_ceil(views.max(1));
        Self {
            settle: config.settle.into(),
            faster: SETTLED_PACE,
            length,
            position: 0.0,
            is_settled: false,
            stretch,
            sum: (0.0, 0),
            means: Vec::new(),
            begun: 0,
        }
    }

    /// The pace of a timestep that takes all of its iterations.
    pub fn even(length: usize, views: usize) -> Self {
        Self { faster: 1.0, ..Self::new(&GateConfig::OFF, length, views) }
    }

    /// Iterations of the timestep if it does not settle.
    pub fn length(&self) -> usize {
        self.length
    }

    /// Iterations begun so far.
    pub fn begun(&self) -> usize {
        self.begun
    }

    /// The place in the schedule of the next iteration; none if the timestep is at its end.
    pub fn next(&mut self) -> Option<usize> {
        let place = self.position as usize;
        if place >= self.length {
            return None;
        }
        self.position += if self.is_settled { self.faster } else { 1.0 };
        self.begun += 1;
        Some(place)
    }

    /// Whether a decision is due. [`Self::decide`] looks at the last stretch but one, so that an engine may still be
    /// computing the last one.
    pub fn is_decision_due(&self) -> bool {
        !self.is_settled
            && self.faster > 1.0
            && self.begun.is_multiple_of(self.stretch)
            && self.begun >= 4 * self.stretch
    }

    /// Takes the loss of an iteration; iterations come in order.
    pub fn hear(&mut self, loss: f64) {
        self.sum = (self.sum.0 + loss, self.sum.1 + 1);
        if self.sum.1 == self.stretch {
            self.means.push(self.sum.0 / self.stretch as f64);
            self.sum = (0.0, 0);
        }
    }

    /// Whether all losses that a decision needs are known.
    pub fn can_decide(&self) -> bool {
        self.means.len() + 1 >= self.begun / self.stretch
    }

    /// Decides from the stretches up to the last but one whether the losses have settled.
    pub fn decide(&mut self) {
        let last = self.begun / self.stretch - 2;
        let falls = self.means[..=last].windows(2).map(|means| means[0] - means[1]);
        let fall = self.means[last - 1] - self.means[last];
        self.is_settled = fall <= self.settle * falls.fold(0.0, f64::max);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Number of iterations that a timestep takes whose losses are `loss`.
    fn iterations(loss: impl Fn(usize) -> f64, delay: usize) -> usize {
        let mut pace = Pace::new(&GateConfig::ON, 300, 10);
        let (mut begun, mut heard) = (0, 0);
        while pace.next().is_some() {
            begun += 1;
            while heard + delay < begun || (pace.is_decision_due() && !pace.can_decide()) {
                pace.hear(loss(heard));
                heard += 1;
            }
            if pace.is_decision_due() {
                pace.decide();
            }
        }
        begun
    }

    #[test]
    fn a_timestep_ends_early_once_its_losses_have_settled() {
        let falls = |rate: f64| move |i: usize| 1.0 + (-(i as f64) * rate).exp() + 0.1 * (i % 10) as f64;
        assert_eq!(iterations(falls(0.002), 0), 300);
        let (fast, slower) = (iterations(falls(0.08), 0), iterations(falls(0.02), 0));
        assert!(fast < slower && slower < 300, "{fast}, {slower}");
        // An engine that reports late takes the same path.
        assert_eq!(iterations(falls(0.02), 15), slower);
        // The earliest decision is after four passes of twenty.
        assert_eq!(iterations(|_| 1.0, 0), 80 + 220_usize.div_ceil(3));
    }
}
