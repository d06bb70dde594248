//! Bytes of a file on a server, or of one that a person picked.
//!
//! A server is asked for ranges. One that sends the whole file instead is heard out once; ranges are then taken from
//! what it sent.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::ops::Range;
use std::rc::Rc;
use std::task::Waker;

use js_sys::{Reflect, Uint8Array};
use wasm_bindgen::{JsCast, JsValue};
use wasm_bindgen_futures::{JsFuture, spawn_local};

use crate::source::{Piece, Source, SourceError};

/// Where the file is.
#[derive(Clone, Debug)]
enum Place {
    Url(String),
    Blob(web_sys::Blob),
}

/// What tasks leave for [`Source::poll`].
#[derive(Debug, Default)]
struct Inbox {
    /// Counts requests: what belongs to an earlier one is dropped.
    request: u64,
    pieces: VecDeque<Result<Piece, SourceError>>,
    length: Option<u64>,
    whole: Option<Whole>,
    /// Who waits for the next piece.
    waker: Option<Waker>,
}

/// A download of the whole file.
#[derive(Debug, Default)]
struct Whole {
    bytes: Vec<u8>,
    is_complete: bool,
}

impl Inbox {
    fn tell(&mut self, request: u64, piece: Result<Piece, SourceError>) {
        if self.request == request {
            self.pieces.push_back(piece);
            self.wake();
        }
    }

    fn wake(&mut self) {
        if let Some(waker) = self.waker.take() {
            waker.wake();
        }
    }
}

/// A file on a server, or one that a person picked.
#[derive(Debug)]
pub struct WebSource {
    place: Place,
    inbox: Rc<RefCell<Inbox>>,
    /// Ends the request that is under way.
    abort: Option<web_sys::AbortController>,
    /// What is left of the range when a whole download serves it.
    rest: Range<u64>,
}

impl WebSource {
    /// - `given`: an address, or a `Blob`
    pub fn new(given: &JsValue) -> Option<Self> {
        let (place, length) = if let Some(url) = given.as_string() {
            (Place::Url(url), None)
        } else {
            let blob = given.dyn_ref::<web_sys::Blob>()?.clone();
            let length = blob.size() as u64;
            (Place::Blob(blob), Some(length))
        };
        let inbox = Inbox { length, ..Inbox::default() };
        Some(Self { place, inbox: Rc::new(RefCell::new(inbox)), abort: None, rest: 0..0 })
    }

    /// What hears of the next piece.
    pub fn wakes(&self) -> impl Fn(Waker) + use<> {
        let inbox = self.inbox.clone();
        move |waker| inbox.borrow_mut().waker = Some(waker)
    }

    fn has_whole(&self) -> bool {
        self.inbox.borrow().whole.is_some()
    }

    fn end_request(&mut self) {
        if let Some(abort) = self.abort.take() {
            abort.abort();
        }
    }
}

impl Drop for WebSource {
    fn drop(&mut self) {
        self.inbox.borrow_mut().request += 1;
        self.end_request();
    }
}

impl Source for WebSource {
    fn request(&mut self, range: Range<u64>) {
        if self.has_whole() {
            self.rest = range;
            return;
        }
        self.end_request();
        self.rest = range.clone();
        let request = {
            let mut inbox = self.inbox.borrow_mut();
            inbox.request += 1;
            inbox.pieces.clear();
            inbox.request
        };
        let inbox = self.inbox.clone();
        match &self.place {
            Place::Blob(blob) => {
                let blob = blob.clone();
                spawn_local(async move {
                    let piece = read_blob(&blob, range).await;
                    let mut inbox = inbox.borrow_mut();
                    let is_read = piece.is_ok();
                    inbox.tell(request, piece);
                    if is_read {
                        inbox.tell(request, Ok(Piece::End));
                    }
                });
            }
            Place::Url(url) => {
                let abort = web_sys::AbortController::new().ok();
                let signal = abort.as_ref().map(web_sys::AbortController::signal);
                self.abort = abort;
                let url = url.clone();
                spawn_local(async move {
                    let told = download(&inbox, request, &url, range, signal.as_ref()).await;
                    let mut inbox = inbox.borrow_mut();
                    match told {
                        Ok(()) => inbox.tell(request, Ok(Piece::End)),
                        Err(error) => inbox.tell(request, Err(error)),
                    }
                });
            }
        }
    }

