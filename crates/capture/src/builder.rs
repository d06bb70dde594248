//! Captures that a program builds: cameras, and images from memory, from files, or from a closure that makes each image
//! on demand.
//!
//! What lives here: the public builder and its checks. What does not: folders of known kinds (`kinds`).

use std::ops::Range;
use std::path::PathBuf;
use std::sync::Arc;

use tcgs_core::{Camera, Image, PointCloud, Segmentation};

use crate::checked::FrameRate;
use crate::contents::{CameraSet, Contents, missing_image};
use crate::footage::{BoxedError, ByFrame, Footage, Images, Masks, check_image, check_mask};
use crate::kind::{CaptureFacts, CaptureKind};
use crate::names::{Files, Names};
use crate::points::Points;
use crate::{Capture, CaptureError};

/// Builds a [`Capture`] from cameras and images that a program already has: rendered, received or decoded images, or a
/// folder of a kind that this crate does not know.
///
/// ```
/// use tcgs_capture::{CameraBuilder, CaptureBuilder, Split};
/// use tcgs_core::{Camera, Image, PointCloud};
///
/// let looking_from = |x: f64| Camera::look_at([x, 0.0, -2.0], [0.0; 3], [0.0, -1.0, 0.0], 14.0, 16, 12);
/// // The images of one camera are in memory, those of the others are made when they are asked for.
/// let in_memory = (0..3).map(|frame| Image::filled(16, 12, 3, 0.1 * frame as f32)).collect();
/// let make = |frame: usize| Ok(Image::filled(16, 12, 3, 0.1 * frame as f32));
/// let capture = CaptureBuilder::new("lamp", 3)
///     .frame_rate(25.0)
///     .train_camera(CameraBuilder::new(0, looking_from(-1.0)).images(in_memory))
///     .train_camera(CameraBuilder::new(1, looking_from(0.0)).images_from(make))
///     .test_camera(CameraBuilder::new(2, looking_from(1.0)).images_from(make))
///     .points(PointCloud { points: vec![[0.0; 3]], colors: vec![[0.5; 3]], foreground: vec![true] })
///     .build()?;
///
/// let views = capture.views(Split::Train, 2, 1)?;
/// assert_eq!((views.len(), views[1].camera_id, views[1].image.data[0]), (2, 1, 0.2));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
#[must_use]
pub struct CaptureBuilder {
    name: String,
    num_frames: usize,
    frame_rate: f64,
    usual_frames: Range<usize>,
    facts: CaptureFacts,
    train: Vec<CameraBuilder>,
    test: Vec<CameraBuilder>,
    points: Option<Points>,
}

/// One camera of a [`CaptureBuilder`]: its intrinsics and pose at every frame, and where its images and masks are.
#[derive(Clone, Debug)]
#[must_use]
pub struct CameraBuilder {
    camera_id: usize,
    /// One camera for all frames, or one camera per frame.
    cameras: Vec<Camera>,
    images: Option<Given<Image>>,
    masks: Option<Given<Segmentation>>,
}

/// The images or masks of one camera, as the program gave them.
#[derive(Clone)]
enum Given<T> {
    InMemory(Vec<T>),
    Files(Vec<PathBuf>),
    Made(Arc<dyn Fn(usize) -> Result<T, BoxedError> + Send + Sync>),
}

impl<T> std::fmt::Debug for Given<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::InMemory(all) => f.debug_tuple("InMemory").field(&all.len()).finish(),
            Self::Files(paths) => f.debug_tuple("Files").field(&paths.len()).finish(),
            Self::Made(_) => f.write_str("Made"),
        }
    }
}

impl CaptureBuilder {
    /// Starts a capture without cameras and points, at 30 frames per second.
    ///
    /// - `name`: what [`Capture::name`] returns; messages of errors begin with it
    /// - `num_frames`: number of frames of every camera; [`Self::build`] demands at least 1
    pub fn new(name: impl Into<String>, num_frames: usize) -> Self {
        Self {
            name: name.into(),
            num_frames,
            frame_rate: 30.0,
            usual_frames: 0..num_frames,
            facts: CaptureFacts::default(),
            train: Vec::new(),
            test: Vec::new(),
            points: None,
        }
    }

    /// Sets the frames per second; default 30. [`Self::build`] demands a finite number above 0.
    pub fn frame_rate(self, frame_rate: f64) -> Self {
        Self { frame_rate, ..self }
    }

    /// Sets the frames that training and evaluation use by default ([`Capture::usual_frames`]); without this call all
    /// frames. [`Self::build`] demands a range that is not empty and within the capture.
    pub fn usual_frames(self, usual_frames: Range<usize>) -> Self {
        Self { usual_frames, ..self }
    }

    /// Sets what is known about the world's axes, the scene unit and the labels; by default nothing is.
    pub fn facts(self, facts: CaptureFacts) -> Self {
        Self { facts, ..self }
    }

