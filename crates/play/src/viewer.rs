//! A player, a camera and a renderer: a complete viewer except for its window.

use tcgs_codec::{Archive, FileCamera, SceneInfo, read_background, read_trust, read_views};
use tcgs_core::{Camera, Trust};

use crate::clock::Clock;
use crate::controls::Controls;
use crate::error::PlayError;
use crate::renderer::{PictureRequest, Renderer};
use crate::start_view::StartView;

/// From the bytes of a scene to timesteps that a renderer draws: a [`Player`](crate::Player), or one in the worker of a
/// page.
pub trait Feed {
    /// A timestep in the form that the renderer draws.
    type Moment: Clone;

    /// Lets time pass, and takes what has arrived, as [`Player::update`](crate::Player::update) does.
    ///
    /// # Errors
    /// [`PlayError`] if the scene does not play. Every later call returns the same error.
    fn update(&mut self, now_ms: f64) -> Result<(), PlayError>;

    /// The timestep to draw: the due one, or the newest that is there.
    fn current(&self) -> Option<Self::Moment>;

    /// The view at the start.
    fn start_view(&self, moment: &Self::Moment) -> StartView;

    /// Learns the camera of the next picture.
    fn look(&mut self, camera: &Camera);

    /// Whether a part of the due timestep has not arrived.
    fn is_buffering(&self) -> bool;

    /// Whether this is the due timestep with all its Gaussians, in the form that this camera needs.
    fn is_due(&self, moment: &Self::Moment, camera: &Camera) -> bool;

    /// Gains of red, green and blue at a timestep.
    fn light(&self, moment: &Self::Moment) -> [f32; 3];

    /// Tables of the file, once they have arrived.
    fn archive(&self) -> Option<&Archive>;

    /// Names and bytes of the data that applications put near the start of the file, once its tables have arrived.
    fn application_data(&self) -> &[(String, Vec<u8>)];

    /// The clock, once the tables of the file have arrived.
    fn clock(&self) -> Option<&Clock>;

    /// The clock, to be started, stopped and set, once the tables of the file have arrived.
    fn clock_mut(&mut self) -> Option<&mut Clock>;

    /// Number of bytes that have arrived; bytes that arrived twice count twice.
    fn bytes_loaded(&self) -> u64;
}

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
    /// How little the picture can be trusted, in `[0, 1]` ([`Trust::doubt`]); 0 for files that do not say it.
    pub doubt: f64,
}

/// Plays one scene at a time and draws it from a camera that a person moves.
///
/// The caller owns the window or canvas: it calls [`Viewer::update`] and [`Viewer::draw`] once a frame. A still picture
/// needs no window:
///
#[cfg_attr(feature = "webgpu", doc = "```no_run")]
#[cfg_attr(not(feature = "webgpu"), doc = "```ignore")]
/// use std::path::Path;
/// use tcgs_play::{FileSource, PlayError, Player, PlayerSettings, SegmentRenderer, Viewer};
/// use tcgs_render::gpu::{Gpu, GpuChoice};
/// let gpu = Gpu::open_for_viewing(GpuChoice::Hardware)?;
/// let mut viewer: Viewer<_, SegmentRenderer> = Viewer::new((gpu.clone(), wgpu::TextureFormat::Rgba8Unorm));
/// let source = FileSource::open(Path::new("scene.tcgs"))?;
/// viewer.open(Player::new(source, PlayerSettings::default(), 0));
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
pub struct Viewer<F: Feed, R: Renderer> {
    device: R::Device,
    /// None: the scene's own.
    background: Option<[f32; 3]>,
    session: Option<Session<F, R>>,
}

/// A scene from its opening to its closing.
struct Session<F: Feed, R> {
    player: F,
    /// Present once the first picture of the due timestep can be drawn.
    display: Option<Display<F::Moment, R>>,
}

/// The renderer, the camera's controls and the timestep that is shown.
struct Display<M, R> {
    renderer: R,
    controls: Controls,
    trust: Option<Trust>,
    /// The scene's own.
    background: [f32; 3],
    /// The timestep that is drawn until the next due one has arrived.
    shown: M,
}

impl<M, R> Display<M, R> {
    fn doubt(&self, position: [f64; 3]) -> f64 {
        self.trust.as_ref().map_or(0.0, |trust| trust.doubt(position))
    }
}

impl<F: Feed, R: Renderer<Moment = F::Moment>> Viewer<F, R> {
    /// A viewer without a scene.
    ///
    /// - `device`: for [`SegmentRenderer`](crate::SegmentRenderer) the GPU and the format of the textures drawn to.
    ///   That must not encode sRGB, because colours are stored as displayed
    pub fn new(device: R::Device) -> Self {
        Self { device, background: None, session: None }
    }

    /// Starts opening a scene, and closes the scene before. Later calls of [`Self::update`] fetch and decode it.
    pub fn open(&mut self, player: F) {
        self.session = Some(Session { player, display: None });
    }

    /// Closes the scene.
    pub fn close(&mut self) {
        self.session = None;
    }

