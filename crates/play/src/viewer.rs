//! A player, a camera and a renderer: a complete viewer except for its window.

use tcgs_codec::{Archive, FileCamera, SceneInfo, UpAxis, read_views};
use tcgs_core::Camera;
use tcgs_render::gpu::Gpu;

use crate::clock::Clock;
use crate::controls::Controls;
use crate::error::PlayError;
use crate::holdings::Moment;
use crate::player::{Player, PlayerSettings};
use crate::segment_renderer::{self, PictureRequest, SegmentRenderer, Still};
use crate::source::RangeSource;
use crate::start_view::start_view;

/// The timestep that [`Viewer::draw`] drew, and the due one.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameReport {
    /// Position of the clock, timesteps; between two whole numbers while time passes.
    pub time: f64,
    /// The same in seconds from the first timestep, at speed 1.
    pub seconds: f64,
    /// The timestep that is due.
    pub timestep: usize,
    /// Whether time passes.
    pub is_playing: bool,
    /// Whether a part of the due timestep has not arrived. The picture then shows an earlier timestep, or the first
    /// layers of this one.
    pub is_buffering: bool,
    /// Whether the picture shows the due timestep, with all its splats.
    pub is_drawn: bool,
}

/// Plays one scene at a time and draws it from a camera that a person moves.
///
/// The caller owns the window or canvas: it calls [`Viewer::update`] and [`Viewer::draw`] once a frame. A still picture
/// needs no window:
///
/// ```no_run
/// use std::path::Path;
/// use tcgs_play::{FileSource, PlayError, PlayerSettings, Viewer};
/// use tcgs_render::gpu::{Gpu, GpuChoice};
/// let gpu = Gpu::open_for_viewing(GpuChoice::Hardware)?;
/// let mut viewer = Viewer::new(gpu.clone(), wgpu::TextureFormat::Rgba8Unorm);
/// viewer.open(FileSource::open(Path::new("scene.tcgs"))?, PlayerSettings::default(), 0);
/// while !viewer.update(0.0)? {}
/// let pixels = loop {
///     let Some(still) = viewer.begin_still([640, 360])? else { continue };
///     gpu.wait()?;
///     if let Some(pixels) = viewer.finish_still(&still)? {
///         break pixels;
///     }
/// };
/// assert_eq!(pixels.len(), 4 * 640 * 360);
/// # Ok::<(), PlayError>(())
/// ```
#[derive(Debug)]
pub struct Viewer<S> {
    gpu: Gpu,
    format: wgpu::TextureFormat,
    background: [f32; 3],
    session: Option<Session<S>>,
}

/// A scene from its opening to its closing.
#[derive(Debug)]
struct Session<S> {
    player: Player<S>,
    /// Present once the first picture of the due timestep can be drawn.
    display: Option<Display>,
}

/// The renderer, the camera's controls and the timestep that is shown.
#[derive(Debug)]
struct Display {
    renderer: SegmentRenderer,
    controls: Controls,
    /// The timestep that is drawn until the next due one has arrived.
    shown: Moment,
}

impl<S: RangeSource> Viewer<S> {
    /// A viewer without a scene.
    ///
    /// - `format`: format of the textures drawn to. It must not encode sRGB, because colours are stored as displayed
    pub fn new(gpu: Gpu, format: wgpu::TextureFormat) -> Self {
        Self { gpu, format, background: [0.0; 3], session: None }
    }

    /// Starts opening a scene, and closes the scene before. Later calls of [`Self::update`] fetch and decode it.
    ///
    /// - `first_timestep`: the timestep that is shown first; the last one of the scene if it has fewer
    pub fn open(&mut self, source: S, settings: PlayerSettings, first_timestep: usize) {
        self.session = Some(Session { player: Player::new(source, settings, first_timestep), display: None });
    }

    /// Closes the scene.
    pub fn close(&mut self) {
        self.session = None;
    }

    /// Lets time pass, takes the bytes that have arrived, and decodes.
    ///
    /// - `now_ms`: as for [`Player::update`]
    /// - returns: whether there is a picture to draw
    ///
    /// # Errors
    /// [`PlayError`] if the scene does not play. Every later call returns the same error until another scene is opened.
    pub fn update(&mut self, now_ms: f64) -> Result<bool, PlayError> {
        let Some(session) = &mut self.session else { return Ok(false) };
        session.player.update(now_ms)?;
        if let Some(moment) = session.player.current() {
            match &mut session.display {
                Some(display) => display.shown = moment,
                None => {
                    let info = session.player.archive().map(Archive::info);
                    let up = info.map_or_else(UpAxis::default, |info| info.up).direction();
                    let cameras = read_views(session.player.application_data());
                    let cameras: Vec<Camera> = cameras.into_iter().map(|of_file| of_file.camera).collect();
                    let (camera, pivot) = start_view(&moment, &cameras, up);
                    session.display = Some(Display {
                        renderer: SegmentRenderer::new(&self.gpu, self.format)?,
                        controls: Controls::new(&camera, up, pivot),
                        shown: moment,
                    });
                }
            }
        }
        Ok(session.display.is_some())
    }

