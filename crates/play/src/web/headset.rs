//! Pictures for the eyes of a headset, and where a scene stands.

use js_sys::{Array, Reflect};
use tcgs_core::Camera;
use wasm_bindgen::prelude::*;
use web_sys::WebGlFramebuffer;

use super::WebViewer;
use super::drawing::{Edge, Place};
use super::object::{camera_object, camera_of, object, vector};
use crate::arrange::ground;
use crate::error::PlayError;

#[wasm_bindgen(js_class = Viewer)]
impl WebViewer {
    /// Lets time pass and draws once for each eye, in place of `frame`; throws and returns what that does.
    ///
    /// - `framebuffer`: of an `XRWebGLLayer` of the canvas' context; null: the canvas
    /// - `sorter`: camera whose order serves all eyes, in the form of `camera()`; it must see what any eye sees
    /// - `eyes`: an array of cameras in that form, each with the left and lower edge `x`, `y` of its part of the
    ///   framebuffer besides, pixels
    /// - `shows_doubt`: whether an edge shows how little the pictures can be trusted
    #[wasm_bindgen(js_name = frameOfEyes)]
    pub fn frame_of_eyes(
        &self,
        now_ms: f64,
        framebuffer: Option<WebGlFramebuffer>,
        sorter: &JsValue,
        eyes: &Array,
        shows_doubt: bool,
    ) -> Result<JsValue, JsValue> {
        let number = |eye: &JsValue, name: &str| Reflect::get(eye, &name.into()).ok().and_then(|found| found.as_f64());
        let sorter = camera_of(sorter).map_err(PlayError::from)?;
        let mut state = self.state.borrow_mut();
        state.update(now_ms)?;
        let doubt = if shows_doubt { state.viewer.doubt(sorter.center()) } else { 0.0 };
        let eyes: Vec<(Camera, Place)> = eyes
            .iter()
            .map(|eye| {
                let camera = camera_of(&eye).map_err(PlayError::from)?;
                let corner = ["x", "y"].map(|name| number(&eye, name).unwrap_or(0.0) as i32);
                let size = [camera.width, camera.height];
                let edge = (doubt > 0.0).then(|| Edge::new(&camera, doubt));
                Ok((camera, Place { framebuffer: framebuffer.clone(), corner, size, edge }))
            })
            .collect::<Result<_, PlayError>>()?;
        let views: Vec<(&Camera, &Place)> = eyes.iter().map(|(camera, place)| (camera, place)).collect();
        state.canvas.check()?;
        let drawn = state.viewer.draw_views(&sorter, &views)?;
        Ok(state.report(drawn.as_ref()))
    }

    /// Where the open scene stands: `{camera, pivot, up, ground}`; null while no scene is open.
    ///
    /// - `camera`: of the start view, in the form of `camera()`; `pivot`: the point around which it orbits
    /// - `up`: unit direction in the world
    /// - `ground`: height of the lowest Gaussians along `up`, scene units from the origin; null without Gaussians
    pub fn standing(&self) -> JsValue {
        let state = self.state.borrow();
        let (Some(start), Some(moment)) = (state.viewer.start_view(), state.viewer.shown()) else {
            return JsValue::NULL;
        };
        object([
            ("camera", camera_object(&start.camera)),
            ("pivot", vector(start.pivot)),
            ("up", vector(start.up)),
            ("ground", ground(&moment.rows.to_vec(), start.up).map_or(JsValue::NULL, JsValue::from_f64)),
        ])
    }
}
