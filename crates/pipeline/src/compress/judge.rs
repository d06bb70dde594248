//! The reference that a compressed scene is compared with: images of a capture, or renders of the source.

use std::path::{Path, PathBuf};

use tcgs_capture::Split;
use tcgs_codec::CompactFile;
use tcgs_core::{Camera, Drawable, Image, Tour};
use tcgs_metrics::psnr;
use tcgs_render::{DrawAny, RenderSettings};

use crate::spread::spread;
use crate::{OpenScene, PipelineError};

/// Images of a capture that are compared at most, as far as whole frames allow: a frame is drawn anew for each
/// setting tried.
const MAX_IMAGES: usize = 100;
/// Cameras and timesteps of renders of the source.
const NUM_CAMERAS: usize = 6;
const NUM_TIMESTEPS: usize = 5;
/// Size of these where the source has no capture.
const IMAGE_SIZE: [usize; 2] = [640, 360];

/// Which images.
#[derive(Clone, Debug)]
pub struct JudgeImages {
    /// Whose images; none: renders of the source.
    pub capture: Option<PathBuf>,
    /// Which cameras of the capture.
    pub split: Split,
    /// Frames; none: of the scene, evenly, as many as make at most 100 images.
    pub frames: Option<std::ops::Range<usize>>,
}

/// One image to come close to.
struct Goal {
    timestep: usize,
    camera: Camera,
    image: Image,
}

/// Measures compressed scenes.
pub struct Judge {
    /// By time.
    goals: Vec<Goal>,
    /// The kind of images, in words.
    pub of: String,
    /// Whether they are a capture's.
    pub of_capture: bool,
    renderer: Box<DrawAny>,
}

impl Judge {
    /// Decodes or renders the images.
    pub fn new(scene: &OpenScene, images: &JudgeImages, renderer: Box<DrawAny>) -> Result<Self, PipelineError> {
        match &images.capture {
            Some(path) => Self::of_capture(scene, path, images, renderer),
            None => Self::of_source(scene, images, renderer),
        }
    }

    fn of_capture(
        scene: &OpenScene,
        path: &Path,
        images: &JudgeImages,
        renderer: Box<DrawAny>,
    ) -> Result<Self, PipelineError> {
        let capture = scene.open_capture(path)?;
        let frames = scene.choose_frames(images.frames.as_ref())?;
        // The last frame is looked for before the first is decoded.
        capture.cameras(images.split, frames.end - 1, scene.downscale)?;
        let num_cameras = capture.cameras(images.split, frames.start, scene.downscale)?.len();
        if num_cameras == 0 {
            return Err(PipelineError::NoCameras { path: path.into(), split: images.split });
        }
        let count = if images.frames.is_some() { frames.len() } else { (MAX_IMAGES / num_cameras).max(1) };
        let mut goals = Vec::new();
        for timestep in spread(frames.len(), count).map(|i| frames.start - scene.first_frame + i) {
            let views = capture.views(images.split, scene.first_frame + timestep, scene.downscale)?;
            goals.extend(views.into_iter().map(|view| Goal { timestep, camera: view.camera, image: view.image }));
        }
        let of = format!("{} images of {}, {} frames", goals.len(), path.display(), count.min(frames.len()));
        Ok(Self { goals, of, of_capture: true, renderer })
    }

    fn of_source(scene: &OpenScene, images: &JudgeImages, renderer: Box<DrawAny>) -> Result<Self, PipelineError> {
        let frames = scene.choose_frames(images.frames.as_ref())?;
        let cameras = cameras(scene)?;
        let mut goals = Vec::new();
        for timestep in spread(frames.len(), NUM_TIMESTEPS).map(|i| frames.start - scene.first_frame + i) {
            let drawn = scene.drawn(timestep)?;
            for camera in &cameras {
                let image = clamped(renderer.draw(&drawn.seen_by(camera), camera, &RenderSettings::default())?.0.image);
                goals.push(Goal { timestep, camera: camera.clone(), image });
            }
        }
        let of = format!("{} renders of {}", goals.len(), scene.path.display());
        Ok(Self { goals, of, of_capture: false, renderer })
    }

    /// How many images.
    pub fn num_images(&self) -> usize {
        self.goals.len()
    }

    /// Mean PSNR in dB of a compressed scene, as `evaluate` measures it.
    ///
    /// # Errors
    /// [`PipelineError::Input`] if the scene has fewer timesteps than the images; [`PipelineError::Gpu`] if the GPU
    /// fails.
    pub fn psnr(&self, compact: &CompactFile) -> Result<f64, PipelineError> {
        let needed = self.goals.last().map_or(0, |goal| goal.timestep + 1);
        if compact.num_timesteps() < needed {
            let found = format!("{} timesteps", compact.num_timesteps());
            return Err(PipelineError::input("the compressed scene", found, format!("{needed} as the images have")));
        }
        let mut sum = 0.0;
        for of_timestep in self.goals.chunk_by(|a, b| a.timestep == b.timestep) {
            let timestep = of_timestep[0].timestep;
            let drawn = Drawable::new(&compact.at(timestep).lit(compact.light.at(timestep)));
            for goal in of_timestep {
                let (output, _) =
                    self.renderer.draw(&drawn.seen_by(&goal.camera), &goal.camera, &RenderSettings::default())?;
                sum += psnr(&clamped(output.image), &goal.image);
            }
        }
        Ok(sum / self.goals.len() as f64)
    }
}

/// The training cameras of a run, evenly; cameras around any other scene, or where the run's capture is gone.
fn cameras(scene: &OpenScene) -> Result<Vec<Camera>, PipelineError> {
    if let Some(path) = scene.capture()
        && let Ok(capture) = scene.open_capture(path)
        && let Ok(cameras) = capture.cameras(Split::Train, scene.first_frame, scene.downscale)
        && !cameras.is_empty()
    {
        return Ok(spread(cameras.len(), NUM_CAMERAS).map(|i| cameras[i].1.clone()).collect());
    }
    Ok(Tour::Orbit.cameras(scene.at(0)?.means(), scene.up().direction(), NUM_CAMERAS, IMAGE_SIZE))
}

fn clamped(image: Image) -> Image {
    Image { data: image.data.iter().map(|x| x.clamp(0.0, 1.0)).collect(), ..image }
}
