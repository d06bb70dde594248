//! Camera paths as the page sees them: the class `CameraPath`.

use js_sys::Array;
use tcgs_core::CameraPath;
use wasm_bindgen::prelude::*;

use super::object::{camera_object, camera_of, object};
use crate::PlayError;

/// Cameras at timesteps, and the smooth motion between them: the interpolation that `tcgs render --path` uses. It needs
/// neither a GPU nor a scene.
#[wasm_bindgen(js_name = CameraPath)]
#[derive(Debug, Default)]
pub struct WebCameraPath {
    path: CameraPath,
}

#[wasm_bindgen(js_class = CameraPath)]
impl WebCameraPath {
    /// A path without keyframes.
    #[wasm_bindgen(constructor)]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a keyframe, in place of any at the same timestep. Throws an error of code `bad-camera` if the timestep is
    /// not a finite number or the camera is not valid.
    ///
    /// - `camera`: in the form of `Viewer.camera()`
    pub fn insert(&mut self, timestep: f64, camera: &JsValue) -> Result<(), JsValue> {
        let camera = camera_of(camera).map_err(PlayError::from)?;
        Ok(self.path.insert(timestep, camera).map_err(PlayError::from)?)
    }

    /// All keyframes by increasing timestep: `[{timestep, camera}]`.
    pub fn keyframes(&self) -> Array {
        let keyframes = self.path.keyframes().iter();
        keyframes
            .map(|keyframe| {
                object([("timestep", keyframe.timestep.into()), ("camera", camera_object(&keyframe.camera))])
            })
            .collect()
    }

    /// The camera at a timestep, for a picture of this size in pixels. Throws an error of code `bad-camera` if there is
    /// none: without keyframes, or halfway between two opposite directions.
    #[wasm_bindgen(js_name = cameraAt)]
    pub fn camera_at(&self, timestep: f64, width: u32, height: u32) -> Result<JsValue, JsValue> {
        let size = [width.max(1) as usize, height.max(1) as usize];
        let camera = self.path.camera_at(timestep, size).map_err(PlayError::from)?;
        Ok(camera_object(&camera))
    }
}
