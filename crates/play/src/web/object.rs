//! Between plain JavaScript objects and what the player has.

use js_sys::{Array, Error, Object, Reflect};
use tcgs_core::Camera;
use wasm_bindgen::JsValue;

use crate::error::PlayError;

/// An object of these properties.
pub fn object<const K: usize>(properties: [(&str, JsValue); K]) -> JsValue {
    let object = Object::new();
    for (name, value) in properties {
        set(&object, name, &value);
    }
    object.into()
}

/// Sets a property.
pub fn set(object: &Object, name: &str, value: &JsValue) {
    // It fails on frozen objects alone, and these are our own.
    let _ = Reflect::set(object, &name.into(), value);
}

/// An `Error` with a `code`.
pub fn error(code: &str, message: &str) -> JsValue {
    let error = Error::new(message);
    set(&error, "code", &code.into());
    error.into()
}

impl From<PlayError> for JsValue {
    fn from(problem: PlayError) -> Self {
        error(problem.code(), &problem.to_string())
    }
}

/// `{width, height, fx, fy, cx, cy, cameraFromWorld}`
pub fn camera_object(camera: &Camera) -> JsValue {
    let matrix: Array = camera.camera_from_world.as_flattened().iter().map(|&x| JsValue::from_f64(x)).collect();
    object([
        ("width", (camera.width as f64).into()),
        ("height", (camera.height as f64).into()),
        ("fx", camera.focal[0].into()),
        ("fy", camera.focal[1].into()),
        ("cx", camera.principal[0].into()),
        ("cy", camera.principal[1].into()),
        ("cameraFromWorld", matrix.into()),
    ])
}

/// Reads what [`camera_object`] writes.
pub fn camera_of(given: &JsValue) -> Result<Camera, PlayError> {
    let bad = |problem: String| PlayError::BadCamera(problem);
    let number = |name: &str| {
        let value = Reflect::get(given, &name.into()).ok().and_then(|value| value.as_f64());
        value.ok_or_else(|| bad(format!("{name} of the camera is missing, expected a number")))
    };
    let matrix = Reflect::get(given, &"cameraFromWorld".into()).unwrap_or(JsValue::UNDEFINED);
    let values: Vec<f64> = if Array::is_array(&matrix) {
        Array::from(&matrix).iter().map(|value| value.as_f64().unwrap_or(f64::NAN)).collect()
    } else {
        Vec::new()
    };
    let values: [f64; 16] = values.try_into().map_err(|values: Vec<f64>| {
        bad(format!("cameraFromWorld has {} numbers, expected 16 in rows", values.len()))
    })?;
    let [fx, fy, cx, cy] = [number("fx")?, number("fy")?, number("cx")?, number("cy")?];
    let intrinsics = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| values[4 * i + j]));
    // Nonsense becomes 0, which is refused.
    let [width, height] = [number("width")? as usize, number("height")? as usize];
    Camera::new(width, height, intrinsics, rows).map_err(|error| bad(error.to_string()))
}
