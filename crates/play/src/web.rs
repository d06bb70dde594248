//! What a page sees of the player.

use tcgs_render::gpu::Gpu;
use wasm_bindgen::prelude::*;

/// A scene on a canvas.
#[wasm_bindgen]
pub struct Viewer {
    gpu: Gpu,
    surface: wgpu::Surface<'static>,
}

#[wasm_bindgen]
impl Viewer {
    /// Opens the GPU.
    pub async fn create(canvas: web_sys::HtmlCanvasElement) -> Result<Viewer, JsValue> {
        let (gpu, surface) = Gpu::of_canvas(canvas).await.map_err(|e| JsValue::from_str(&e.to_string()))?;
        Ok(Self { gpu, surface })
    }
}
