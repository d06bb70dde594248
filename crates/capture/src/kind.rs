//! The layouts that are known, how each is recognised, and what its publications agree on.

use std::path::Path;

use crate::{Capture, CaptureError, colmap, files, middlebury, nerfstudio, neural3d, panoptic, technicolor};

/// How a capture lies on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CaptureKind {
    /// Panoptic Sports as prepared for Dynamic 3D Gaussians: a file an image.
    Panoptic,
    /// Neural 3D Video: a video a camera, poses as LLFF writes them.
    Neural3d,
    /// The light-field videos of Technicolor: a file an image.
    Technicolor,
    /// `transforms.json` of nerfstudio, with a time for each image if there are several timesteps.
    Nerfstudio,
    /// A COLMAP model and its images: one timestep.
    Colmap,
    /// Multi-view stereo sets of Middlebury: one timestep.
    Middlebury,
}

/// Every kind, in the order in which they are looked for.
pub(crate) const KINDS: [CaptureKind; 6] = [
    CaptureKind::Panoptic,
    CaptureKind::Neural3d,
    CaptureKind::Technicolor,
    CaptureKind::Nerfstudio,
    CaptureKind::Colmap,
    CaptureKind::Middlebury,
];

impl CaptureKind {
    /// A short name, as settings hold it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Panoptic => "panoptic",
            Self::Neural3d => "neural3d",
            Self::Technicolor => "technicolor",
            Self::Nerfstudio => "nerfstudio",
            Self::Colmap => "colmap",
            Self::Middlebury => "middlebury",
        }
    }

    /// The kind of a short name.
    ///
    /// ```
    /// use tcgs_capture::CaptureKind;
    /// assert_eq!(CaptureKind::named("neural3d"), Some(CaptureKind::Neural3d));
    /// ```
    pub fn named(name: &str) -> Option<Self> {
        KINDS.into_iter().find(|kind| kind.name() == name)
    }

    /// Whether the world's `y` points down and its floor is `y = 0`.
    pub fn has_floor(self) -> bool {
        self == Self::Panoptic
    }

    /// What a folder of this kind has, for messages.
    fn mark(self) -> &'static str {
        match self {
            Self::Panoptic => "train_meta.json (Panoptic Sports)",
            Self::Neural3d => "poses_bounds.npy with cam*.mp4 (Neural 3D Video)",
            Self::Technicolor => "cameras_parameters.txt (Technicolor)",
            Self::Nerfstudio => "transforms.json (nerfstudio)",
            Self::Colmap => "sparse/0/cameras.bin or .txt (COLMAP)",
            Self::Middlebury => "*_par.txt (Middlebury)",
        }
    }

    fn recognises(self, path: &Path) -> Result<bool, CaptureError> {
        let has = |name: &str| path.join(name).exists();
        Ok(match self {
            Self::Panoptic => has(panoptic::TRAIN_META),
            // Other programs leave poses beside a COLMAP model; without videos that is what counts.
            Self::Neural3d => {
                has(neural3d::POSES) && (neural3d::has_cameras(path)? || colmap::model_folder(path).is_none())
            }
            Self::Technicolor => has(technicolor::CAMERAS),
            Self::Nerfstudio => has(nerfstudio::TRANSFORMS),
            Self::Colmap => colmap::model_folder(path).is_some(),
            Self::Middlebury => middlebury::cameras_file(path)?.is_some(),
        })
    }

    fn open(self, path: &Path) -> Result<Capture, CaptureError> {
        match self {
            Self::Panoptic => panoptic::open(path),
            Self::Neural3d => neural3d::open(path),
            Self::Technicolor => technicolor::open(path),
            Self::Nerfstudio => nerfstudio::open(path),
            Self::Colmap => colmap::open(path),
            Self::Middlebury => middlebury::open(path),
        }
    }
}

/// Opens a folder as what it is.
pub(crate) fn open(path: &Path) -> Result<Capture, CaptureError> {
    let not_capture = |problem: String| CaptureError::NotCapture { path: path.into(), problem };
    if !path.is_dir() {
        return Err(not_capture(if path.exists() { "is a file".into() } else { "no such folder".into() }));
    }
    // A folder that cannot be listed is named by this.
    files::list(path)?;
    for kind in KINDS {
        if kind.recognises(path)? {
            return kind.open(path);
        }
    }
    Err(not_capture("has no cameras".into()))
}

/// The marks of all kinds, for messages.
pub(crate) fn marks() -> String {
    KINDS.map(CaptureKind::mark).join(", ")
}
