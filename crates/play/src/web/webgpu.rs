//! The canvas with WebGPU; scenes are decoded on the thread of the page.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::task::Waker;

use tcgs_render::gpu::Gpu;
use wasm_bindgen::JsValue;

use super::source::WebSource;
use crate::error::PlayError;
use crate::player::{Player, PlayerSettings};
use crate::segment_renderer::{SegmentRenderer, Still};
use crate::viewer::{FrameReport, Viewer};

/// From an address or a file to timesteps.
pub type ScenePlayer = Player<WebSource>;
/// Draws them.
pub type CanvasRenderer = SegmentRenderer;

/// A canvas and the GPU that draws on it.
pub struct Canvas {
    gpu: Gpu,
    surface: wgpu::Surface<'static>,
    format: wgpu::TextureFormat,
    size: [usize; 2],
    /// Frames submitted to the GPU, modulo 2³².
    num_drawn: u32,
    /// Frames that the GPU has finished, modulo 2³².
    num_finished: Arc<AtomicU32>,
}

impl Canvas {
    /// Opens the browser's GPU for a canvas.
    pub async fn create(
        canvas: web_sys::HtmlCanvasElement,
        _: JsValue,
    ) -> Result<(Self, (Gpu, wgpu::TextureFormat)), PlayError> {
        let (gpu, surface, format) = Gpu::of_canvas(canvas).await?;
        let device = (gpu.clone(), format);
        Ok((Self { gpu, surface, format, size: [0, 0], num_drawn: 0, num_finished: Arc::default() }, device))
    }

    /// A player of an address or a file, and a function that takes the waker which its next bytes wake.
    pub fn player(
        &mut self,
        source: &JsValue,
        first_timestep: usize,
    ) -> Result<(ScenePlayer, impl Fn(Waker) + use<>), PlayError> {
        let source = WebSource::new(source)?;
        let wake_by = source.wakes();
        Ok((Player::new(source, PlayerSettings::default(), first_timestep), wake_by))
    }

    /// Sets the canvas' size in device pixels, or the nearest that the GPU allows; returns it.
    pub fn resize(&mut self, size: [usize; 2]) -> [usize; 2] {
        let most = self.gpu.device().limits().max_texture_dimension_2d as usize;
        let size = size.map(|side| side.min(most));
        if self.size != size {
            self.size = size;
            self.configure();
        }
        size
    }

    fn configure(&self) {
        self.surface.configure(
            self.gpu.device(),
            &wgpu::SurfaceConfiguration {
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
                format: self.format,
                color_space: wgpu::SurfaceColorSpace::Auto,
                width: self.size[0] as u32,
                height: self.size[1] as u32,
                present_mode: wgpu::PresentMode::Fifo,
                desired_maximum_frame_latency: 2,
                alpha_mode: wgpu::CompositeAlphaMode::Opaque,
                view_formats: Vec::new(),
            },
        );
    }

    /// Draws a frame.
    pub fn draw(
        &mut self,
        viewer: &mut Viewer<ScenePlayer, CanvasRenderer>,
        size: [usize; 2],
    ) -> Result<Option<FrameReport>, PlayError> {
        let texture = match self.surface.get_current_texture() {
            wgpu::CurrentSurfaceTexture::Success(texture) | wgpu::CurrentSurfaceTexture::Suboptimal(texture) => texture,
            _ => {
                self.gpu.check()?;
                return Ok(None);
            }
        };
        let view = texture.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let frame = viewer.draw(size, &view)?;
        self.num_drawn = self.num_drawn.wrapping_add(1);
        let finished = self.num_finished.clone();
        self.gpu.queue().on_submitted_work_done(move || {
            finished.fetch_add(1, Ordering::Relaxed);
        });
        self.gpu.queue().present(texture);
        Ok(frame)
    }

    /// Number of frames that the GPU has not finished yet.
    pub fn pending(&mut self) -> u32 {
        self.num_drawn.wrapping_sub(self.num_finished.load(Ordering::Relaxed))
    }

    /// Whether the GPU still works.
    pub fn check(&self) -> Result<(), PlayError> {
        Ok(self.gpu.check()?)
    }
}

/// Whether the pixels of a still have arrived.
pub fn is_ready(still: &Still) -> bool {
    still.is_ready()
}
