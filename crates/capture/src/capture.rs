//! A capture of any kind: its properties, its cameras and points, and its views frame by frame.
//!
//! What lives here: the questions that an open capture answers. What does not: reading the folder of each kind
//! (`kinds`), and turning one camera's images into views (`footage`).

use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tcgs_core::{Camera, PointCloud, Trust, View};

use crate::contents::{CameraSet, Contents};
use crate::footage::{ByFrame, Footage};
use crate::kind::{CaptureFacts, CaptureKind};
use crate::points::{self, Points};
use crate::prepared::measured;
use crate::recording::ColorChange;
use crate::{CaptureError, Origin, kinds, points_in_view};

/// Least share of points with a measured depth for good pictures from between the cameras.
pub const MOSTLY_MEASURED: f64 = 0.5;
/// Largest angle between two cameras between which pictures are good. Stereo does not compare cameras that are much
/// farther apart.
pub const BETWEEN_DEGREES: f64 = 60.0;

/// Selects the training cameras, the test cameras, or both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// The cameras that training uses.
    Train,
    /// The cameras that are held out for evaluation.
    Test,
    /// The training cameras, followed by the test cameras.
    All,
}

/// A multi-view capture: cameras, frames, initial points, and the places of the images. An image is decoded only when
/// [`views`](Self::views) asks for its frame.
///
/// A capture takes little memory: file names that follow a pattern, and cameras that stand still, are stored once for
/// all frames. [`Capture::open`] makes a capture of a folder, [`CaptureBuilder`](crate::CaptureBuilder) makes one of
/// cameras and images that a program already has.
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
    /// The folder; for [`CaptureKind::BUILT`] the name that the program gave.
    path: PathBuf,
    kind: CaptureKind,
    facts: CaptureFacts,
    contents: Contents,
    has_segmentation: bool,
}

impl Capture {
    /// Opens the capture in a folder: recognises the folder's kind, and reads and checks everything but the images.
    ///
    /// - `path`: the folder
    ///
    /// `open` checks that the cameras' numbers are valid and that all images exist; it lists every folder of images
    /// once. It checks that masks exist for all training images or for none, and that most cameras see the points.
    /// [`views`](Self::views) checks that the images and masks of its frame are whole and of their cameras' size.
    /// Initial points may be missing: rendering and evaluation do not need them.
    ///
    /// # Errors
    /// [`CaptureError::NotCapture`] if the folder is of no known kind; the message lists the files that were looked
    /// for. Otherwise a [`CaptureError`] that names the first file that is missing or wrong.
    pub fn open(path: &Path) -> Result<Self, CaptureError> {
        let capture = Self::open_unseen(path)?;
        capture.check_sight()?;
        Ok(capture)
    }

    /// Opens the capture in a folder as [`Self::open`] does, without the check that most cameras see the points.
    /// Programs that make new points or examine the cameras call this.
    ///
    /// - `path`: the folder
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_unseen(path: &Path) -> Result<Self, CaptureError> {
        let (kind, contents) = kinds::open(path)?;
        if contents.num_frames == 0 {
            return Err(CaptureError::invalid(path, "has no frames, expected at least one"));
        }
        let mut capture = Self::of_contents(path.into(), kind, kind.facts, contents);
        // Masks beside `capture.toml` mark moving objects, docs/CAPTURE.md.
        capture.facts.labels_motion |= kind == CaptureKind::DESCRIBED && capture.has_segmentation;
        Ok(capture)
    }

    pub(crate) fn of_contents(path: PathBuf, kind: CaptureKind, facts: CaptureFacts, contents: Contents) -> Self {
        let has_segmentation = contents.train.has_masks(contents.num_frames);
        Self { path, kind, facts, contents, has_segmentation }
    }

