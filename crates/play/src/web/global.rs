//! Functions that windows and workers have in common.

use js_sys::{Function, Promise};
use wasm_bindgen::prelude::*;

#[wasm_bindgen]
extern "C" {
    /// Requests an address.
    pub fn fetch(url: &str, options: &web_sys::RequestInit) -> Promise;

    /// Calls a function after some milliseconds.
    #[wasm_bindgen(js_name = setTimeout)]
    pub fn set_timeout(handler: &Function, ms: i32) -> JsValue;

    /// Milliseconds since an origin that never changes.
    #[wasm_bindgen(js_namespace = performance, js_name = now)]
    pub fn now_ms() -> f64;
}