    fn poll(&mut self) -> Result<Piece, SourceError> {
        let mut inbox = self.inbox.borrow_mut();
        let Inbox { whole, pieces, .. } = &mut *inbox;
        if let Some(whole) = whole {
            let end = self.rest.end.min(whole.bytes.len() as u64);
            if self.rest.start < end {
                let bytes = whole.bytes[self.rest.start as usize..end as usize].to_vec();
                self.rest.start = end;
                return Ok(Piece::Bytes(bytes));
            }
            if whole.is_complete || self.rest.is_empty() {
                return Ok(Piece::End);
            }
        }
        pieces.pop_front().unwrap_or(Ok(Piece::Waiting))
    }

    fn length(&self) -> Option<u64> {
        self.inbox.borrow().length
    }
}

async fn read_blob(blob: &web_sys::Blob, range: Range<u64>) -> Result<Piece, SourceError> {
    let read = async {
        let part = blob.slice_with_f64_and_f64(range.start as f64, range.end as f64)?;
        JsFuture::from(part.array_buffer()).await
    };
    match read.await {
        Ok(buffer) => {
            let bytes = Uint8Array::new(&buffer).to_vec();
            Ok(if bytes.is_empty() { Piece::End } else { Piece::Bytes(bytes) })
        }
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
    let refused = |problem: String| SourceError::Refused { what: url.into(), problem };

    let headers = web_sys::Headers::new().map_err(interrupted)?;
    headers.set("Range", &format!("bytes={}-{}", range.start, range.end - 1)).map_err(interrupted)?;
    let options = web_sys::RequestInit::new();
    options.set_headers(&headers);
    options.set_signal(signal);
    let window = web_sys::window().ok_or_else(|| refused("there is no window".into()))?;
    let answer = JsFuture::from(window.fetch_with_str_and_init(url, &options)).await.map_err(interrupted)?;
    let answer: web_sys::Response = answer.dyn_into().map_err(interrupted)?;
    let length = total_length(&answer);
    let is_current = || inbox.borrow().request == request;
    if !is_current() {
        return Ok(());
    }
    match answer.status() {
        206 => inbox.borrow_mut().length = length,
        200 => {
            let mut inbox = inbox.borrow_mut();
            inbox.whole = Some(Whole::default());
            inbox.length = header(&answer, "content-length").filter(|_| !is_encoded(&answer));
        }
        // It starts past the end.
        416 => {
            inbox.borrow_mut().length = length;
            return Ok(());
        }
        status => return Err(refused(format!("the server answers {status} {}", answer.status_text()))),
    }
    let Some(body) = answer.body() else { return Ok(()) };
    let reader: web_sys::ReadableStreamDefaultReader = body.get_reader().unchecked_into();
    loop {
        let result = JsFuture::from(reader.read()).await.map_err(interrupted)?;
        // A whole download serves later requests too.
        if !is_current() && inbox.borrow().whole.is_none() {
            return Ok(());
        }
        let mut inbox = inbox.borrow_mut();
        let is_done = Reflect::get(&result, &"done".into()).is_ok_and(|done| done.is_truthy());
        if is_done {
            if let Some(whole) = &mut inbox.whole {
                whole.is_complete = true;
                inbox.length = inbox.whole.as_ref().map(|whole| whole.bytes.len() as u64);
                inbox.wake();
            }
            return Ok(());
        }
        let bytes = Uint8Array::new(&Reflect::get(&result, &"value".into()).map_err(interrupted)?).to_vec();
        if bytes.is_empty() {
            continue;
        }
        match &mut inbox.whole {
            Some(whole) => {
                whole.bytes.extend_from_slice(&bytes);
                inbox.wake();
            }
            None => inbox.tell(request, Ok(Piece::Bytes(bytes))),
        }
    }
}

/// Of the file, of which the answer is a part.
fn total_length(answer: &web_sys::Response) -> Option<u64> {
    let range = answer.headers().get("content-range").ok()??;
    range.rsplit_once('/')?.1.trim().parse().ok()
}

fn header(answer: &web_sys::Response, name: &str) -> Option<u64> {
    answer.headers().get(name).ok()??.trim().parse().ok()
}

/// Whether what arrives is longer than what is sent.
fn is_encoded(answer: &web_sys::Response) -> bool {
    answer.headers().get("content-encoding").is_ok_and(|coding| coding.is_some())
}

fn describe(error: &JsValue) -> String {
    let message = Reflect::get(error, &"message".into()).ok().and_then(|message| message.as_string());
    message.unwrap_or_else(|| format!("{error:?}"))
}