    /// Replaces the initial points by those of another file.
    ///
    /// - `path`: `.npz` in the form of Dynamic 3D Gaussians, `.ply`, `points3D.bin` or `points3D.txt` of a COLMAP
    ///   model, or the model's folder
    ///
    /// # Errors
    /// [`CaptureError`] if the points cannot be read, or most cameras do not see them.
    pub fn with_points(mut self, path: &Path) -> Result<Self, CaptureError> {
        self.contents.points = Some(Points::File(path.into()));
        self.check_sight()?;
        Ok(self)
    }

    /// Checks that most cameras of each split see the points in the first frame. A capture without points passes.
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

    /// The folder; for a built capture the name given to [`CaptureBuilder::new`](crate::CaptureBuilder::new).
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The kind that the folder was recognised as; [`CaptureKind::BUILT`] for a capture made by a
    /// [`CaptureBuilder`](crate::CaptureBuilder).
    pub fn kind(&self) -> CaptureKind {
        self.kind
    }

    /// Known facts about the world's axes, the scene unit and the labels. A folder has the facts of its kind, a built
    /// capture those given to [`CaptureBuilder::facts`](crate::CaptureBuilder::facts).
    pub fn facts(&self) -> CaptureFacts {
        self.facts
    }

    /// The folder's name without the path; for a built capture the name given to
    /// [`CaptureBuilder::new`](crate::CaptureBuilder::new).
    pub fn name(&self) -> String {
        // A path such as `.` has no name of its own.
        if self.kind == CaptureKind::BUILT {
            return self.path.display().to_string();
        }
        let path = self.path.canonicalize().unwrap_or_else(|_| self.path.clone());
        path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
    }

    /// Number of frames, at least 1. Frames are numbered from 0.
    pub fn num_frames(&self) -> usize {
        self.contents.num_frames
    }

    /// The frames that publications on this data set train and evaluate on; all frames where there is no convention.
    pub fn usual_frames(&self) -> Range<usize> {
        self.contents.usual_frames.clone()
    }

    /// Frames per second, greater than 0.
    pub fn frame_rate(&self) -> f64 {
        self.contents.frame_rate.fps()
    }

    /// Whether every image of the training cameras, at every frame, has a foreground mask.
    pub fn has_segmentation(&self) -> bool {
        self.has_segmentation
    }

    /// The mask files of one frame, whether or not they exist.
    ///
    /// - `frame`: index of the frame, from 0
    /// - returns: camera id and file, in the order of [`Self::cameras`]; no file for captures that have no place for
    ///   masks
    ///
    /// # Errors
    /// [`CaptureError::NoFrame`] if the capture has no such frame.
    pub fn mask_files(&self, split: Split, frame: usize) -> Result<Vec<(usize, Option<PathBuf>)>, CaptureError> {
        let footage = self.footage(split, frame, 1)?;
        Ok(footage.into_iter().map(|of| (of.camera_id, of.masks.file(frame))).collect())
    }

    /// The cameras of one frame with their ids, in the capture's order. Decodes no image.
    ///
    /// - `frame`: index of the frame, from 0
    /// - `downscale`: factor by which width and height of the images are divided, at least 1
    /// - returns: camera id, and the camera with intrinsics and size for the downscaled image
    ///
    /// # Errors
    /// [`CaptureError::NoFrame`] if the capture has no such frame; [`CaptureError::Downscale`] if `downscale` is 0 or
    /// exceeds the width or height of an image.
    pub fn cameras(&self, split: Split, frame: usize, downscale: usize) -> Result<Vec<(usize, Camera)>, CaptureError> {
        let footage = self.footage(split, frame, downscale)?;
        Ok(footage.into_iter().map(|of| (of.camera_id, of.camera(frame).downscaled(downscale))).collect())
    }

