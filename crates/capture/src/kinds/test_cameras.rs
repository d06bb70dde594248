//! Test cameras of captures that do not name them.

use crate::contents::CameraSet;

/// One of so many cameras is a test camera, beginning with the first, as publications on scenes of COLMAP do.
pub(super) const TEST_STRIDE: usize = 8;

/// Training and test cameras of a capture of one frame. With fewer than eight cameras all are for training.
pub(super) fn every_eighth(all: CameraSet) -> [CameraSet; 2] {
    if all.footage.len() < TEST_STRIDE {
        return [all, CameraSet::constant(Vec::new())];
    }
    let (test, train): (Vec<_>, Vec<_>) = all.footage.into_iter().enumerate().partition(|(i, _)| i % TEST_STRIDE == 0);
    [train, test].map(|split| CameraSet::constant(split.into_iter().map(|(_, footage)| footage).collect()))
}
