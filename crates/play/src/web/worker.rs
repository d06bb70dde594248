//! Both ends of the way to the worker that fetches, decodes and arranges scenes. Arrays are transferred, not copied.
//!
//! The page posts `{turn, source, timestep}` to open a scene, and requests `{turn, id, timestep, backwards, looping,
//! camera}`. The worker first posts `ready`, and then answers `{turn, id, …}`. `turn` counts the scenes.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::rc::Rc;
use std::task::{Poll, Waker};

use js_sys::{Array, Reflect, Uint8Array, Uint32Array};
use tcgs_core::Camera;
use wasm_bindgen::prelude::*;
use web_sys::{DedicatedWorkerGlobalScope, MessageEvent, Worker};

use super::global::{now_ms, set_timeout};
use super::object::{camera_object, object, set, vector};
use super::source::WebSource;
use crate::error::{ErrorCode, PlayError};
use crate::player::PlayerSettings;
use crate::remote::{Link, Reply, Request};
use crate::scene_worker::SceneWorker;
use crate::start_view::StartView;

/// Milliseconds between two looks for bytes that have arrived.
const LOOK_MS: i32 = 4;

fn field(of: &JsValue, name: &str) -> JsValue {
    Reflect::get(of, &name.into()).unwrap_or(JsValue::UNDEFINED)
}

fn number(of: &JsValue, name: &str) -> f64 {
    field(of, name).as_f64().unwrap_or(0.0)
}

fn flag(of: &JsValue, name: &str) -> bool {
    field(of, name).is_truthy()
}

/// A field that may be missing.
fn given(of: &JsValue, name: &str) -> Option<JsValue> {
    Some(field(of, name)).filter(|value| !value.is_undefined() && !value.is_null())
}

fn vector_of(values: &JsValue) -> [f64; 3] {
    let values = Array::from(values);
    std::array::from_fn(|axis| values.get(axis as u32).as_f64().unwrap_or(0.0))
}

/// The camera of a [`camera_object`] of this program, unchecked: both ends have to mean the same one.
fn camera_of(given: &JsValue) -> Camera {
    let matrix = Array::from(&field(given, "cameraFromWorld"));
    let entry = |row: usize, column: usize| matrix.get((4 * row + column) as u32).as_f64().unwrap_or(0.0);
    Camera {
        width: number(given, "width") as usize,
        height: number(given, "height") as usize,
        focal: [number(given, "fx"), number(given, "fy")],
        principal: [number(given, "cx"), number(given, "cy")],
        camera_from_world: std::array::from_fn(|row| std::array::from_fn(|column| entry(row, column))),
    }
}

/// Messages that have come from the worker.
#[derive(Default)]
struct Arrivals {
    turn: u32,
    is_ready: bool,
    replies: VecDeque<Reply<Uint32Array>>,
    failure: Option<PlayError>,
    waker: Option<Waker>,
}

/// The page's end.
#[derive(Clone)]
pub struct Port {
    worker: Worker,
    arrivals: Rc<RefCell<Arrivals>>,
    turn: u32,
}

impl Port {
    /// Waits until the worker is ready.
    pub async fn open(worker: Worker) -> Result<Self, PlayError> {
        let arrivals = Rc::new(RefCell::new(Arrivals::default()));
        let take = arrivals.clone();
        let on_message = Closure::<dyn Fn(MessageEvent)>::new(move |event: MessageEvent| {
            let message = event.data();
            let mut arrivals = take.borrow_mut();
            if message.as_string().is_some() {
                arrivals.is_ready = true;
            } else if number(&message, "turn") == f64::from(arrivals.turn) {
                arrivals.replies.push_back(reply_of(&message));
            }
            if let Some(waker) = arrivals.waker.take() {
                waker.wake();
            }
        });
        worker.set_onmessage(Some(on_message.into_js_value().unchecked_ref()));
        let fail = arrivals.clone();
        let on_error = Closure::<dyn Fn(JsValue)>::new(move |event: JsValue| {
            let said = field(&event, "message").as_string().unwrap_or_default();
            // A worker ends where there is no memory left, for one.
            let message = format!("the worker that decodes scenes has ended: {said}");
            let mut arrivals = fail.borrow_mut();
            arrivals.failure = Some(PlayError::Worker { code: ErrorCode::OutOfMemory, message });
            if let Some(waker) = arrivals.waker.take() {
                waker.wake();
            }
        });
        worker.set_onerror(Some(on_error.into_js_value().unchecked_ref()));
        let port = Self { worker, arrivals, turn: 0 };
        let waits = port.clone();
        std::future::poll_fn(move |context| {
            waits.wake_by(context.waker().clone());
            let arrivals = waits.arrivals.borrow();
            match &arrivals.failure {
                Some(failure) => Poll::Ready(Err(failure.clone())),
                None if arrivals.is_ready => Poll::Ready(Ok(())),
                None => Poll::Pending,
            }
        })
        .await?;
        Ok(port)
    }

