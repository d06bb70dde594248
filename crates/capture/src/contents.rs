//! The contents of a capture of any kind: both splits' cameras with their footage, the frame rate, the place of the
//! points.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use tcgs_core::Camera;

use crate::CaptureError;
use crate::checked::{FrameRate, InnerPath};
use crate::files::{self, Listings};
use crate::footage::{ByFrame, Change, Footage, Images, Masks, Pixels};
use crate::names::{Files, Names};
use crate::points::Points;

/// The result of opening a capture's folder or of building a capture.
#[derive(Clone, Debug)]
pub(crate) struct Contents {
    pub num_frames: usize,
    pub frame_rate: FrameRate,
    /// The frames that publications use.
    pub usual_frames: Range<usize>,
    pub train: CameraSet,
    pub test: CameraSet,
    /// The files that give the poses of `train` and of `test`.
    pub cameras_files: [PathBuf; 2],
    pub points: Option<Points>,
}

/// The cameras of one split.
#[derive(Clone, Debug)]
pub(crate) struct CameraSet {
    pub footage: Vec<Footage>,
    /// Indices into `footage` of a frame's cameras, in the capture's order.
    pub order: ByFrame<Vec<usize>>,
}

impl CameraSet {
    /// Cameras that have every frame.
    pub fn constant(footage: Vec<Footage>) -> Self {
        let order = ByFrame::constant((0..footage.len()).collect());
        Self { footage, order }
    }

    /// The cameras of one frame, in the capture's order.
    pub fn at(&self, frame: usize) -> impl Iterator<Item = &Footage> {
        self.order.at(frame).iter().map(|&i| &self.footage[i])
    }

    /// Whether every image has a mask.
    pub fn has_masks(&self, num_frames: usize) -> bool {
        (0..num_frames).all(|frame| self.at(frame).all(|footage| footage.masks.has(frame)))
    }
}

/// Collects files into a [`CameraSet`], frame by frame.
pub(crate) struct CameraSetOfFiles<'a> {
    folder: &'a Path,
    by_id: BTreeMap<usize, usize>,
    cameras: Vec<CameraOfFiles>,
    order: Vec<Vec<usize>>,
}

struct CameraOfFiles {
    id: usize,
    cameras: ByFrame<Camera>,
    changes: ByFrame<Change>,
    names: Vec<(usize, String)>,
    cut_frame: Option<usize>,
}

impl<'a> CameraSetOfFiles<'a> {
    /// - `folder`: the folder that names are relative to
    pub fn new(folder: &'a Path) -> Self {
        Self { folder, by_id: BTreeMap::new(), cameras: Vec::new(), order: Vec::new() }
    }

    /// Goes on to the next frame.
    pub fn begin_frame(&mut self) {
        self.order.push(Vec::new());
    }

    /// Adds an image of the frame that was begun last.
    ///
    /// - returns: whether the image is the camera's first in this frame; a second one is not added
    pub fn add(&mut self, camera_id: usize, camera: Camera, change: Change, name: InnerPath) -> bool {
        let frame = self.order.len() - 1;
        let i = *self.by_id.entry(camera_id).or_insert(self.cameras.len());
        if i == self.cameras.len() {
            let (cameras, changes) = (ByFrame::default(), ByFrame::default());
            self.cameras.push(CameraOfFiles { id: camera_id, cameras, changes, names: Vec::new(), cut_frame: None });
        }
        let this = &mut self.cameras[i];
        if this.names.last().is_some_and(|(last, _)| *last == frame) {
            return false;
        }
        this.cameras.push(frame, camera);
        this.changes.push(frame, change);
        this.names.push((frame, name.into_name()));
        self.order[frame].push(i);
        true
    }

    /// Marks the image added last as cut short. The frame before it has the missing part.
    pub fn last_is_cut(&mut self) {
        if let Some(&i) = self.order.last().and_then(|order| order.last()) {
            self.cameras[i].cut_frame = Some(self.order.len() - 1);
        }
    }

