//! All images of one camera: their files, the change made to each before it is given out, and the camera's poses.
//!
//! What lives here: the way from a frame's number to a [`View`]. What does not: the list and the order of cameras
//! (`contents`), and the files of each kind of capture (`kinds`).

use std::path::PathBuf;
use std::sync::Arc;

use image::RgbImage;
use tcgs_core::{Camera, Image, Segmentation, View};

use crate::{
    CaptureError, decode, lanczos,
    lens::Lens,
    names::Files,
    recording::{ColorChange, Take},
    video::Video,
};

/// One camera over time.
#[derive(Clone, Debug)]
pub(crate) struct Footage {
    pub camera_id: usize,
    /// The camera's name for people, unique in the capture.
    pub name: String,
    /// Cameras of the images as they are given out.
    pub cameras: ByFrame<Camera>,
    pub images: Images,
    pub masks: Masks,
}

/// A change to an image before it is given out.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Change {
    /// No change.
    Nothing,
    /// Half as wide and high, by Lanczos resampling.
    Halve,
    /// Lens distortion is removed.
    Straighten(Arc<Lens>),
}

/// A function from a frame's number to its image or mask.
pub(crate) type Make<T> = Arc<dyn Fn(usize) -> Result<T, BoxedError> + Send + Sync>;
/// The error of such a function.
pub(crate) type BoxedError = Box<dyn std::error::Error + Send + Sync>;

/// The images of a camera.
#[derive(Clone)]
pub(crate) enum Images {
    /// On disk.
    Stored { pixels: Pixels, changes: ByFrame<Change> },
    /// In memory.
    InMemory(Arc<[Image]>),
    /// Made when they are asked for.
    Made(Make<Image>),
}

/// Images on disk.
#[derive(Clone, Debug)]
pub(crate) enum Pixels {
    /// One file per image.
    Files {
        files: Files,
        /// The frame whose file is known to be cut short. Its missing rows are those of the frame before.
        cut_frame: Option<usize>,
    },
    /// Frames of a video, which are those of the capture.
    Video(Arc<Video>),
    /// A recording of any kind, on its own clock.
    Take(Arc<Take>),
}

/// The foreground masks of a camera.
#[derive(Clone)]
pub(crate) enum Masks {
    /// No masks.
    None,
    /// One file per mask.
    Files {
        files: Files,
        /// Whether a frame has one.
        present: ByFrame<bool>,
    },
    /// In memory.
    InMemory(Arc<[Segmentation]>),
    /// Made when they are asked for.
    Made(Make<Segmentation>),
}

/// A value that mostly stays the same from frame to frame, stored once until it changes.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ByFrame<T> {
    /// Each value with the first frame at which it holds, ascending.
    values: Vec<(usize, T)>,
}

impl<T> Default for ByFrame<T> {
    fn default() -> Self {
        Self { values: Vec::new() }
    }
}

impl<T: PartialEq> ByFrame<T> {
    /// The same value at every frame.
    pub fn constant(value: T) -> Self {
        Self { values: vec![(0, value)] }
    }

    /// - `frame`: later than all frames so far
    pub fn push(&mut self, frame: usize, value: T) {
        if self.values.last().is_none_or(|(_, last)| *last != value) {
            self.values.push((frame, value));
        }
    }

    /// # Panics
    /// Before the first frame that has a value.
    pub fn at(&self, frame: usize) -> &T {
        &self.values[self.values.partition_point(|(begin, _)| *begin <= frame) - 1].1
    }
}

impl Change {
    /// The change that makes an image of this lens a pinhole's: none, if the lens has no distortion.
    pub fn for_lens(lens: &Arc<Lens>) -> Self {
        if lens.is_straight() { Self::Nothing } else { Self::Straighten(Arc::clone(lens)) }
    }
}

impl Footage {
    pub fn camera(&self, frame: usize) -> &Camera {
        self.cameras.at(frame)
    }

    /// Whether its images are decoded from a video.
    pub fn is_video(&self) -> bool {
        match &self.images {
            Images::Stored { pixels: Pixels::Video(_), .. } => true,
            Images::Stored { pixels: Pixels::Take(take), .. } => take.recording.is_video(),
            _ => false,
        }
    }

    /// The change to the colours of the images.
    pub fn color_change(&self) -> ColorChange {
        match &self.images {
            Images::Stored { pixels: Pixels::Take(take), .. } => take.colors,
            _ => ColorChange::NONE,
        }
    }

    /// Removes the change of colours.
    pub fn keep_recorded_colors(&mut self) {
        if let Images::Stored { pixels: Pixels::Take(take), .. } = &mut self.images {
            *take = Arc::new(Take { colors: ColorChange::NONE, ..Take::clone(take) });
        }
    }