    /// Lets the worker open a scene, and close the scene before; returns the way to it.
    ///
    /// - `source`: an address, or a `Blob`
    pub fn open_scene(&mut self, source: &JsValue, first_timestep: usize) -> Self {
        self.turn += 1;
        {
            let mut arrivals = self.arrivals.borrow_mut();
            arrivals.turn = self.turn;
            arrivals.replies.clear();
        }
        let timestep = first_timestep as f64;
        self.send(&object([("turn", self.turn.into()), ("source", source.clone()), ("timestep", timestep.into())]));
        self.clone()
    }

    /// Takes the waker that the next answer wakes.
    pub fn wake_by(&self, waker: Waker) {
        self.arrivals.borrow_mut().waker = Some(waker);
    }

    fn send(&self, message: &JsValue) {
        if let Err(error) = self.worker.post_message(message) {
            let message = format!("the worker that decodes scenes takes no message: {error:?}");
            self.arrivals.borrow_mut().failure = Some(PlayError::Worker { code: ErrorCode::Network, message });
        }
    }
}

impl Link for Port {
    type Words = Uint32Array;

    fn post(&mut self, request: &Request) {
        self.send(&object([
            ("turn", self.turn.into()),
            ("id", request.id.into()),
            ("timestep", (request.timestep as f64).into()),
            ("backwards", request.is_backwards.into()),
            ("looping", request.is_looping.into()),
            ("camera", request.camera.as_ref().map_or(JsValue::NULL, camera_object)),
        ]));
    }

    fn take(&mut self) -> Option<Reply<Uint32Array>> {
        let mut arrivals = self.arrivals.borrow_mut();
        if arrivals.turn != self.turn {
            return None;
        }
        let failure = arrivals.failure.clone();
        let failed = |failure| Reply { failure: Some(failure), ..reply_of(&JsValue::UNDEFINED) };
        arrivals.replies.pop_front().or_else(|| failure.map(failed))
    }
}

fn reply_of(message: &JsValue) -> Reply<Uint32Array> {
    let failure = given(message, "failure").map(|failure| {
        let said = field(&failure, "code").as_string().unwrap_or_default();
        let code = ErrorCode::ALL.into_iter().find(|code| code.as_str() == said).unwrap_or(ErrorCode::Damaged);
        PlayError::Worker { code, message: field(&failure, "message").as_string().unwrap_or_default() }
    });
    let start = given(message, "start").map(|start| StartView {
        camera: camera_of(&field(&start, "camera")),
        up: vector_of(&field(&start, "up")),
        pivot: vector_of(&field(&start, "pivot")),
    });
    let words = |name: &str| given(message, name).map(|words| words.unchecked_into::<Uint32Array>());
    Reply {
        id: number(message, "id") as u32,
        bytes_loaded: number(message, "bytesLoaded") as u64,
        failure,
        tables: given(message, "tables").map(|bytes| bytes.unchecked_into::<Uint8Array>().to_vec()),
        start,
        timestep: number(message, "timestep") as usize,
        is_whole: flag(message, "whole"),
        is_antialiased: flag(message, "antialiased"),
        rows: words("rows"),
        order: words("order"),
    }
}

