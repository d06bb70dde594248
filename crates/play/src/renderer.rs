//! The interface between viewer and renderer. `segment_renderer` draws with wgpu; `web/webgl2` with WebGL2.

use tcgs_core::Camera;

use crate::error::PlayError;

/// A picture to draw: timestep, camera and background.
///
/// `M`: a timestep in the form that the renderer draws, [`Renderer::Moment`].
#[derive(Clone, Copy, Debug)]
pub struct PictureRequest<'a, M> {
    /// A timestep of the renderer's scene.
    pub moment: &'a M,
    /// Camera; its image size is the size of the picture.
    pub camera: &'a Camera,
    /// Colour behind all Gaussians, sRGB in `[0, 1]`; not multiplied by `light`.
    pub background: [f32; 3],
    /// Gains of the Gaussians' red, green and blue ([`tcgs_codec::Light`]), above 0.
    pub light: [f32; 3],
}

/// Draws the timesteps of one scene.
pub trait Renderer: Sized {
    /// A timestep in the form that this renderer draws.
    type Moment;
    /// The parts that outlive a scene.
    type Device;
    /// The place to draw to.
    type Target;
    /// A picture on its way to its pixels.
    type Still;

    /// A renderer of another scene, which has uploaded nothing yet.
    ///
    /// # Errors
    /// [`PlayError::Gpu`] if nothing at all fits, or the GPU fails.
    fn begin(device: &Self::Device) -> Result<Self, PlayError>;

    /// Fills a target with one colour, for as long as there is no scene.
    ///
    /// # Errors
    /// [`PlayError::Gpu`] if the GPU fails.
    fn clear(device: &Self::Device, target: &Self::Target, color: [f32; 3]) -> Result<(), PlayError>;

    /// Draws a picture without waiting for the GPU.
    ///
    /// - `target`: of the size of the camera's image
    ///
    /// # Errors
    /// [`PlayError::Gpu`] if the GPU fails, or its memory is full.
    fn draw(&mut self, request: &PictureRequest<'_, Self::Moment>, target: &Self::Target) -> Result<(), PlayError>;

    /// Whether nothing was left out of the last picture of which this is known.
    fn is_whole(&self) -> bool;

    /// Draws a picture whose pixels are read back, without waiting for the GPU.
    ///
    /// # Errors
    /// As [`Self::draw`].
    fn begin_still(&mut self, request: &PictureRequest<'_, Self::Moment>) -> Result<Self::Still, PlayError>;

    /// Takes the pixels of a still that is ready.
    ///
    /// - returns: `[H, W, 4]` RGBA, 8 bits each, rows from the top; `None` if the caller has to draw it again
    ///
    /// # Errors
    /// As [`Self::draw`].
    fn finish_still(&mut self, still: &Self::Still) -> Result<Option<Vec<u8>>, PlayError>;
}