    /// Decodes or makes the image of a frame, and its mask.
    ///
    /// - `downscale`: the image is averaged over that many pixels squared, the mask by majority
    pub fn view(&self, frame: usize, downscale: usize) -> Result<View, CaptureError> {
        let camera = self.camera(frame).clone();
        let segmentation = self.masks.mask(frame, (camera.width, camera.height), self.camera_id)?;
        let image = self.images.image(frame, (camera.width, camera.height), self.camera_id)?;
        let view = View { camera, image, segmentation, frame, camera_id: self.camera_id };
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

impl Images {
    /// Files that are all whole and need no change.
    pub fn of_files(files: Files) -> Self {
        let pixels = Pixels::Files { files, cut_frame: None };
        Self::Stored { pixels, changes: ByFrame::constant(Change::Nothing) }
    }

    /// - `size`: the size that the image must have
    fn image(&self, frame: usize, size: (usize, usize), camera_id: usize) -> Result<Image, CaptureError> {
        let image = match self {
            Self::Stored { pixels, changes } => return pixels.image(frame, size, changes.at(frame)),
            Self::InMemory(images) => images[frame].clone(),
            Self::Made(make) => make(frame).map_err(|error| CaptureError::Made { camera_id, frame, error })?,
        };
        check_image(&image, size).map_err(|problem| made_wrong(camera_id, frame, problem))?;
        Ok(image)
    }
}

impl Pixels {
    /// - `size`: the size that the image must have after the change
    fn image(&self, frame: usize, (width, height): (usize, usize), change: &Change) -> Result<Image, CaptureError> {
        match change {
            Change::Nothing => Ok(from_rgb(&self.decode(frame, (width, height))?)),
            Change::Halve => Ok(from_rgb(&lanczos::halve(&self.decode(frame, (2 * width, 2 * height))?))),
            Change::Straighten(lens) => Ok(lens.straighten(&self.decode(frame, lens.size())?)),
        }
    }

    /// - `size`: the size that the image must have
    fn decode(&self, frame: usize, size: (usize, usize)) -> Result<RgbImage, CaptureError> {
        match self {
            Self::Files { files, cut_frame } if *cut_frame == Some(frame) && frame > 0 => {
                decode::cut_image(&files.path(frame), &files.path(frame - 1), size)
            }
            Self::Files { files, .. } => decode::image(&files.path(frame), size),
            Self::Video(video) => video.frame(frame),
            Self::Take(take) => take.image(frame),
        }
    }
}

impl Masks {
    /// Whether a frame has a mask.
    pub fn has(&self, frame: usize) -> bool {
        match self {
            Self::None => false,
            Self::Files { present, .. } => *present.at(frame),
            Self::InMemory(_) | Self::Made(_) => true,
        }
    }

    /// The file of a frame's mask, whether or not there is one.
    pub fn file(&self, frame: usize) -> Option<PathBuf> {
        match self {
            Self::Files { files, .. } => Some(files.path(frame)),
            _ => None,
        }
    }

    /// - `size`: the size that the mask must have
    fn mask(&self, frame: usize, size: (usize, usize), camera_id: usize) -> Result<Option<Segmentation>, CaptureError> {
        if !self.has(frame) {
            return Ok(None);
        }
        let mask = match self {
            Self::None => return Ok(None),
            Self::Files { files, .. } => return decode::mask(&files.path(frame), size).map(Some),
            Self::InMemory(masks) => masks[frame].clone(),
            Self::Made(make) => make(frame).map_err(|error| CaptureError::Made { camera_id, frame, error })?,
        };
        check_mask(&mask, size).map_err(|problem| made_wrong(camera_id, frame, problem))?;
        Ok(Some(mask))
    }
}

fn from_rgb(pixels: &RgbImage) -> Image {
    Image::from_rgb8(pixels.width() as usize, pixels.height() as usize, pixels.as_raw())
}

fn made_wrong(camera_id: usize, frame: usize, problem: String) -> CaptureError {
    CaptureError::Made { camera_id, frame, error: problem.into() }
}

/// Checks that an image in memory has its camera's size and three channels.
pub(crate) fn check_image(image: &Image, (width, height): (usize, usize)) -> Result<(), String> {
    let Image { width: found_width, height: found_height, num_channels: channels, .. } = *image;
    if (found_width, found_height, channels) != (width, height, 3) || image.data.len() != 3 * width * height {
        return Err(format!(
            "the image is {found_width}x{found_height} pixels of {channels} channels, expected {width}x{height} of 3 \
             as its camera has"
        ));
    }
    Ok(())
}

/// Checks that a mask in memory has its camera's size.
pub(crate) fn check_mask(mask: &Segmentation, (width, height): (usize, usize)) -> Result<(), String> {
    if (mask.width, mask.height) != (width, height) || mask.foreground.len() != width * height {
        let (found_width, found_height) = (mask.width, mask.height);
        return Err(format!(
            "the mask is {found_width}x{found_height} pixels, expected {width}x{height} as its camera has"
        ));
    }
    Ok(())
}

impl std::fmt::Debug for Images {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Stored { pixels, changes } => {
                f.debug_struct("Stored").field("pixels", pixels).field("changes", changes).finish()
            }
            Self::InMemory(images) => f.debug_tuple("InMemory").field(&images.len()).finish(),
            Self::Made(_) => f.write_str("Made"),
        }
    }
}

impl std::fmt::Debug for Masks {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::None => f.write_str("None"),
            Self::Files { files, present } => {
                f.debug_struct("Files").field("files", files).field("present", present).finish()
            }
            Self::InMemory(masks) => f.debug_tuple("InMemory").field(&masks.len()).finish(),
            Self::Made(_) => f.write_str("Made"),
        }
    }
}