/// Posts an answer to the page.
fn post(scope: &DedicatedWorkerGlobalScope, turn: u32, reply: Reply<&[u32]>) {
    let message = js_sys::Object::new();
    set(&message, "turn", &turn.into());
    set(&message, "id", &reply.id.into());
    set(&message, "bytesLoaded", &(reply.bytes_loaded as f64).into());
    set(&message, "timestep", &(reply.timestep as f64).into());
    set(&message, "whole", &reply.is_whole.into());
    set(&message, "antialiased", &reply.is_antialiased.into());
    if let Some(failure) = reply.failure {
        let (code, text) = (failure.code().as_str().into(), failure.to_string().into());
        set(&message, "failure", &object([("code", code), ("message", text)]));
    }
    let transferred = Array::new();
    if let Some(bytes) = reply.tables {
        let bytes = Uint8Array::from(&bytes[..]);
        transferred.push(&bytes.buffer());
        set(&message, "tables", &bytes);
    }
    if let Some(StartView { camera, up, pivot }) = reply.start {
        let (up, pivot) = (vector(up), vector(pivot));
        set(&message, "start", &object([("camera", camera_object(&camera)), ("up", up), ("pivot", pivot)]));
    }
    for (name, words) in [("rows", reply.rows), ("order", reply.order)] {
        if let Some(words) = words {
            let words = Uint32Array::from(words);
            transferred.push(&words.buffer());
            set(&message, name, &words);
        }
    }
    // It fails only where an array has been transferred before.
    let _ = scope.post_message_with_transfer(&message, &transferred);
}

/// The worker's end: the open scene.
struct Desk {
    scope: DedicatedWorkerGlobalScope,
    scene: RefCell<Option<Scene>>,
    /// Whether a look for bytes is due.
    is_waiting: Cell<bool>,
}

struct Scene {
    turn: u32,
    worker: SceneWorker<WebSource>,
    /// Bytes and completeness in the last answer.
    told: (u64, bool),
}

impl Desk {
    /// Takes a message of the page.
    fn take(self: &Rc<Self>, message: &JsValue) {
        let turn = number(message, "turn") as u32;
        if let Some(source) = given(message, "source") {
            let first_timestep = number(message, "timestep") as usize;
            *self.scene.borrow_mut() = match WebSource::new(&source) {
                Ok(source) => {
                    let worker = SceneWorker::new(source, PlayerSettings::default(), first_timestep);
                    Some(Scene { turn, worker, told: (0, false) })
                }
                Err(problem) => {
                    let failure = Some(PlayError::from(problem));
                    post(&self.scope, turn, Reply { failure, ..Reply::default() });
                    None
                }
            };
        } else if let Some(scene) = self.scene.borrow_mut().as_mut().filter(|scene| scene.turn == turn) {
            scene.worker.ask(Request {
                id: number(message, "id") as u32,
                timestep: number(message, "timestep") as usize,
                is_backwards: flag(message, "backwards"),
                is_looping: flag(message, "looping"),
                camera: given(message, "camera").map(|camera| camera_of(&camera)),
            });
        }
        self.work(true);
    }

    /// Decodes and arranges, and answers if that is due or something has changed.
    fn work(self: &Rc<Self>, is_asked: bool) {
        let mut scene = self.scene.borrow_mut();
        let Some(Scene { turn, worker, told }) = scene.as_mut() else { return };
        let reply = worker.work(now_ms());
        let tells = (reply.bytes_loaded, reply.is_whole);
        let is_new = reply.tables.is_some() || reply.order.is_some() || reply.failure.is_some() || *told != tells;
        if is_asked || is_new {
            *told = tells;
            post(&self.scope, *turn, reply);
        }
        if worker.is_fetching() && !self.is_waiting.replace(true) {
            let desk = self.clone();
            let look = Closure::once_into_js(move || {
                desk.is_waiting.set(false);
                desk.work(false);
            });
            set_timeout(look.unchecked_ref(), LOOK_MS);
        }
    }
}

/// Makes this worker fetch, decode and arrange the scenes of a `Viewer`.
#[wasm_bindgen(js_name = workOnScenes)]
pub fn work_on_scenes() {
    let scope: DedicatedWorkerGlobalScope = js_sys::global().unchecked_into();
    let desk = Rc::new(Desk { scope: scope.clone(), scene: RefCell::new(None), is_waiting: Cell::new(false) });
    let on_message = Closure::<dyn Fn(MessageEvent)>::new(move |event: MessageEvent| desk.take(&event.data()));
    scope.set_onmessage(Some(on_message.into_js_value().unchecked_ref()));
    let _ = scope.post_message(&"ready".into());
}
