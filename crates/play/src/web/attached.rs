//! Data attached to a file, for a page: credits, and named data such as a sound.

use js_sys::{Array, Uint8Array};
use tcgs_codec::{Archive, read_credits, read_times};
use wasm_bindgen::prelude::*;

use super::object::object;
use super::{ViewerState, WebViewer};
use crate::error::PlayError;
use crate::player::application_ranges;

#[wasm_bindgen(js_class = Viewer)]
impl WebViewer {
    /// Named data that came with the start of the file; undefined if there are none.
    pub fn data(&self, name: &str) -> Option<Uint8Array> {
        let state = self.state.borrow();
        let mut data = state.viewer.application_data().iter();
        data.find(|(of, _)| of == name).map(|(_, bytes)| Uint8Array::from(&bytes[..]))
    }

    /// Byte ranges of the application data that did not come with the start of the file, as pairs: first byte, and the
    /// one after the last. A page fetches them itself and gives them to `farData`.
    #[wasm_bindgen(js_name = farRanges)]
    pub fn far_ranges(&self) -> Array {
        let state = self.state.borrow();
        let Some(archive) = state.viewer.archive() else { return Array::new() };
        let pair = |(_, range): (usize, std::ops::Range<u64>)| {
            Array::of2(&(range.start as f64).into(), &(range.end as f64).into())
        };
        far(archive).map(pair).collect()
    }

    /// Name and content of fetched data: `{name, data}`; null if they have no name. Throws an error of code `damaged`
    /// if their checksum is wrong.
    ///
    /// - `index`: place in `farRanges`
    #[wasm_bindgen(js_name = farData)]
    pub fn far_data(&self, index: usize, bytes: &[u8]) -> Result<JsValue, JsValue> {
        let state = self.state.borrow();
        let Some(archive) = state.viewer.archive() else { return Ok(JsValue::NULL) };
        let Some((index, _)) = far(archive).nth(index) else { return Ok(JsValue::NULL) };
        let read = archive.read_application(index, bytes).map_err(PlayError::from)?;
        let entry =
            |(name, data): (String, &[u8])| object([("name", name.into()), ("data", Uint8Array::from(data).into())]);
        Ok(read.map_or(JsValue::NULL, entry))
    }
}

impl ViewerState {
    /// Seconds of the timesteps; null if they are evenly spaced.
    pub(super) fn times(&self) -> JsValue {
        let num_timesteps = self.viewer.info().map_or(0, |info| info.num_timesteps as usize);
        let times = read_times(self.viewer.application_data(), num_timesteps);
        times.map_or(JsValue::NULL, |times| times.into_iter().map(JsValue::from_f64).collect::<Array>().into())
    }

    /// `{licence, authors, source}`; absent entries are null or empty. Null without credits.
    pub(super) fn credits(&self) -> JsValue {
        let Some(credits) = read_credits(self.viewer.application_data()) else { return JsValue::NULL };
        let text = |text: Option<String>| text.map_or(JsValue::NULL, JsValue::from);
        object([
            ("licence", text(credits.licence)),
            ("authors", credits.authors.into_iter().map(JsValue::from).collect::<Array>().into()),
            ("source", text(credits.source)),
        ])
    }
}

/// Index and range of the data of applications that do not come with the start of the file.
fn far(archive: &Archive) -> impl Iterator<Item = (usize, std::ops::Range<u64>)> {
    let num_near = application_ranges(archive).count();
    archive.application_ranges().into_iter().enumerate().skip(num_near)
}
