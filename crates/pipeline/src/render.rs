//! Rendering a scene with the cameras of a capture, on a tour around it, or along a saved path.

use std::ops::Range;

use tcgs_capture::{Capture, Split};
use tcgs_core::{Camera, CameraPath, Drawable, Image, MAX_PIXELS, Tour};
use tcgs_render::{DrawAny, RenderSettings};

use crate::observe::tell;
use crate::{Event, Observer, OpenScene, PipelineError, Work};

/// A camera at a frame, which together define one image.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraAt {
    /// Frame of the capture.
    pub frame: usize,
    /// The camera.
    pub camera: Camera,
    /// The capture's number of the camera; none for a tour or a path.
    pub camera_id: Option<usize>,
}

impl CameraAt {
    /// The held-out cameras of a capture at every frame, or its training cameras if none is held out. Frame by frame.
    ///
    /// - `size`: width and height of the images; none for those of the training
    ///
    /// # Errors
    /// [`PipelineError`] if the scene or the capture lacks a frame.
    pub fn of_capture(
        scene: &OpenScene,
        frames: Range<usize>,
        capture: &Capture,
        size: Option<[usize; 2]>,
    ) -> Result<Vec<Self>, PipelineError> {
        let mut all = Vec::new();
        for frame in scene.choose_frames(Some(&frames))? {
            let mut cameras = capture.cameras(Split::Test, frame, scene.downscale)?;
            if cameras.is_empty() {
                cameras = capture.cameras(Split::Train, frame, scene.downscale)?;
            }
            for (id, camera) in cameras {
                let camera = size.map_or(camera.clone(), |[width, height]| camera.resized(width, height));
                all.push(Self { frame, camera, camera_id: Some(id) });
            }
        }
        Ok(all)
    }

    /// Cameras on a path around the scene's subject ([`OpenScene::tour`]), one step per frame.
    ///
    /// - `size`: width and height of the images
    ///
    /// # Errors
    /// [`PipelineError`] if the scene lacks a frame, or one cannot be read.
    pub fn of_tour(
        scene: &OpenScene,
        frames: Range<usize>,
        tour: Tour,
        size: [usize; 2],
    ) -> Result<Vec<Self>, PipelineError> {
        let frames = scene.choose_frames(Some(&frames))?;
        let cameras = scene.tour(tour, frames.start - scene.first_frame, frames.len(), size)?;
        Ok(frames.zip(cameras).map(|(frame, camera)| Self { frame, camera, camera_id: None }).collect())
    }

    /// The cameras of a path, whose timesteps are those of the scene.
    ///
    /// - `size`: width and height of the images; none for the first keyframe's
    ///
    /// # Errors
    /// [`PipelineError`] if the scene lacks a frame, or the path has no keyframe or no camera in between.
    pub fn of_path(
        scene: &OpenScene,
        frames: Range<usize>,
        path: &CameraPath,
        size: Option<[usize; 2]>,
    ) -> Result<Vec<Self>, PipelineError> {
        let first = path.keyframes().first().map(|first| [first.camera.width, first.camera.height]);
        let Some(size) = size.or(first) else {
            return Err(PipelineError::input("the camera path", "no keyframe", "at least one"));
        };
        let at = |frame: usize| -> Result<Self, PipelineError> {
            let camera = path.camera_at((frame - scene.first_frame) as f64, size);
            let camera = camera.map_err(|error| {
                PipelineError::input("the camera path", error.to_string(), "keyframes with cameras between them")
            })?;
            Ok(Self { frame, camera, camera_id: None })
        };
        scene.choose_frames(Some(&frames))?.map(at).collect()
    }
}

/// Renders the cameras in their order and hands every image over. A frame is read when its first camera is due.
///
/// - `take`: takes the image `[3, H, W]`, not clamped
///
/// # Errors
/// The errors of `take`; [`PipelineError`] if an image has more than [`MAX_PIXELS`], a frame cannot be read or the GPU
/// fails; [`PipelineError::Stopped`] if the observer broke off.
pub fn render<E: From<PipelineError>>(
    scene: &OpenScene,
    cameras: &[CameraAt],
    renderer: &DrawAny,
    observer: &mut dyn Observer,
    mut take: impl FnMut(&CameraAt, Image) -> Result<(), E>,
) -> Result<(), E> {
    tell(observer, Event::Begun { work: Work::Rendering, num_steps: cameras.len() })?;
    for CameraAt { camera: Camera { width, height, .. }, .. } in cameras {
        if width.saturating_mul(*height) > MAX_PIXELS {
            let expected = format!("at most {MAX_PIXELS} pixels");
            return Err(PipelineError::input("the pictures", format!("{width}x{height}"), expected).into());
        }
    }
    let mut drawn: Option<(usize, Drawable)> = None;
    for at in cameras {
        let gaussians = match drawn.take() {
            Some((frame, gaussians)) if frame == at.frame => gaussians,
            _ => {
                scene.choose_frames(Some(&(at.frame..at.frame + 1)))?;
                scene.drawn(at.frame - scene.first_frame)?
            }
        };
        let seen = gaussians.seen_by(&at.camera);
        let (output, _) = renderer.draw(&seen, &at.camera, &RenderSettings::default()).map_err(PipelineError::from)?;
        take(at, output.image)?;
        drawn = Some((at.frame, gaussians));
        tell(observer, Event::Frame(at.frame))?;
    }
    Ok(())
}
