//! A player, a camera and a stage: all of a viewer but the window that it shows in.

use tcgs_codec::{Archive, SceneInfo};
use tcgs_core::Camera;
use tcgs_render::gpu::Gpu;

use crate::cameras::{FileCamera, read_cameras};
use crate::clock::Clock;
use crate::controls::Controls;
use crate::error::PlayError;
use crate::player::{Player, PlayerSettings};
use crate::source::Source;
use crate::stage::{self, Shot, Stage, Still};
use crate::start_view::start_view;

/// What a frame showed.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// In timesteps; between them while playing.
    pub time: f64,
    /// The one that is due.
    pub timestep: usize,
    /// Whether time passes.
    pub is_playing: bool,
    /// Whether the segment that is due is missing. What was shown before stays.
    pub is_buffering: bool,
    /// Whether the picture is that of the timestep, and all of it.
    pub is_drawn: bool,
}

/// A scene before a camera.
#[derive(Debug)]
pub struct Viewer<S> {
    gpu: Gpu,
    format: wgpu::TextureFormat,
    background: [f32; 3],
    scene: Option<Opened<S>>,
}

#[derive(Debug)]
struct Opened<S> {
    player: Player<S>,
    /// Once the first segment is here.
    shown: Option<Shown>,
}

#[derive(Debug)]
struct Shown {
    stage: Stage,
    controls: Controls,
    /// The last one that was there to be drawn.
    last: (std::sync::Arc<tcgs_codec::Segment>, usize),
}

impl<S: Source> Viewer<S> {
    /// - `format`: of the textures drawn to; not one that encodes sRGB
    pub fn new(gpu: Gpu, format: wgpu::TextureFormat) -> Self {
        Self { gpu, format, background: [0.0; 3], scene: None }
    }

    /// Opens another scene; what was open is closed. [`Self::update`] brings it in.
    ///
    /// - `first_timestep`: shown first
    pub fn open(&mut self, source: S, settings: PlayerSettings, first_timestep: usize) {
        self.scene = Some(Opened { player: Player::new(source, settings, first_timestep), shown: None });
    }

    /// Closes the scene.
    pub fn close(&mut self) {
        self.scene = None;
    }

    /// Lets time pass and takes what has arrived.
    ///
    /// - returns: whether there is a picture to draw
    ///
    /// # Errors
    /// [`PlayError`]: from then on the same one, until another scene is opened.
    pub fn update(&mut self, now_ms: f64) -> Result<bool, PlayError> {
        let Some(scene) = &mut self.scene else { return Ok(false) };
        scene.player.update(now_ms)?;
        if let Some((segment, timestep)) = scene.player.current() {
            match &mut scene.shown {
                Some(shown) => {
                    if shown.last.1 != timestep {
                        shown.last = (segment.clone(), timestep);
                    }
                }
                None => {
                    let means = segment.first().means;
                    let up = segment.info().up.direction();
                    let (camera, pivot) = start_view(&means, up);
                    scene.shown = Some(Shown {
                        stage: Stage::new(&self.gpu, self.format, segment)?,
                        controls: Controls::new(&camera, up, pivot),
                        last: (segment.clone(), timestep),
                    });
                }
            }
        }
        Ok(scene.shown.is_some())
    }

    /// Draws the timestep that was due at the last update; one before it where that has not arrived.
    ///
    /// - `size`: width and height of `target`, pixels
    /// - returns: none as long as there is no scene; the background was drawn then
    ///
    /// # Errors
    /// [`PlayError`] if the GPU fails.
    pub fn draw(&mut self, size: [usize; 2], target: &wgpu::TextureView) -> Result<Option<Frame>, PlayError> {
        let Some(Opened { player, shown: Some(shown) }) = &mut self.scene else {
            stage::clear(&self.gpu, target, self.background);
            self.gpu.check()?;
            return Ok(None);
        };
        let camera = shown.controls.camera(size);
        let (segment, timestep) = &shown.last;
        let shot = Shot { segment, timestep: *timestep, camera: &camera, background: self.background };
        shown.stage.draw(&shot, target)?;
        Ok(player.clock().map(|clock| {
            let is_buffering = player.current().is_none();
            Frame {
                time: clock.position(),
                timestep: clock.timestep(),
                is_playing: clock.is_playing(),
                is_buffering,
                is_drawn: !is_buffering && shown.stage.is_whole(),
            }
        }))
    }

    /// Draws a picture that is to be read; none as long as the timestep that is due has not arrived.
    ///
    /// # Errors
    /// [`PlayError`] if the GPU fails.
    pub fn begin_still(&mut self, size: [usize; 2]) -> Result<Option<Still>, PlayError> {
        let Some(Opened { player, shown: Some(shown) }) = &mut self.scene else { return Ok(None) };
        let Some((segment, timestep)) = player.current() else { return Ok(None) };
        let camera = shown.controls.camera(size);
        let shot = Shot { segment, timestep, camera: &camera, background: self.background };
        Ok(Some(shown.stage.begin_still(&shot)?))
    }

    /// As [`Stage::finish_still`].
    ///
    /// # Errors
    /// [`PlayError`] if the GPU fails.
    pub fn finish_still(&mut self, still: &Still) -> Result<Option<Vec<u8>>, PlayError> {
        match &mut self.scene {
            Some(Opened { shown: Some(shown), .. }) => Ok(shown.stage.finish_still(still)?),
            _ => Ok(None),
        }
    }

    /// What is behind everything, sRGB in [0, 1].
    pub fn set_background(&mut self, background: [f32; 3]) {
        self.background = background;
    }

    /// What the file says of its scene, once that is known.
    pub fn info(&self) -> Option<&SceneInfo> {
        self.archive().map(Archive::info)
    }

    /// The file, once its tables are known.
    pub fn archive(&self) -> Option<&Archive> {
        self.scene.as_ref()?.player.archive()
    }

    /// Cameras that the file brings along, once its first segment is here.
    pub fn cameras(&self) -> Vec<FileCamera> {
        self.scene.as_ref().map_or_else(Vec::new, |scene| read_cameras(scene.player.application_data()))
    }

    /// Bytes that arrived so far.
    pub fn bytes_loaded(&self) -> u64 {
        self.scene.as_ref().map_or(0, |scene| scene.player.bytes_loaded())
    }

    /// The clock, once the scene's tables are known.
    pub fn clock_mut(&mut self) -> Option<&mut Clock> {
        self.scene.as_mut()?.player.clock_mut()
    }

    /// The camera's controls, once there is a picture.
    pub fn controls_mut(&mut self) -> Option<&mut Controls> {
        Some(&mut self.scene.as_mut()?.shown.as_mut()?.controls)
    }

    /// The camera for a picture of some size, once there is one.
    pub fn camera(&self, size: [usize; 2]) -> Option<Camera> {
        Some(self.scene.as_ref()?.shown.as_ref()?.controls.camera(size))
    }
}