    /// Draws the timestep that was due at the last update. Until that has arrived, draws the timestep shown before.
    ///
    /// - `size`: width and height of `target`, pixels
    /// - returns: `None` as long as there is no picture; `target` shows the background then
    ///
    /// # Errors
    /// [`PlayError::Gpu`] if the GPU fails.
    pub fn draw(&mut self, size: [usize; 2], target: &wgpu::TextureView) -> Result<Option<FrameReport>, PlayError> {
        let Some(Session { player, display: Some(display) }) = &mut self.session else {
            segment_renderer::clear(&self.gpu, target, self.background);
            self.gpu.check()?;
            return Ok(None);
        };
        let camera = display.controls.camera(size);
        let (moment, background, light) = (&display.shown, self.background, player.light(display.shown.timestep));
        let request = PictureRequest { moment, camera: &camera, background, light };
        display.renderer.draw(&request, target)?;
        Ok(player.clock().map(|clock| {
            let is_buffering = player.current().is_none_or(|moment| !moment.is_whole);
            FrameReport {
                time: clock.position(),
                seconds: clock.seconds(),
                timestep: clock.timestep(),
                is_playing: clock.is_playing(),
                is_buffering,
                is_drawn: !is_buffering && display.renderer.is_whole(),
            }
        }))
    }

    /// Submits the drawing of a picture whose pixels are read back.
    ///
    /// - `size`: width and height of the picture, pixels
    /// - returns: `None` as long as the due timestep has not arrived
    ///
    /// # Errors
    /// [`PlayError::Gpu`] if the GPU fails.
    pub fn begin_still(&mut self, size: [usize; 2]) -> Result<Option<Still>, PlayError> {
        let Some(Session { player, display: Some(display) }) = &mut self.session else { return Ok(None) };
        let Some(moment) = player.current().filter(|moment| moment.is_whole) else { return Ok(None) };
        let camera = display.controls.camera(size);
        let (background, light) = (self.background, player.light(moment.timestep));
        let request = PictureRequest { moment: &moment, camera: &camera, background, light };
        Ok(Some(display.renderer.begin_still(&request)?))
    }

    /// Takes the pixels of a still that is ready, as [`SegmentRenderer::finish_still`] does.
    ///
    /// # Errors
    /// [`PlayError::Gpu`] if the GPU fails.
    pub fn finish_still(&mut self, still: &Still) -> Result<Option<Vec<u8>>, PlayError> {
        match &mut self.session {
            Some(Session { display: Some(display), .. }) => Ok(display.renderer.finish_still(still)?),
            _ => Ok(None),
        }
    }

    /// Sets the colour behind all Gaussians, black at first.
    ///
    /// - `background`: sRGB in `[0, 1]`
    pub fn set_background(&mut self, background: [f32; 3]) {
        self.background = background;
    }

    /// Description of the scene from the file's tables, once these have arrived.
    pub fn info(&self) -> Option<&SceneInfo> {
        self.archive().map(Archive::info)
    }

    /// Tables of the file, once they have arrived.
    pub fn archive(&self) -> Option<&Archive> {
        self.session.as_ref()?.player.archive()
    }

    /// Names and bytes of the data that applications put near the start of the file.
    pub fn application_data(&self) -> &[(String, Vec<u8>)] {
        self.session.as_ref().map_or(&[], |session| session.player.application_data())
    }

    /// Cameras of the file; none before its tables have arrived.
    pub fn cameras(&self) -> Vec<FileCamera> {
        read_views(self.application_data())
    }

    /// Number of bytes that have arrived of the open scene.
    pub fn bytes_loaded(&self) -> u64 {
        self.session.as_ref().map_or(0, |session| session.player.bytes_loaded())
    }

    /// The clock, once the tables of the file have arrived.
    pub fn clock_mut(&mut self) -> Option<&mut Clock> {
        self.session.as_mut()?.player.clock_mut()
    }

    /// The camera's controls, once there is a picture.
    pub fn controls_mut(&mut self) -> Option<&mut Controls> {
        Some(&mut self.session.as_mut()?.display.as_mut()?.controls)
    }

    /// The camera for a picture of some size, once there is a picture.
    ///
    /// - `size`: width and height, pixels
    pub fn camera(&self, size: [usize; 2]) -> Option<Camera> {
        Some(self.session.as_ref()?.display.as_ref()?.controls.camera(size))
    }
}
