//! Which cameras are for judging, where a layout does not say.

use crate::shot::Shot;

/// Of so many cameras one is for judging, beginning with the first: as publications on scenes of COLMAP do.
pub(crate) const TEST_STRIDE: usize = 8;

/// Frames a second of what does not move.
pub(crate) const STATIC_FRAME_RATE: f64 = 30.0;

/// Training and test cameras of one timestep. With fewer than eight all are for training.
pub(crate) fn every_eighth(shots: Vec<Shot>) -> (Vec<Shot>, Vec<Shot>) {
    if shots.len() < TEST_STRIDE {
        return (shots, Vec::new());
    }
    let (test, train): (Vec<_>, Vec<_>) = shots.into_iter().enumerate().partition(|(i, _)| i % TEST_STRIDE == 0);
    let shots = |of: Vec<(usize, Shot)>| of.into_iter().map(|(_, shot)| shot).collect();
    (shots(train), shots(test))
}