    /// Decodes the images and masks of one frame, in parallel.
    ///
    /// - `frame`: index of the frame, from 0
    /// - `downscale`: side in pixels of the square blocks that become one pixel: the mean of an image's colours, the
    ///   majority of a mask's labels
    /// - returns: the views in the capture's order, images `[3, H, W]` in `[0, 1]`
    ///
    /// # Errors
    /// As [`Self::cameras`]; a [`CaptureError`] that names the file if an image or mask cannot be decoded or is not of
    /// its camera's size; [`CaptureError::Made`] if a closure that makes images fails.
    pub fn views(&self, split: Split, frame: usize, downscale: usize) -> Result<Vec<View>, CaptureError> {
        let footage = self.footage(split, frame, downscale)?;
        views_of(&footage, frame, downscale)
    }

    /// [`Self::views`] of some of the cameras; images of the others are not decoded.
    ///
    /// - `chosen`: by their place among the cameras of the split, below the number of [`Self::cameras`]
    /// - returns: in the order of `chosen`
    ///
    /// # Errors
    /// As [`Self::views`].
    ///
    /// # Panics
    /// If there is no such camera.
    pub fn some_views(
        &self,
        split: Split,
        frame: usize,
        downscale: usize,
        chosen: &[usize],
    ) -> Result<Vec<View>, CaptureError> {
        let footage = self.footage(split, frame, downscale)?;
        views_of(&chosen.iter().map(|&i| footage[i]).collect::<Vec<_>>(), frame, downscale)
    }

    /// Names of the cameras of one frame, in the order of [`Self::cameras`]: the name of a camera's video or image if
    /// it has one, else its id.
    ///
    /// # Errors
    /// [`CaptureError::NoFrame`] if the capture has no such frame.
    pub fn camera_names(&self, split: Split, frame: usize) -> Result<Vec<String>, CaptureError> {
        Ok(self.footage(split, frame, 1)?.into_iter().map(|of| of.name.clone()).collect())
    }

    /// The same capture with other test cameras. Training uses none of these. The capture's other test cameras are left
    /// out.
    ///
    /// - `names`: names or ids of training and test cameras
    ///
    /// # Errors
    /// [`CaptureError::Invalid`] if no camera has one of the names.
    pub fn with_test_cameras(&self, names: &[String]) -> Result<Self, CaptureError> {
        let Contents { train, test, .. } = &self.contents;
        let all: Vec<&Footage> = train.footage.iter().chain(&test.footage).collect();
        let mut is_test = vec![false; all.len()];
        for name in names {
            let by_name = all.iter().position(|of| of.name == *name);
            let by_id = || all.iter().position(|of| of.camera_id.to_string() == *name);
            let Some(found) = by_name.or_else(by_id) else {
                let known: Vec<&str> = all.iter().map(|of| of.name.as_str()).collect();
                let problem = format!("has no camera {name}, expected some of {}", known.join(", "));
                return Err(CaptureError::invalid(&self.path, problem));
            };
            is_test[found] = true;
        }
        let chosen = |wanted: bool, set: &CameraSet, offset: usize, frame: usize| -> Vec<usize> {
            let places = set.order.at(frame).iter().map(|&i| offset + i);
            places.filter(|&i| is_test[i] == wanted).collect()
        };
        let num_train = train.footage.len();
        let (mut train_order, mut test_order) = (ByFrame::default(), ByFrame::default());
        for frame in 0..self.num_frames() {
            train_order.push(frame, chosen(false, train, 0, frame));
            test_order.push(frame, [chosen(true, train, 0, frame), chosen(true, test, num_train, frame)].concat());
        }
        let footage: Vec<Footage> = all.into_iter().cloned().collect();
        let contents = Contents {
            train: CameraSet { footage: train.footage.clone(), order: train_order },
            test: CameraSet { footage, order: test_order },
            ..self.contents.clone()
        };
        Ok(Self::of_contents(self.path.clone(), self.kind, self.facts, contents))
    }

    /// Whether images of the training cameras are decoded from videos, which is much faster in the order of their
    /// frames than in any other order.
    pub fn is_video(&self) -> bool {
        self.contents.train.at(0).any(Footage::is_video)
    }