    /// Lets time pass, takes the bytes that have arrived, and decodes.
    ///
    /// - `now_ms`: as for [`Feed::update`]
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
                    let StartView { camera, up, pivot } = session.player.start_view(&moment);
                    let data = session.player.application_data();
                    session.display = Some(Display {
                        renderer: R::begin(&self.device)?,
                        controls: Controls::new(&camera, up, pivot),
                        trust: read_trust(data),
                        background: read_background(data).map(|level| f32::from(level) / 255.0),
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
    pub fn draw(&mut self, size: [usize; 2], target: &R::Target) -> Result<Option<FrameReport>, PlayError> {
        match self.camera(size) {
            Some(camera) => self.draw_views(&camera, &[(&camera, target)]),
            None => R::clear(&self.device, target, self.background.unwrap_or_default()).map(|()| None),
        }
    }

    /// Draws several pictures of the timestep that [`Self::draw`] would draw, such as those of both eyes.
    ///
    /// - `sorter`: camera of the order, and of colours that depend on the direction of view. It must see what any
    ///   picture shows
    /// - `views`: camera and target of each picture
    /// - returns: `None` as long as there is no picture; the targets are unchanged then
    ///
    /// # Errors
    /// [`PlayError::Gpu`] if the GPU fails.
    pub fn draw_views(
        &mut self,
        sorter: &Camera,
        views: &[(&Camera, &R::Target)],
    ) -> Result<Option<FrameReport>, PlayError> {
        let Some(Session { player, display: Some(display) }) = &mut self.session else { return Ok(None) };
        player.look(sorter);
        let (moment, light) = (&display.shown, player.light(&display.shown));
        let background = self.background.unwrap_or(display.background);
        for &(camera, target) in views {
            display.renderer.draw(&PictureRequest { moment, camera, background, light }, target)?;
        }
        Ok(player.clock().map(|clock| FrameReport {
            time: clock.position(),
            seconds: clock.seconds(),
            timestep: clock.timestep(),
            is_playing: clock.is_playing(),
            is_buffering: player.is_buffering(),
            is_drawn: player.is_due(&display.shown, sorter) && display.renderer.is_whole(),
            doubt: display.doubt(sorter.center()),
        }))
    }

    /// Submits the drawing of a picture whose pixels are read back.
    ///
    /// - `size`: width and height of the picture, pixels
    /// - returns: `None` as long as the due timestep has not arrived
    ///
    /// # Errors
    /// [`PlayError::Gpu`] if the GPU fails.
    pub fn begin_still(&mut self, size: [usize; 2]) -> Result<Option<R::Still>, PlayError> {
        let Some(Session { player, display: Some(display) }) = &mut self.session else { return Ok(None) };
        let camera = display.controls.camera(size);
        player.look(&camera);
        let Some(moment) = player.current().filter(|moment| player.is_due(moment, &camera)) else { return Ok(None) };
        let (background, light) = (self.background.unwrap_or(display.background), player.light(&moment));
        let request = PictureRequest { moment: &moment, camera: &camera, background, light };
        Ok(Some(display.renderer.begin_still(&request)?))
    }

    /// Takes the pixels of a still that is ready, as [`Renderer::finish_still`] does.
    ///
    /// # Errors
    /// [`PlayError::Gpu`] if the GPU fails.
    pub fn finish_still(&mut self, still: &R::Still) -> Result<Option<Vec<u8>>, PlayError> {
        match &mut self.session {
            Some(Session { display: Some(display), .. }) => display.renderer.finish_still(still),
            _ => Ok(None),
        }
    }

    /// Sets the colour behind all Gaussians.
    ///
    /// - `background`: sRGB in `[0, 1]`; None, at first: the scene's own, and black before it is known
    pub fn set_background(&mut self, background: Option<[f32; 3]>) {
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

    /// How little pictures from a position can be trusted, as [`FrameReport::doubt`].
    ///
    /// - `position`: in the world, scene units
    pub fn doubt(&self, position: [f64; 3]) -> f64 {
        let display = self.session.as_ref().and_then(|session| session.display.as_ref());
        display.map_or(0.0, |display| display.doubt(position))
    }

    /// Moves the camera a part of the way to the nearest position from which pictures can be trusted. Does nothing if
    /// the file does not say which positions these are.
    ///
    /// - `share`: of the way, in `[0, 1]`
    pub fn lead_back(&mut self, share: f64) {
        let display = self.session.as_mut().and_then(|session| session.display.as_mut());
        if let Some(Display { controls, trust: Some(trust), .. }) = display {
            controls.approach(trust.nearest(controls.position()), share);
        }
    }

    /// The timestep that is drawn, once there is a picture.
    pub fn shown(&self) -> Option<&F::Moment> {
        Some(&self.session.as_ref()?.display.as_ref()?.shown)
    }

    /// The view at the start, once there is a picture.
    pub fn start_view(&self) -> Option<StartView> {
        Some(self.session.as_ref()?.display.as_ref()?.controls.start_view())
    }

    /// The camera for a picture of some size, once there is a picture.
    ///
    /// - `size`: width and height, pixels
    pub fn camera(&self, size: [usize; 2]) -> Option<Camera> {
        Some(self.session.as_ref()?.display.as_ref()?.controls.camera(size))
    }
}
