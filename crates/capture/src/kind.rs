//! The description of one kind of capture as plain data. Each file of `kinds` holds the constant of one kind.

use std::path::Path;

use crate::{CaptureError, contents::Contents};

/// One kind of capture: its name, the files by which a folder is recognised, how the folder is read, and the facts that
/// hold for every capture of the kind. Two kinds are equal if their names are.
///
/// The known kinds are associated constants; [`CaptureKind::ALL`] lists them.
///
/// ```
/// use tcgs_capture::CaptureKind;
/// assert_eq!(CaptureKind::named("panoptic"), Some(CaptureKind::PANOPTIC));
/// assert!(CaptureKind::PANOPTIC.facts.has_floor && !CaptureKind::COLMAP.facts.has_floor);
/// ```
#[derive(Clone, Copy)]
pub struct CaptureKind {
    /// Short lower-case name by which settings and messages name the kind, such as `neural3d`.
    pub name: &'static str,
    /// The files by which a folder of this kind is recognised, as error messages list them.
    pub mark: &'static str,
    /// Known facts about the axes, the unit and the labels of every capture of this kind.
    pub facts: CaptureFacts,
    /// Whether a folder is of this kind. The first kind of [`CaptureKind::ALL`] that recognises a folder opens it.
    pub(crate) recognises: fn(&Path) -> Result<bool, CaptureError>,
    /// Reads cameras, names of images and masks, and the place of the points; decodes no image.
    pub(crate) open: fn(&Path) -> Result<Contents, CaptureError>,
}

/// Facts about a capture's world and labels beyond its images, cameras and points. By default nothing is known.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct CaptureFacts {
    /// Whether the world's `y` axis points down and the floor is the plane `y = 0`.
    pub has_floor: bool,
    /// Whether the scene unit is the metre.
    pub in_metres: bool,
    /// Whether the foreground of the point labels, and of the masks if there are any, is what moves.
    pub labels_motion: bool,
}

impl CaptureKind {
    /// The kind of captures that a [`CaptureBuilder`](crate::CaptureBuilder) makes. No folder is of this kind, and
    /// [`CaptureKind::ALL`] does not contain it.
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
