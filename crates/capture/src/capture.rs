//! A capture, whatever its layout on disk.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tcgs_core::{Camera, PointCloud, View};

use crate::{CaptureError, decode, panoptic, points};

/// How a capture lies on disk.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum CaptureKind {
    /// Panoptic Sports as prepared for Dynamic 3D Gaussians: a file an image.
    Panoptic,
}

/// Which cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Those to learn from.
    Train,
    /// Those held out for judging.
    Test,
    /// First those of `Train`, then those of `Test`.
    All,
}

/// A multi-view capture: what is known of it without decoding an image.
///
/// ```
/// use tcgs_capture::{Capture, Split, SyntheticSettings, write_synthetic};
/// let folder = tempfile::tempdir()?;
/// let tiny = SyntheticSettings { width: 16, height: 12, num_timesteps: 2, num_points: 500, ..Default::default() };
/// write_synthetic(folder.path(), &tiny)?;
///
/// let capture = Capture::open(folder.path())?;
/// let views = capture.views(Split::Train, 1, 2)?;
/// assert_eq!((capture.num_frames(), views.len(), views[0].image.width), (2, 12, 8));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Capture {
    pub(crate) path: PathBuf,
    pub(crate) kind: CaptureKind,
    /// Frames a second.
    pub(crate) frame_rate: f64,
    /// `[T][C]`, `C` may change with time.
    pub(crate) train: Vec<Vec<Shot>>,
    /// `[T][C]`, `C` may be 0.
    pub(crate) test: Vec<Vec<Shot>>,
    pub(crate) has_segmentation: bool,
}

/// One image still on disk.
#[derive(Clone, Debug)]
pub(crate) struct Shot {
    pub camera_id: usize,
    pub camera: Camera,
    pub image: PathBuf,
    pub mask: Option<PathBuf>,
}

impl Capture {
    /// Opens the capture in a folder: reads and checks all but the images, and that those exist.
    ///
    /// # Errors
    /// [`CaptureError`] names the first file that is missing or wrong.
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        panoptic::open(path)
    }

    /// [`Self::open`] for a capture that may lack initial points, and of which nobody checks whether cameras
    /// look at them.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_without_points(path: &Path) -> Result<Self, CaptureError> {
        panoptic::open_without_points(path)
    }

    /// How it lies on disk.
    pub fn kind(&self) -> CaptureKind {
        self.kind
    }

    /// Name of its folder.
    pub fn name(&self) -> String {
        // A path such as `.` has no name of its own.
        let path = self.path.canonicalize().unwrap_or_else(|_| self.path.clone());
        path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// Frames, numbered from 0.
    pub fn num_frames(&self) -> usize {
        self.train.len()
    }

    /// Frames a second.
    pub fn frame_rate(&self) -> f64 {
        self.frame_rate
    }

    /// Whether every image of the training cameras has a mask.
    pub fn has_segmentation(&self) -> bool {
        self.has_segmentation
    }

    /// Id and camera of one frame, in the capture's order.
    ///
    /// - `downscale`: factor by which the images will be made smaller, 1 to keep them
    ///
    /// # Errors
    /// If there is no such frame, or no pixel would remain.
    pub fn cameras(&self, split: Split, frame: usize, downscale: usize) -> Result<Vec<(usize, Camera)>, CaptureError> {
        let shots = self.shots(split, frame, downscale)?;
        Ok(shots.into_iter().map(|shot| (shot.camera_id, shot.camera.downscaled(downscale))).collect())
    }

    /// All views of one frame, decoded in parallel, in the capture's order.
    ///
    /// - `downscale`: images are averaged over that many pixels squared, masks by majority
    ///
    /// # Errors
    /// If there is no such frame, no pixel would remain, or an image cannot be decoded or has another
    /// size than the capture says.
    pub fn views(&self, split: Split, frame: usize, downscale: usize) -> Result<Vec<View>, CaptureError> {
        let shots = self.shots(split, frame, downscale)?;
        // Collected before the first error is looked for, so that it is always the same one.
        let views: Vec<_> = shots.par_iter().map(|shot| shot.view(frame, downscale)).collect();
        views.into_iter().collect()
    }

    /// Whether there are points to start from.
    pub fn has_points(&self) -> bool {
        self.path.join(panoptic::POINTS).exists()
    }

    /// The points that training starts from.
    ///
    /// # Errors
    /// If the file cannot be read or has no or broken points.
    pub fn point_cloud(&self) -> Result<PointCloud, CaptureError> {
        points::read(&self.path.join(panoptic::POINTS))
    }

    fn shots(&self, split: Split, frame: usize, downscale: usize) -> Result<Vec<&Shot>, CaptureError> {
        let (path, num_frames) = (self.path.clone(), self.num_frames());
        if frame >= num_frames {
            return Err(CaptureError::NoFrame { path, frame, num_frames });
        }
        let (train, test) = (self.train[frame].iter(), self.test[frame].iter());
        let shots: Vec<&Shot> = match split {
            Split::Train => train.collect(),
            Split::Test => test.collect(),
            Split::All => train.chain(test).collect(),
        };
        let too_small = |shot: &&Shot| downscale == 0 || downscale > shot.camera.width.min(shot.camera.height);
        match shots.iter().copied().find(too_small) {
            Some(Shot { camera, .. }) => {
                Err(CaptureError::Downscale { path, downscale, width: camera.width, height: camera.height })
            }
            None => Ok(shots),
        }
    }
}

impl Shot {
    fn view(&self, frame: usize, downscale: usize) -> Result<View, CaptureError> {
        let size = (self.camera.width, self.camera.height);
        let image = decode::image(&self.image, size)?;
        let segmentation = self.mask.as_ref().map(|mask| decode::mask(mask, size)).transpose()?;
        let (camera, camera_id) = (self.camera.clone(), self.camera_id);
        let view = View { camera, image, segmentation, frame, camera_id };
        if downscale == 1 {
            return Ok(view);
        }
        Ok(View {
            camera: view.camera.downscaled(downscale),
            image: view.image.downscaled(downscale),
            segmentation: view.segmentation.map(|mask| mask.downscaled(downscale)),
            ..view
        })
    }
}
