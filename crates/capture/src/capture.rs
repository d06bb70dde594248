//! A capture, whatever its layout on disk.

use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tcgs_core::{Camera, PointCloud, View};

use crate::{CaptureError, CaptureKind, kind, points, shot::Shot, sight};

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
    /// Those that publications use.
    pub(crate) usual_frames: Range<usize>,
    /// `[T][C]`, `C` may change with time.
    pub(crate) train: Vec<Vec<Shot>>,
    /// `[T][C]`, `C` may be 0.
    pub(crate) test: Vec<Vec<Shot>>,
    pub(crate) has_segmentation: bool,
    /// What says where the cameras of `train` and `test` stand.
    pub(crate) cameras_files: [PathBuf; 2],
    pub(crate) points: Option<PathBuf>,
}

impl Capture {
    /// Opens the capture in a folder: recognises its layout, reads and checks all but the images, and that
    /// those exist. Initial points may be missing, since not all that is done with a capture needs them.
    ///
    /// # Errors
    /// [`CaptureError`] names the first file that is missing or wrong; if no layout fits, what was looked for.
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        let capture = kind::open(path)?;
        capture.check_sight()?;
        Ok(capture)
    }

    /// [`Self::open`] that does not ask whether the cameras see the points: to make new points, or to find out
    /// what is wrong with the cameras.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_unseen(path: &Path) -> Result<Self, CaptureError> {
        kind::open(path)
    }

    /// The same capture with the points of another file: `.npz` as Dynamic 3D Gaussians has it, `.ply`, or
    /// `points3D.bin` or `.txt` of a COLMAP model, or that model's folder.
    ///
    /// # Errors
    /// If they cannot be read, or most cameras do not see them.
    pub fn with_points(mut self, path: &Path) -> Result<Self, CaptureError> {
        self.points = Some(path.into());
        self.check_sight()?;
        Ok(self)
    }

    /// Do the cameras see the points?
    fn check_sight(&self) -> Result<(), CaptureError> {
        let Some(points) = &self.points else { return Ok(()) };
        let cloud = points::read(points)?;
        for (shots, file) in [&self.train[0], &self.test[0]].into_iter().zip(&self.cameras_files) {
            let cameras: Vec<&Camera> = shots.iter().map(|shot| &shot.camera).collect();
            sight::check(&cameras, &cloud).map_err(|problem| CaptureError::invalid(file, problem))?;
        }
        Ok(())
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

    /// The frames that publications use; all, where they have not agreed on fewer.
    pub fn usual_frames(&self) -> Range<usize> {
        self.usual_frames.clone()
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

    /// The points that training starts from.
    ///
    /// # Errors
    /// If there are none, or the file cannot be read or has no or broken points.
    pub fn point_cloud(&self) -> Result<PointCloud, CaptureError> {
        match &self.points {
            Some(points) => points::read(points),
            None => Err(CaptureError::NoPoints { path: self.path.clone() }),
        }
    }

    /// Whether there are points to start from.
    pub fn has_points(&self) -> bool {
        self.points.is_some()
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