    /// Adds a training camera. A capture needs at least one.
    pub fn train_camera(mut self, camera: CameraBuilder) -> Self {
        self.train.push(camera);
        self
    }

    /// Adds a test camera, which is held out for evaluation.
    pub fn test_camera(mut self, camera: CameraBuilder) -> Self {
        self.test.push(camera);
        self
    }

    /// Sets the points that training starts from.
    ///
    /// - `points`: positions in scene units, colours in `[0, 1]`, foreground labels, as many of each
    pub fn points(self, points: PointCloud) -> Self {
        Self { points: Some(Points::InMemory(Arc::new(points))), ..self }
    }

    /// Sets the file of the points that training starts from. The file is read when points are asked for.
    ///
    /// - `path`: of a format that [`Capture::with_points`] reads
    pub fn points_file(self, path: impl Into<PathBuf>) -> Self {
        Self { points: Some(Points::File(path.into())), ..self }
    }

    /// Builds the capture. Checks everything except the contents of image files and the results of closures, which
    /// [`Capture::views`] checks.
    ///
    /// # Errors
    /// [`CaptureError::Built`] names the missing or inconsistent item: a frame without image, an image in memory that
    /// is not of its camera's size, an id of two cameras. Missing files, and points that most cameras do not see, give
    /// the errors of [`Capture::open`].
    pub fn build(self) -> Result<Capture, CaptureError> {
        let Self { name, num_frames, frame_rate, usual_frames, facts, train, test, points } = self;
        let invalid = |problem: String| CaptureError::Built { name: name.clone(), problem };
        if num_frames == 0 {
            return Err(invalid("has no frames, expected at least one".into()));
        }
        let frame_rate = FrameRate::new(frame_rate).map_err(|problem| invalid(format!("the frame rate {problem}")))?;
        if usual_frames.is_empty() || usual_frames.end > num_frames {
            return Err(invalid(format!("has the usual frames {usual_frames:?}, expected some of 0..{num_frames}")));
        }
        if train.is_empty() {
            return Err(invalid("has no training cameras, expected at least one".into()));
        }
        let mut ids: Vec<usize> = train.iter().chain(&test).map(|camera| camera.camera_id).collect();
        ids.sort_unstable();
        if let Some(pair) = ids.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(invalid(format!("has the camera {} twice, expected every camera once", pair[0])));
        }
        if let Some(Points::InMemory(cloud)) = &points {
            check_points(cloud).map_err(invalid)?;
        }
        let footage = |cameras: Vec<CameraBuilder>| -> Result<CameraSet, CaptureError> {
            let footage: Result<Vec<Footage>, CaptureError> = cameras
                .into_iter()
                .map(|camera| {
                    let id = camera.camera_id;
                    camera.footage(num_frames).map_err(|problem| invalid(format!("camera {id} {problem}")))
                })
                .collect();
            Ok(CameraSet::constant(footage?))
        };
        let (train, test) = (footage(train)?, footage(test)?);
        for set in [&train, &test] {
            if let Some((path, frame, i)) = missing_image(set, num_frames) {
                let id = set.footage[i].camera_id;
                return Err(CaptureError::invalid(
                    path,
                    format!("no such file, expected frame {frame} of camera {id}"),
                ));
            }
        }
        let cameras_files = [PathBuf::from(&name), PathBuf::from(&name)];
        let contents = Contents { num_frames, frame_rate, usual_frames, train, test, cameras_files, points };
        let capture = Capture::of_contents(name.into(), CaptureKind::BUILT, facts, contents);
        capture.check_sight()?;
        Ok(capture)
    }
}

impl CameraBuilder {
    /// A camera whose pose and intrinsics are the same at every frame.
    ///
    /// - `camera_id`: number that names the camera, unique in the capture
    /// - `camera`: intrinsics and pose; `width` and `height` are those of the images
    pub fn new(camera_id: usize, camera: Camera) -> Self {
        Self { camera_id, cameras: vec![camera], images: None, masks: None }
    }

    /// A camera whose pose or intrinsics change with time.
    ///
    /// - `camera_id`: number that names the camera, unique in the capture
    /// - `cameras`: `[num_frames]`, intrinsics and pose at each frame
    pub fn moving(camera_id: usize, cameras: Vec<Camera>) -> Self {
        Self { camera_id, cameras, images: None, masks: None }
    }

    /// Takes images from memory.
    ///
    /// - `images`: `[num_frames]`, each `[3, H, W]` in `[0, 1]`
    pub fn images(self, images: Vec<Image>) -> Self {
        Self { images: Some(Given::InMemory(images)), ..self }
    }

    /// Takes images from PNG or JPEG files. Each file is decoded when [`Capture::views`] asks for its frame.
    ///
    /// - `paths`: `[num_frames]`
    pub fn image_files(self, paths: Vec<PathBuf>) -> Self {
        Self { images: Some(Given::Files(paths)), ..self }
    }

