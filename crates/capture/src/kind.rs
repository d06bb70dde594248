//! What a kind of capture is: plain data, one constant for each kind, in `kinds`.

use std::path::Path;

use crate::{CaptureError, contents::Contents};

/// How a capture lies on disk, how it is recognised and opened, and what holds of every capture of this kind.
///
/// The kinds that are known are associated constants, and [`CaptureKind::ALL`] lists them.
///
/// ```
/// use tcgs_capture::CaptureKind;
/// assert_eq!(CaptureKind::named("panoptic"), Some(CaptureKind::PANOPTIC));
/// assert!(CaptureKind::PANOPTIC.facts.has_floor && !CaptureKind::COLMAP.facts.has_floor);
/// ```
#[derive(Clone, Copy)]
pub struct CaptureKind {
    /// A short name, as settings hold it.
    pub name: &'static str,
    /// What a folder of this kind has, for messages.
    pub mark: &'static str,
    /// What holds of every capture of this kind.
    pub facts: CaptureFacts,
    /// Whether a folder is of this kind. The first kind of the list that says so counts.
    pub(crate) recognises: fn(&Path) -> Result<bool, CaptureError>,
    /// Reads all but images and points.
    pub(crate) open: fn(&Path) -> Result<Contents, CaptureError>,
}

/// What else is known of a capture than its images, cameras and points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CaptureFacts {
    /// Whether the world's `y` points down and its floor is the plane `y = 0`.
    pub has_floor: bool,
    /// Whether the scene unit is the metre.
    pub in_metres: bool,
    /// Whether the labels of the points, and the masks where there are any, say what moves.
    pub labels_motion: bool,
}

impl CaptureKind {
    /// Not a folder: a capture that a program put together with a [`CaptureBuilder`](crate::CaptureBuilder). Not one of
    /// [`CaptureKind::ALL`].
    pub const BUILT: Self = Self {
        name: "built",
        mark: "nothing",
        facts: CaptureFacts { has_floor: false, in_metres: false, labels_motion: false },
        recognises: |_| Ok(false),
        open: |path| Err(CaptureError::invalid(path, "is not a folder of a capture")),
    };
}

impl PartialEq for CaptureKind {
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}

impl Eq for CaptureKind {}

impl std::fmt::Debug for CaptureKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("CaptureKind").field(&self.name).finish()
    }
}