    /// Whether the colours of some camera's images are changed, by gains and offsets of `capture.toml`.
    pub fn changes_colors(&self) -> bool {
        let Contents { train, test, .. } = &self.contents;
        let footage = train.footage.iter().chain(&test.footage);
        footage.into_iter().any(|of| of.color_change() != ColorChange::NONE)
    }

    /// The same capture with colours as recorded, which publications compare with.
    pub fn with_recorded_colors(&self) -> Self {
        let mut capture = self.clone();
        let Contents { train, test, .. } = &mut capture.contents;
        train.footage.iter_mut().chain(&mut test.footage).for_each(Footage::keep_recorded_colors);
        capture
    }

    /// Reads the points that training starts from: positions in scene units, colours in `[0, 1]`, foreground labels.
    ///
    /// # Errors
    /// [`CaptureError::NoPoints`] if the capture has no points; another [`CaptureError`] if the file cannot be read, is
    /// empty, or holds numbers that are not finite.
    pub fn point_cloud(&self) -> Result<PointCloud, CaptureError> {
        match &self.contents.points {
            Some(Points::File(file)) => points::read(file),
            Some(Points::InMemory(cloud)) => Ok(PointCloud::clone(cloud)),
            None => Err(CaptureError::NoPoints { path: self.path.clone() }),
        }
    }

    /// Share of the initial points whose depth is measured ([`Origin::is_measured`](crate::Origin::is_measured)), in
    /// `[0, 1]`; `None` if the origin of the points is unknown.
    ///
    /// # Errors
    /// [`CaptureError`] if the file of the points cannot be read.
    pub fn measured_share(&self) -> Result<Option<f64>, CaptureError> {
        let origins = self.origins()?;
        let measured = |origins: &[Origin]| origins.iter().filter(|origin| origin.is_measured()).count();
        Ok(origins.map(|origins| measured(&origins) as f64 / origins.len().max(1) as f64))
    }

    /// From where pictures of a training with this capture can be trusted.
    ///
    /// Half of the points must have a measured depth for pictures from between cameras: elsewhere surfaces were
    /// guessed. Points of unknown origin count as measured.
    ///
    /// - `cameras`: of the training
    /// - `center`: the point that they look at, world, scene units
    ///
    /// # Errors
    /// As [`Self::measured_share`].
    pub fn trust(&self, cameras: &[Camera], center: [f64; 3]) -> Result<Trust, CaptureError> {
        let is_measured = self.measured_share()?.is_none_or(|share| share >= MOSTLY_MEASURED);
        Ok(Trust::of(cameras, center, if is_measured { BETWEEN_DEGREES.to_radians() } else { 0.0 }))
    }

    /// The initial points whose depth is measured; all points if their file does not say how they were made.
    ///
    /// # Errors
    /// As [`Self::point_cloud`]; also if the file says how more or fewer points were made than it has.
    pub fn evidence(&self) -> Result<PointCloud, CaptureError> {
        let cloud = self.point_cloud()?;
        match self.origins()? {
            Some(origins) if origins.len() == cloud.points.len() => Ok(measured(&cloud, &origins)),
            Some(origins) => {
                let (found, expected) = (origins.len(), cloud.points.len());
                let problem =
                    format!("says of {found} points how they were made, expected as many as there are: {expected}");
                Err(CaptureError::invalid(&self.path, problem))
            }
            None => Ok(cloud),
        }
    }

    fn origins(&self) -> Result<Option<Vec<Origin>>, CaptureError> {
        match &self.contents.points {
            Some(Points::File(file)) => points::read_origins(file),
            _ => Ok(None),
        }
    }

    /// Whether the capture has initial points, so that [`Self::point_cloud`] has something to read.
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

fn views_of(footage: &[&Footage], frame: usize, downscale: usize) -> Result<Vec<View>, CaptureError> {
    // All views are collected before the first error is chosen, so that the error is always the same.
    let views: Vec<_> = footage.par_iter().map(|of| of.view(frame, downscale)).collect();
    views.into_iter().collect()
}
