//! The known kinds of captures: one file per kind, with the kind's constant, its recognition and its reader.
//!
//! A new kind is one file with a constant, and one line in [`CaptureKind::ALL`].

mod colmap;
mod described;
mod middlebury;
mod nerfstudio;
mod neural3d;
mod panoptic;
mod panoptic_meta;
mod technicolor;
mod test_cameras;

use std::path::Path;

pub use described::MASKS_FOLDER;
pub(crate) use nerfstudio::{
    Frame as NerfstudioFrame, Intrinsics as NerfstudioIntrinsics, Transforms as NerfstudioTransforms,
    camera_from_world as camera_from_nerfstudio, read as read_transforms,
};

use crate::{CaptureError, contents::Contents, files, kind::CaptureKind};

impl CaptureKind {
    /// All kinds of folders, in the order in which [`Capture::open`](crate::Capture::open) tries them.
    pub const ALL: [Self; 7] = [
        Self::DESCRIBED,
        Self::PANOPTIC,
        Self::NEURAL3D,
        Self::TECHNICOLOR,
        Self::NERFSTUDIO,
        Self::COLMAP,
        Self::MIDDLEBURY,
    ];

    /// The kind whose [`name`](Self::name) is `name`; `None` if [`Self::ALL`] has no such kind.
    ///
    /// ```
    /// use tcgs_capture::CaptureKind;
    /// assert_eq!(CaptureKind::named("neural3d"), Some(CaptureKind::NEURAL3D));
    /// assert_eq!(CaptureKind::named("a hologram"), None);
    /// ```
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name == name)
    }

    /// The first kind of [`Self::ALL`] that recognises a folder by its files; `None` if none does.
    ///
    /// # Errors
    /// [`CaptureError`] if a file that tells kinds apart cannot be read.
    pub fn of(path: &Path) -> Result<Option<Self>, CaptureError> {
        for kind in Self::ALL {
            if (kind.recognises)(path)? {
                return Ok(Some(kind));
            }
        }
        Ok(None)
    }
}

/// Recognises a folder's kind and reads its contents.
pub(crate) fn open(path: &Path) -> Result<(CaptureKind, Contents), CaptureError> {
    let not_capture = |problem: &str| CaptureError::NotCapture {
        path: path.into(),
        problem: problem.into(),
        expected: CaptureKind::ALL.map(|kind| kind.mark).join(", "),
    };
    if !path.is_dir() {
        return Err(not_capture(if path.exists() { "is a file" } else { "no such folder" }));
    }
    // This names a folder that cannot be listed.
    files::list(path)?;
    let kind = CaptureKind::of(path)?.ok_or_else(|| not_capture("has no cameras"))?;
    Ok((kind, (kind.open)(path)?))
}
