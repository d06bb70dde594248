//! The bytes of a file on a server, or of a file that a person picked.

use std::cell::RefCell;
use std::ops::Range;
use std::rc::Rc;
#[cfg(feature = "webgpu")]
use std::task::Waker;

use js_sys::{Reflect, Uint8Array};
use wasm_bindgen::{JsCast, JsValue};
use wasm_bindgen_futures::{JsFuture, spawn_local};

use super::global::fetch;
use crate::download::{AnswerHead, Inbox};
use crate::source::{Piece, RangeSource, SourceError};

/// Where a file is.
#[derive(Clone, Debug)]
enum FileLocation {
    Url(String),
    Blob(web_sys::Blob),
}

/// A file on a server, which is fetched by HTTP ranges, or a file that a person picked.
#[derive(Debug)]
pub struct WebSource {
    location: FileLocation,
    inbox: Rc<RefCell<Inbox>>,
    /// Aborts the request that is under way.
    abort: Option<web_sys::AbortController>,
}

impl WebSource {
    /// - `given`: an address, or a `Blob`
    ///
    /// # Errors
    /// [`SourceError::NoFile`] if it is neither.
    pub fn new(given: &JsValue) -> Result<Self, SourceError> {
        let (location, length) = if let Some(url) = given.as_string() {
            (FileLocation::Url(url), None)
        } else {
            let blob = given.dyn_ref::<web_sys::Blob>().ok_or(SourceError::NoFile)?.clone();
            let length = blob.size() as u64;
            (FileLocation::Blob(blob), Some(length))
        };
        Ok(Self { location, inbox: Rc::new(RefCell::new(Inbox::new(length))), abort: None })
    }

    /// Takes the waker that the next piece wakes.
    #[cfg(feature = "webgpu")]
    pub fn wakes(&self) -> impl Fn(Waker) + use<> {
        let inbox = self.inbox.clone();
        move |waker| inbox.borrow_mut().wake_by(waker)
    }

    fn end_request(&mut self) {
        if let Some(abort) = self.abort.take() {
            abort.abort();
        }
    }
}

impl Drop for WebSource {
    fn drop(&mut self) {
        self.inbox.borrow_mut().forget();
        self.end_request();
    }
}

impl RangeSource for WebSource {
    fn request(&mut self, range: Range<u64>) {
        let Some(request) = self.inbox.borrow_mut().ask(range.clone()) else { return };
        self.end_request();
        let inbox = self.inbox.clone();
        match &self.location {
            FileLocation::Blob(blob) => {
                let blob = blob.clone();
                spawn_local(async move {
                    let read = read_blob(&blob, range).await;
                    let mut inbox = inbox.borrow_mut();
                    let result = read.map(|bytes| inbox.add(request, bytes));
                    inbox.end(request, result);
                });
            }
            FileLocation::Url(url) => {
                let abort = web_sys::AbortController::new().ok();
                let signal = abort.as_ref().map(web_sys::AbortController::signal);
                self.abort = abort;
                let url = url.clone();
                spawn_local(async move {
                    let result = download(&inbox, request, &url, range, signal.as_ref()).await;
                    inbox.borrow_mut().end(request, result);
                });
            }
        }
    }

    fn poll(&mut self) -> Result<Piece, SourceError> {
        self.inbox.borrow_mut().poll()
    }

    fn length(&self) -> Option<u64> {
        self.inbox.borrow().length()
    }
}

async fn read_blob(blob: &web_sys::Blob, range: Range<u64>) -> Result<Vec<u8>, SourceError> {
    let read = async {
        let part = blob.slice_with_f64_and_f64(range.start as f64, range.end as f64)?;
        JsFuture::from(part.array_buffer()).await
    };
    match read.await {
        Ok(buffer) => Ok(Uint8Array::new(&buffer).to_vec()),
        Err(error) => Err(SourceError::Refused { what: "the file".into(), problem: describe(&error) }),
    }
}

async fn download(
    inbox: &Rc<RefCell<Inbox>>,
    request: u64,
    url: &str,
    range: Range<u64>,
    signal: Option<&web_sys::AbortSignal>,
) -> Result<(), SourceError> {
    let interrupted = |error: JsValue| SourceError::Interrupted { what: url.into(), problem: describe(&error) };
    let headers = web_sys::Headers::new().map_err(interrupted)?;
    headers.set("Range", &format!("bytes={}-{}", range.start, range.end - 1)).map_err(interrupted)?;
    let options = web_sys::RequestInit::new();
    options.set_headers(&headers);
    options.set_signal(signal);
    let answer = JsFuture::from(fetch(url, &options)).await.map_err(interrupted)?;
    let answer: web_sys::Response = answer.dyn_into().map_err(interrupted)?;
    if !inbox.borrow().is_current(request) {
        return Ok(());
    }
    if !inbox.borrow_mut().begin(url, head(&answer))? {
        return Ok(());
    }
    let Some(body) = answer.body() else { return Ok(()) };
    let reader: web_sys::ReadableStreamDefaultReader = body.get_reader().unchecked_into();
    loop {
        let result = JsFuture::from(reader.read()).await.map_err(interrupted)?;
        let mut inbox = inbox.borrow_mut();
        let is_done = Reflect::get(&result, &"done".into()).is_ok_and(|done| done.is_truthy());
        if is_done || !inbox.is_current(request) {
            return Ok(());
        }
        let bytes = Reflect::get(&result, &"value".into()).map_err(interrupted)?;
        inbox.add(request, Uint8Array::new(&bytes).to_vec());
    }
}

fn head(answer: &web_sys::Response) -> AnswerHead {
    let header = |name: &str| answer.headers().get(name).ok().flatten();
    // A compressed answer has a different length from the file, and often a tag of its own.
    let is_encoded = header("content-encoding").is_some();
    let length = if answer.status() == 200 {
        header("content-length").filter(|_| !is_encoded)
    } else {
        // The answer is a part, and its header names the length of the whole file.
        header("content-range").and_then(|range| Some(range.rsplit_once('/')?.1.to_owned()))
    };
    // `Last-Modified` is preferred to `ETag`: the machines behind one address may tag the same file differently, and a
    // cross-origin answer may hide its tag. Some servers mark a tag as weak in some answers only.
    let tag = || header("etag").filter(|_| !is_encoded).map(|etag| etag.trim_start_matches("W/").to_owned());
    AnswerHead {
        status: answer.status(),
        status_text: answer.status_text(),
        length: length.and_then(|length| length.trim().parse().ok()),
        version: header("last-modified").or_else(tag),
    }
}

fn describe(error: &JsValue) -> String {
    let message = Reflect::get(error, &"message".into()).ok().and_then(|message| message.as_string());
    message.unwrap_or_else(|| format!("{error:?}"))
}