    /// Makes each image on demand by a closure, which may be called from any thread and several times for one frame.
    ///
    /// - `make`: from a frame's index to the image `[3, H, W]` in `[0, 1]`; [`Capture::views`] returns the closure's
    ///   errors as [`CaptureError::Made`]
    pub fn images_from(
        self,
        make: impl Fn(usize) -> Result<Image, Box<dyn std::error::Error + Send + Sync>> + Send + Sync + 'static,
    ) -> Self {
        Self { images: Some(Given::Made(Arc::new(make))), ..self }
    }

    /// Takes foreground masks from memory.
    ///
    /// - `masks`: `[num_frames]`, each of the size of its image
    pub fn masks(self, masks: Vec<Segmentation>) -> Self {
        Self { masks: Some(Given::InMemory(masks)), ..self }
    }

    /// Takes foreground masks from PNG files. A pixel that is not black is foreground.
    ///
    /// - `paths`: `[num_frames]`
    pub fn mask_files(self, paths: Vec<PathBuf>) -> Self {
        Self { masks: Some(Given::Files(paths)), ..self }
    }

    /// Makes each foreground mask on demand by a closure, as [`images_from`](Self::images_from) makes images.
    ///
    /// - `make`: from a frame's index to the mask, of the size of its image
    pub fn masks_from(
        self,
        make: impl Fn(usize) -> Result<Segmentation, Box<dyn std::error::Error + Send + Sync>> + Send + Sync + 'static,
    ) -> Self {
        Self { masks: Some(Given::Made(Arc::new(make))), ..self }
    }

    fn footage(self, num_frames: usize) -> Result<Footage, String> {
        let Self { camera_id, cameras: given, images, masks } = self;
        if given.len() != 1 && given.len() != num_frames {
            return Err(format!(
                "stands at {} places, expected one, or one for each of {num_frames} frames",
                given.len()
            ));
        }
        let mut cameras = ByFrame::default();
        given.into_iter().enumerate().for_each(|(frame, camera)| cameras.push(frame, camera));
        let size = |frame: usize| {
            let camera = cameras.at(frame);
            (camera.width, camera.height)
        };
        let images = match images {
            None => return Err("has no images, expected one for each frame".into()),
            Some(Given::Made(make)) => Images::Made(make),
            Some(Given::Files(paths)) => Images::of_files(files(&paths, num_frames, "images")?),
            Some(Given::InMemory(images)) => {
                check_count(images.len(), num_frames, "images")?;
                for (frame, image) in images.iter().enumerate() {
                    check_image(image, size(frame)).map_err(|problem| format!("at frame {frame}: {problem}"))?;
                }
                Images::InMemory(images.into())
            }
        };
        let masks = match masks {
            None => Masks::None,
            Some(Given::Made(make)) => Masks::Made(make),
            Some(Given::Files(paths)) => {
                Masks::Files { files: files(&paths, num_frames, "masks")?, present: ByFrame::constant(true) }
            }
            Some(Given::InMemory(masks)) => {
                check_count(masks.len(), num_frames, "masks")?;
                for (frame, mask) in masks.iter().enumerate() {
                    check_mask(mask, size(frame)).map_err(|problem| format!("at frame {frame}: {problem}"))?;
                }
                Masks::InMemory(masks.into())
            }
        };
        Ok(Footage { camera_id, name: camera_id.to_string(), cameras, images, masks })
    }
}

fn check_count(found: usize, num_frames: usize, what: &str) -> Result<(), String> {
    if found != num_frames {
        return Err(format!("has {found} {what}, expected one for each of {num_frames} frames"));
    }
    Ok(())
}

fn files(paths: &[PathBuf], num_frames: usize, what: &str) -> Result<Files, String> {
    check_count(paths.len(), num_frames, what)?;
    let text = |(frame, path): (usize, &PathBuf)| match path.to_str() {
        Some(text) => Ok((frame, text.to_owned())),
        None => Err(format!("at frame {frame}: the path {} is not Unicode, expected one that is", path.display())),
    };
    let names: Vec<(usize, String)> = paths.iter().enumerate().map(text).collect::<Result<_, _>>()?;
    Ok(Files { folder: PathBuf::new(), names: Names::of(&names) })
}

fn check_points(cloud: &PointCloud) -> Result<(), String> {
    let PointCloud { points, colors, foreground } = cloud;
    if points.is_empty() {
        return Err("has a cloud of no points, expected at least one".into());
    }
    if (colors.len(), foreground.len()) != (points.len(), points.len()) {
        let (colors, foreground) = (colors.len(), foreground.len());
        return Err(format!(
            "has {colors} colours and {foreground} labels of points, expected {} of each as there are points",
            points.len()
        ));
    }
    if let Some(i) = points.iter().zip(colors).position(|(p, c)| p.iter().chain(c).any(|x| !x.is_finite())) {
        return Err(format!("has the point {:?} of colour {:?} at {i}, expected finite numbers", points[i], colors[i]));
    }
    Ok(())
}