    /// The cameras, without masks. The name of a camera of one image is that of its file; any other is called by its
    /// id.
    pub fn finish(self) -> CameraSet {
        let named_by_images = self.order.len() == 1;
        let footage = |camera: CameraOfFiles| {
            let name = match camera.names.first() {
                Some((_, image)) if named_by_images => files::stem(image.as_ref()),
                _ => camera.id.to_string(),
            };
            let files = Files { folder: self.folder.into(), names: Names::of(&camera.names) };
            let pixels = Pixels::Files { files, cut_frame: camera.cut_frame };
            let images = Images::Stored { pixels, changes: camera.changes };
            Footage { camera_id: camera.id, name, cameras: camera.cameras, images, masks: Masks::None }
        };
        let mut by_frame = ByFrame::default();
        for (frame, order) in self.order.into_iter().enumerate() {
            by_frame.push(frame, order);
        }
        let mut footage: Vec<Footage> = self.cameras.into_iter().map(footage).collect();
        // A folder of images for each camera, and one frame: all files have one name.
        let names: BTreeSet<&str> = footage.iter().map(|of| of.name.as_str()).collect();
        if names.len() < footage.len() {
            footage.iter_mut().for_each(|of| of.name = of.camera_id.to_string());
        }
        CameraSet { footage, order: by_frame }
    }
}

/// The first image, by frame and then in the capture's order, that is missing.
///
/// - returns: its file, frame and place in the frame
pub(crate) fn missing_image(cameras: &CameraSet, num_frames: usize) -> Option<(PathBuf, usize, usize)> {
    let mut listings = Listings::default();
    for frame in 0..num_frames {
        for (i, footage) in cameras.at(frame).enumerate() {
            if let Images::Stored { pixels: Pixels::Files { files, .. }, .. } = &footage.images {
                let path = files.path(frame);
                if !listings.has_file(&path) {
                    return Some((path, frame, i));
                }
            }
        }
    }
    None
}

/// Checks that all images exist.
///
/// - `named_by`: the file that names the images
pub(crate) fn check_images(cameras: &CameraSet, num_frames: usize, named_by: &Path) -> Result<(), CaptureError> {
    match missing_image(cameras, num_frames) {
        Some((path, ..)) => {
            let problem = format!("no such file, expected it as {} names it", files::name(named_by));
            Err(CaptureError::invalid(path, problem))
        }
        None => Ok(()),
    }
}

/// Finds the images that have a mask.
///
/// - `files`: the mask files of a camera, from the camera and its frames; `None` if the camera has no place for masks
pub(crate) fn find_masks(
    cameras: &mut CameraSet,
    num_frames: usize,
    files: impl Fn(&Footage, &[usize]) -> Option<Files> + Sync,
) {
    // The frames of each camera.
    let mut frames: Vec<Vec<usize>> = vec![Vec::new(); cameras.footage.len()];
    for frame in 0..num_frames {
        cameras.order.at(frame).iter().for_each(|&i| frames[i].push(frame));
    }
    cameras.footage.par_iter_mut().zip(&frames).for_each(|(footage, frames)| {
        let Some(files) = files(footage, frames) else { return };
        let (mut listings, mut present) = (Listings::default(), ByFrame::default());
        frames.iter().for_each(|&frame| present.push(frame, listings.has_file(&files.path(frame))));
        footage.masks = Masks::Files { files, present };
    });
}

/// Checks that all training images have a mask, or none has. If only some have one, the others were lost: an error.
pub(crate) fn check_train_masks(train: &CameraSet, num_frames: usize) -> Result<(), CaptureError> {
    let mut first_missing = None;
    let (mut num_images, mut found) = (0, 0);
    for frame in 0..num_frames {
        for footage in train.at(frame) {
            let Masks::Files { files, present } = &footage.masks else { continue };
            num_images += 1;
            if *present.at(frame) {
                found += 1;
            } else if first_missing.is_none() {
                first_missing = Some(files.path(frame));
            }
        }
    }
    match first_missing {
        Some(missing) if found > 0 => {
            let problem =
                format!("no such file, expected masks of all {num_images} training images or of none, found {found}");
            Err(CaptureError::invalid(missing, problem))
        }
        _ => Ok(()),
    }
}
