//! The kinds of captures that are known: a file for each, with its constant.
//!
//! A new kind is a file with a constant and a line in [`CaptureKind::ALL`].

mod colmap;
mod middlebury;
mod nerfstudio;
mod neural3d;
mod panoptic;
mod panoptic_meta;
mod technicolor;
mod test_cameras;

use std::path::Path;

use crate::{CaptureError, contents::Contents, files, kind::CaptureKind};

impl CaptureKind {
    /// Every kind, in the order in which they are looked for.
    pub const ALL: [Self; 6] =
        [Self::PANOPTIC, Self::NEURAL3D, Self::TECHNICOLOR, Self::NERFSTUDIO, Self::COLMAP, Self::MIDDLEBURY];

    /// The kind of a short name, `None` if there is no such kind.
    ///
    /// ```
    /// use tcgs_capture::CaptureKind;
    /// assert_eq!(CaptureKind::named("neural3d"), Some(CaptureKind::NEURAL3D));
    /// assert_eq!(CaptureKind::named("a hologram"), None);
    /// ```
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name == name)
    }
}

/// Opens a folder as what it is.
pub(crate) fn open(path: &Path) -> Result<(CaptureKind, Contents), CaptureError> {
    let not_capture = |problem: &str| CaptureError::NotCapture {
        path: path.into(),
        problem: problem.into(),
        expected: CaptureKind::ALL.map(|kind| kind.mark).join(", "),
    };
    if !path.is_dir() {
        return Err(not_capture(if path.exists() { "is a file" } else { "no such folder" }));
    }
    // A folder that cannot be listed is named by this.
    files::list(path)?;
    for kind in CaptureKind::ALL {
        if (kind.recognises)(path)? {
            return Ok((kind, (kind.open)(path)?));
        }
    }
    Err(not_capture("has no cameras"))
}
