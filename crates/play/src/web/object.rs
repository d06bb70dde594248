//! Conversions between plain JavaScript objects and the types of the player.

use js_sys::{Array, Error, Object, Reflect};
use tcgs_core::Camera;
use wasm_bindgen::JsValue;

use crate::error::{BadCamera, PlayError};

/// A JavaScript object with these properties.
pub fn object<const K: usize>(properties: [(&str, JsValue); K]) -> JsValue {
    let object = Object::new();
    for (name, value) in properties {
        set(&object, name, &value);
    }
    object.into()
}

/// Sets a property of an object.
pub fn set(object: &Object, name: &str, value: &JsValue) {
    // Only frozen objects make this fail, and all objects here are our own.
    let _ = Reflect::set(object, &name.into(), value);
}

impl From<PlayError> for JsValue {
    /// A JavaScript `Error` whose property `code` is [`PlayError::code`]. The page has the text for people.
    fn from(problem: PlayError) -> Self {
        let error = Error::new(&problem.to_string());
        set(&error, "code", &problem.code().as_str().into());
        error.into()
    }
}

/// An array of three numbers.
#[cfg(not(feature = "webgpu"))]
pub fn vector(values: [f64; 3]) -> JsValue {
    values.into_iter().map(JsValue::from_f64).collect::<Array>().into()
}

/// The object `{width, height, fx, fy, cx, cy, cameraFromWorld}` of a camera: pixels, and 16 numbers in rows.
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

/// Reads a camera from an object in the form of [`camera_object`]; its matrix may be any array, typed or not.
pub fn camera_of(given: &JsValue) -> Result<Camera, BadCamera> {
    let number = |field: &'static str| {
        let value = Reflect::get(given, &field.into()).ok().and_then(|value| value.as_f64());
        value.ok_or(BadCamera::Missing { field })
    };
    let matrix = Reflect::get(given, &"cameraFromWorld".into()).unwrap_or(JsValue::UNDEFINED);
    let values: Vec<f64> = if matrix.is_object() {
        Array::from(&matrix).iter().map(|value| value.as_f64().unwrap_or(f64::NAN)).collect()
    } else {
        Vec::new()
    };
    let values: [f64; 16] = values.try_into().map_err(|values: Vec<f64>| BadCamera::Matrix(values.len()))?;
    let [fx, fy, cx, cy] = [number("fx")?, number("fy")?, number("cx")?, number("cy")?];
    let intrinsics = [[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]];
    let rows = std::array::from_fn(|i| std::array::from_fn(|j| values[4 * i + j]));
    // The cast maps negative numbers and NaN to 0, which is refused.
    let [width, height] = [number("width")? as usize, number("height")? as usize];
    Ok(Camera::new(width, height, intrinsics, rows)?)
}
