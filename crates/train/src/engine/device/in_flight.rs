//! Iterations submitted to a device and not yet known to be done.
//!
//! A device writes the losses of an iteration to a slot of a ring. A report of the whole ring travels to the host while
//! later iterations run. The type mirrors this path. An iteration belongs to the open batch until the host asks for
//! that batch's report, then to the reported batch, and to none after the report was read. If a report says that the
//! device has halted, [`InFlight::halt`] returns all iterations from there on.

use std::collections::VecDeque;

/// Iterations whose losses travel in one report.
#[derive(Debug)]
pub(crate) struct Batch<S, R> {
    /// In the order in which they were submitted; the position is the slot of the ring.
    pub steps: Vec<S>,
    /// Their losses on the way to the host.
    pub report: R,
}

/// All iterations under way. `S` is the request of an iteration, `R` a report on its way.
#[derive(Debug)]
pub(crate) struct InFlight<S, R> {
    /// Slots of the ring.
    slots: usize,
    /// Iterations that were submitted and are in no report yet.
    open: Vec<S>,
    /// Batches whose reports are on their way, oldest first.
    reported: VecDeque<Batch<S, R>>,
}

impl<S, R> InFlight<S, R> {
    /// - `slots`: of the ring, at least 1
    pub fn new(slots: usize) -> Self {
        Self { slots, open: Vec::new(), reported: VecDeque::new() }
    }

    /// The slot to which the next iteration writes its losses.
    pub fn slot(&self) -> usize {
        self.open.len()
    }

    /// Records a submitted iteration.
    ///
    /// - returns: whether the ring is full, so that a report must be requested before the next iteration
    pub fn submitted(&mut self, step: S) -> bool {
        self.open.push(step);
        self.open.len() == self.slots
    }

    /// Records the report of the open batch.
    ///
    /// # Panics
    /// If there is no open batch.
    pub fn reported(&mut self, report: R) {
        assert!(!self.open.is_empty(), "a report of no iteration");
        self.reported.push_back(Batch { steps: std::mem::take(&mut self.open), report });
    }

    /// Whether iterations are under way whose report was not requested.
    pub fn has_open(&self) -> bool {
        !self.open.is_empty()
    }

    /// Whether nothing is under way.
    pub fn is_empty(&self) -> bool {
        self.open.is_empty() && self.reported.is_empty()
    }

    /// Reports on their way.
    pub fn num_reports(&self) -> usize {
        self.reported.len()
    }

    /// The report that arrives next.
    pub fn oldest(&self) -> Option<&R> {
        self.reported.front().map(|batch| &batch.report)
    }

    /// The oldest batch, if its report has arrived. Its iterations are no longer under way.
    pub fn arrived(&mut self, is_ready: impl FnOnce(&R) -> bool) -> Option<Batch<S, R>> {
        if self.oldest().is_some_and(is_ready) { self.reported.pop_front() } else { None }
    }

    /// Empties the queue after the device has halted. The device has made no lasting change since.
    ///
    /// - `from`: iterations of the batch whose report told of the halt, starting with the one at which the device
    ///   halted
    /// - returns: all iterations to submit again, in order
    pub fn halt(&mut self, from: impl IntoIterator<Item = S>) -> Vec<S> {
        let later = self.reported.drain(..).flat_map(|batch| batch.steps).chain(self.open.drain(..));
        from.into_iter().chain(later).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_ring_asks_for_a_report() {
        let mut flight = InFlight::new(3);
        assert!(flight.is_empty());
        for turn in 0..2 {
            let full: Vec<bool> = (0..3).map(|i| flight.submitted(3 * turn + i)).collect();
            assert_eq!((full, flight.slot()), (vec![false, false, true], 3));
            flight.reported(turn);
            assert_eq!((flight.slot(), flight.has_open(), flight.num_reports()), (0, false, turn + 1));
        }
        assert!(flight.arrived(|_| false).is_none());
        let batch = flight.arrived(|&report| report == 0).unwrap();
        assert_eq!((batch.steps, batch.report, flight.oldest()), (vec![0, 1, 2], 0, Some(&1)));
        assert!(!flight.is_empty());
    }

    #[test]
    fn a_halt_gives_back_everything_from_there_on() {
        let mut flight = InFlight::new(2);
        for step in 0..7 {
            if flight.submitted(step) {
                flight.reported(());
            }
        }
        let batch = flight.arrived(|()| true).unwrap();
        assert_eq!(batch.steps, [0, 1]);
        // The second iteration of that batch halted.
        assert_eq!(flight.halt(batch.steps.into_iter().skip(1)), [1, 2, 3, 4, 5, 6]);
        assert!(flight.is_empty() && flight.slot() == 0);
    }

    #[test]
    #[should_panic(expected = "a report of no iteration")]
    fn there_is_something_to_report() {
        InFlight::<(), ()>::new(2).reported(());
    }
}
