//! A capture, whatever its kind: what it says of itself, and its views frame by frame.

use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tcgs_core::{Camera, PointCloud, View};

use crate::contents::{CameraSet, Contents};
use crate::footage::Footage;
use crate::kind::{CaptureFacts, CaptureKind};
use crate::points::{self, Points};
use crate::{CaptureError, kinds, points_in_view};

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

/// A multi-view capture: cameras, frames, points, and where the images are. Images are decoded when they are asked for.
///
/// Cheap to keep: file names that follow a pattern, and cameras that stand still, are held once for all frames. A
/// folder becomes one by [`Capture::open`], what a program has itself by [`CaptureBuilder`](crate::CaptureBuilder).
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
    /// Its folder; of a capture that a program put together its name.
    pub(crate) path: PathBuf,
    kind: CaptureKind,
    facts: CaptureFacts,
    contents: Contents,
    has_segmentation: bool,
}

impl Capture {
    /// Opens the capture in a folder: recognises its kind, and reads and checks all but the images.
    ///
    /// - `path`: the folder
    ///
    /// What is checked now: that cameras are cameras, that all images exist (every folder of images is listed once),
    /// that masks exist for all training images or for none, and that most cameras see the points. What is checked when
    /// [`views`](Self::views) decodes a frame: that its images and masks are whole and of their cameras' size. Initial
    /// points may be missing, since not all that is done with a capture needs them.
    ///
    /// # Errors
    /// [`CaptureError`] names the first file that is missing or wrong; if the folder is of no known kind, what was
    /// looked for.
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        let capture = Self::open_unseen(path)?;
        capture.check_sight()?;
        Ok(capture)
    }

    /// [`Self::open`] without the check that cameras see the points: to make new points, or to find out what is wrong
    /// with the cameras.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_unseen(path: &Path) -> Result<Self, CaptureError> {
        let (kind, contents) = kinds::open(path)?;
        Ok(Self::of_contents(path.into(), kind, kind.facts, contents))
    }

    pub(crate) fn of_contents(path: PathBuf, kind: CaptureKind, facts: CaptureFacts, contents: Contents) -> Self {
        let has_segmentation = contents.train.has_masks(contents.num_frames);
        Self { path, kind, facts, contents, has_segmentation }
    }

    /// The same capture with the points of another file.
    ///
    /// - `path`: `.npz` as Dynamic 3D Gaussians has it, `.ply`, or `points3D.bin` or `.txt` of a COLMAP model, or that
    ///   model's folder
    ///
    /// # Errors
    /// If the points cannot be read, or most cameras do not see them.
    pub fn with_points(mut self, path: &Path) -> Result<Self, CaptureError> {
        self.contents.points = Some(Points::File(path.into()));
        self.check_sight()?;
        Ok(self)
    }

    /// Do the cameras see the points?
    pub(crate) fn check_sight(&self) -> Result<(), CaptureError> {
        if !self.has_points() {
            return Ok(());
        }
        let cloud = self.point_cloud()?;
        let Contents { train, test, cameras_files, .. } = &self.contents;
        for (set, file) in [train, test].into_iter().zip(cameras_files) {
            let cameras: Vec<&Camera> = set.at(0).map(|footage| footage.camera(0)).collect();
            points_in_view::check(&cameras, &cloud).map_err(|problem| CaptureError::invalid(file, problem))?;
        }
        Ok(())
    }

    /// The kind of its folder, or [`CaptureKind::BUILT`].
    pub fn kind(&self) -> CaptureKind {
        self.kind
    }

    /// What is known of it besides images, cameras and points: of a folder what holds of its kind.
    pub fn facts(&self) -> CaptureFacts {
        self.facts
    }

    /// Name of its folder, or the name that a program gave it.
    pub fn name(&self) -> String {
        // A path such as `.` has no name of its own.
        if self.kind == CaptureKind::BUILT {
            return self.path.display().to_string();
        }
        let path = self.path.canonicalize().unwrap_or_else(|_| self.path.clone());
        path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// Number of frames, which are numbered from 0.
    pub fn num_frames(&self) -> usize {
        self.contents.num_frames
    }

    /// The frames that publications use; all, where they have not agreed on fewer.
    pub fn usual_frames(&self) -> Range<usize> {
        self.contents.usual_frames.clone()
    }

    /// Frames a second.
    pub fn frame_rate(&self) -> f64 {
        self.contents.frame_rate
    }

    /// Whether every image of the training cameras has a mask.
    pub fn has_segmentation(&self) -> bool {
        self.has_segmentation
    }

    /// Id and camera of all cameras of one frame, in the capture's order. Decodes nothing.
    ///
    /// - `frame`: from 0
    /// - `downscale`: factor by which the images will be made smaller, 1 to keep them
    ///
    /// # Errors
    /// If there is no such frame, or no pixel would remain.
    pub fn cameras(&self, split: Split, frame: usize, downscale: usize) -> Result<Vec<(usize, Camera)>, CaptureError> {
        let footage = self.footage(split, frame, downscale)?;
        Ok(footage.into_iter().map(|of| (of.camera_id, of.camera(frame).downscaled(downscale))).collect())
    }

    /// All views of one frame, decoded in parallel, in the capture's order.
    ///
    /// - `downscale`: images are averaged over that many pixels squared, masks by majority
    ///
    /// # Errors
    /// If there is no such frame, no pixel would remain, or an image cannot be decoded or has another
    /// size than the capture says.
    pub fn views(&self, split: Split, frame: usize, downscale: usize) -> Result<Vec<View>, CaptureError> {
        let footage = self.footage(split, frame, downscale)?;
        // Collected before the first error is looked for, so that it is always the same one.
        let views: Vec<_> = footage.par_iter().map(|of| of.view(frame, downscale)).collect();
        views.into_iter().collect()
    }

    /// The points that training starts from.
    ///
    /// # Errors
    /// If there are none, or the file cannot be read or has no or broken points.
    pub fn point_cloud(&self) -> Result<PointCloud, CaptureError> {
        match &self.contents.points {
            Some(Points::File(file)) => points::read(file),
            Some(Points::InMemory(cloud)) => Ok(PointCloud::clone(cloud)),
            None => Err(CaptureError::NoPoints { path: self.path.clone() }),
        }
    }

    /// Whether there are points to start from.
    pub fn has_points(&self) -> bool {
        self.contents.points.is_some()
    }

    fn footage(&self, split: Split, frame: usize, downscale: usize) -> Result<Vec<&Footage>, CaptureError> {
        let (path, num_frames) = (self.path.clone(), self.num_frames());
        if frame >= num_frames {
            return Err(CaptureError::NoFrame { path, frame, num_frames });
        }
        let Contents { train, test, .. } = &self.contents;
        let sets: &[&CameraSet] = match split {
            Split::Train => &[train],
            Split::Test => &[test],
            Split::All => &[train, test],
        };
        let footage: Vec<&Footage> = sets.iter().flat_map(|set| set.at(frame)).collect();
        let too_small = |camera: &&Camera| downscale == 0 || downscale > camera.width.min(camera.height);
        match footage.iter().map(|of| of.camera(frame)).find(too_small) {
            Some(&Camera { width, height, .. }) => Err(CaptureError::Downscale { path, downscale, width, height }),
            None => Ok(footage),
        }
    }
}
