//! The player for a page: the classes `Viewer` and `CameraPath`.
//!
//! - `webgpu` or `webgl2`: the canvas, and where a scene is decoded; the features of the build choose one of them
//! - `worker`: both ends of the way to the worker that decodes for `webgl2`
//! - `headset`: pictures for a headset's eyes, with `webgl2`
//! - `source`, `global`: downloads and times, in pages and workers
//!
//! The state of a `Viewer` lies behind one `RefCell`, which is never borrowed across an `await`. So the page may call
//! any method while a promise of another one is pending.

mod attached;
mod camera_path;
#[cfg(not(feature = "webgpu"))]
#[path = "webgl2.rs"]
mod drawing;
#[cfg(feature = "webgpu")]
#[path = "webgpu.rs"]
mod drawing;
mod global;
#[cfg(not(feature = "webgpu"))]
mod headset;
mod object;
mod source;
#[cfg(not(feature = "webgpu"))]
mod worker;

use std::cell::RefCell;
use std::rc::Rc;
use std::task::{Poll, Waker};

use js_sys::{Promise, Uint8ClampedArray};
use tcgs_codec::FileCamera;
use wasm_bindgen::prelude::*;
use wasm_bindgen_futures::{JsFuture, future_to_promise};

use crate::error::{BadCamera, PlayError};
use crate::viewer::{FrameReport, Viewer};
use drawing::{Canvas, CanvasRenderer, ScenePlayer, is_ready};
use global::{now_ms, set_timeout};
use object::{camera_object, camera_of, object};

/// Milliseconds between two polls for a picture on its way from the GPU.
const LOOK_MS: i32 = 2;

/// State that a `Viewer` shares with its pending promises.
struct ViewerState {
    viewer: Viewer<ScenePlayer, CanvasRenderer>,
    canvas: Canvas,
    /// Width and height of the canvas, device pixels.
    size: [usize; 2],
    /// Number of calls of `open`. The promise of an earlier call is rejected.
    opening: u64,
    /// Wakes the promise of `open`.
    waker: Option<Waker>,
    is_open: bool,
    cameras: Vec<FileCamera>,
}

/// Draws scenes on a canvas, one at a time.
#[wasm_bindgen(js_name = Viewer)]
pub struct WebViewer {
    state: Rc<RefCell<ViewerState>>,
}

#[wasm_bindgen(start)]
fn start() {
    std::panic::set_hook(Box::new(|info| web_sys::console::error_1(&info.to_string().into())));
}

/// Waits some milliseconds.
async fn sleep(ms: i32) {
    let promise = Promise::new(&mut |resolve, _| {
        set_timeout(&resolve, ms);
    });
    let _ = JsFuture::from(promise).await;
}

#[wasm_bindgen(js_class = Viewer)]
impl WebViewer {
    /// Opens the browser's GPU for a canvas. Rejects with the code `no-webgpu` where the browser has no fitting GPU.
    ///
    /// - `worker`: for WebGL2 a `Worker` that runs `workOnScenes`
    pub async fn create(canvas: web_sys::HtmlCanvasElement, worker: JsValue) -> Result<WebViewer, JsValue> {
        let size = [canvas.width().max(1) as usize, canvas.height().max(1) as usize];
        let (mut canvas, device) = Canvas::create(canvas, worker).await?;
        let viewer = Viewer::new(device);
        let size = canvas.resize(size);
        let state = ViewerState { viewer, canvas, size, opening: 0, waker: None, is_open: false, cameras: Vec::new() };
        Ok(Self { state: Rc::new(RefCell::new(state)) })
    }

    /// Opens a scene, and closes the scene before. Resolves when the first picture can be drawn: the next call of
    /// `frame` draws it. Rejects with the code of the scene's problem, or `aborted` if another scene is opened first.
    ///
    /// - `source`: an address, or a `Blob` such as a file that was dropped
    /// - `timestep`: the timestep that is shown first; default 0
    #[wasm_bindgen(unchecked_return_type = "Promise<void>")]
    pub fn open(&self, source: JsValue, timestep: Option<u32>) -> Promise {
        let state = self.state.clone();
        let opened = state.borrow_mut().canvas.player(&source, timestep.unwrap_or(0) as usize);
        let (player, wake_by) = match opened {
            Ok(opened) => opened,
            Err(problem) => return Promise::reject(&problem.into()),
        };
        let turn = {
            let mut state = state.borrow_mut();
            state.opening += 1;
            state.is_open = false;
            state.cameras.clear();
            state.viewer.open(player);
            // Wakes the promise of the scene before, which then rejects.
            if let Some(waker) = state.waker.take() {
                waker.wake();
            }
            state.opening
        };
        future_to_promise(std::future::poll_fn(move |context| {
            let mut state = state.borrow_mut();
            if state.opening != turn {
                return Poll::Ready(Err(PlayError::Replaced.into()));
            }
            match state.viewer.update(now_ms()) {
                Ok(true) => {
                    state.is_open = true;
                    state.cameras = state.viewer.cameras();
                    Poll::Ready(Ok(JsValue::UNDEFINED))
                }
                Ok(false) => {
                    // This promise is woken by the next bytes, or by a call of `frame` that took them first.
                    wake_by(context.waker().clone());
                    state.waker = Some(context.waker().clone());
                    Poll::Pending
                }
                Err(problem) => Poll::Ready(Err(problem.into())),
            }
        }))
    }

    /// The scene according to its file, null while no scene is open:
    /// `{name, generator, numGaussians, numTimesteps, firstFrame, frameRate, bytes, cameras, credits, times}`.
    ///
    /// - `cameras`: each in the form of `camera()`, with `name` and `position` besides
    /// - `credits`: `{licence, authors, source}` or null
    /// - `times`: seconds of timesteps that are not evenly spaced, or null
    pub fn info(&self) -> JsValue {
        let state = self.state.borrow();
        let Some(archive) = state.viewer.archive().filter(|_| state.is_open) else { return JsValue::NULL };
        let info = archive.info();
        let cameras: js_sys::Array = state.cameras.iter().map(camera_entry).collect();
        object([
            ("name", info.name.as_str().into()),
            ("generator", info.generator.as_str().into()),
            ("numGaussians", info.num_gaussians.into()),
            ("numTimesteps", info.num_timesteps.into()),
            ("firstFrame", info.first_frame.into()),
            ("frameRate", f64::from(info.frame_rate).into()),
            ("bytes", (archive.file_bytes() as f64).into()),
            ("cameras", cameras.into()),
            ("credits", state.credits()),
            ("times", state.times()),
        ])
    }

    /// Lets time pass and draws once. A page calls this once per animation frame.
    ///
    /// - `now_ms`: as `requestAnimationFrame` gives it
    /// - returns: `{time, seconds, timestep, playing, buffering, drawn, doubt, gaussians, bytesLoaded, width, height}`;
    ///   `time` is the clock's position in timesteps, and `seconds` the same in seconds from the first timestep.
    ///   `drawn` says whether the picture shows the due timestep with all its splats, `doubt` how little it can be
    ///   trusted, in [0, 1]
    ///
    /// Throws errors with a `code`. Errors of a scene that is still opening reject the promise of `open` instead.
    pub fn frame(&self, now_ms: f64) -> Result<JsValue, JsValue> {
        let mut guard = self.state.borrow_mut();
        let state = &mut *guard;
        state.update(now_ms)?;
        let drawn = state.canvas.draw(&mut state.viewer, state.size)?;
        Ok(state.report(drawn.as_ref()))
    }

    /// Number of frames that the GPU has not finished yet. A page waits until it is small before it draws, because
    /// browsers accept any number of frames and the GPU would fall further and further behind.
    pub fn pending(&self) -> u32 {
        self.state.borrow_mut().canvas.pending()
    }

    /// Throws an error of code `device-lost` if the GPU does not work any more.
    pub fn check(&self) -> Result<(), JsValue> {
        Ok(self.state.borrow().canvas.check()?)
    }

    /// Lets time pass, from now on: a page at rest does not call `frame`.
    pub fn play(&self) {
        self.with_clock(|clock| {
            if !clock.is_playing() {
                clock.hold(now_ms());
            }
            clock.play();
        });
    }

    /// Stops time.
    pub fn pause(&self) {
        self.with_clock(|clock| clock.pause());
    }

    /// Goes to a timestep.
    pub fn seek(&self, timestep: f64) {
        // The cast maps negative numbers and NaN to 0; the clock maps too large numbers to the last timestep.
        self.with_clock(|clock| clock.seek(timestep as usize));
    }

    /// Stops time, and goes `count` timesteps on, or back if `count` is negative.
    pub fn step(&self, count: f64) {
        self.with_clock(|clock| clock.step(count as i64));
    }

    /// Sets the speed in multiples of the scene's frame rate; negative: backwards.
    #[wasm_bindgen(js_name = setSpeed)]
    pub fn set_speed(&self, speed: f64) {
        self.with_clock(|clock| clock.set_speed(speed));
    }

    /// Sets whether the first timestep follows the last one.
    #[wasm_bindgen(js_name = setLoop)]
    pub fn set_loop(&self, is_looping: bool) {
        self.with_clock(|clock| clock.set_looping(is_looping));
    }

    /// Sets the colour behind all Gaussians, sRGB in [0, 1]; the scene's own at first.
    #[wasm_bindgen(js_name = setBackground)]
    pub fn set_background(&self, r: f32, g: f32, b: f32) {
        self.state.borrow_mut().viewer.set_background(Some([r, g, b]));
    }

    /// Sets the canvas' size in device pixels, or the nearest that the GPU allows.
    pub fn resize(&self, width: u32, height: u32) {
        let mut state = self.state.borrow_mut();
        state.size = state.canvas.resize([width.max(1) as usize, height.max(1) as usize]);
    }

    /// Moves the camera around the pivot, by radians to the right and down. The scene follows the pointer.
    pub fn orbit(&self, dx: f64, dy: f64) {
        self.with_controls(|controls| controls.orbit(dx, dy));
    }

    /// Moves the camera sideways, by heights of the picture to the right and down. The scene follows the pointer.
    pub fn pan(&self, dx: f64, dy: f64) {
        self.with_controls(|controls| controls.pan(dx, dy));
    }

    /// Moves the camera nearer to the pivot by a factor above 1, farther from it by a factor below.
    pub fn zoom(&self, factor: f64) {
        self.with_controls(|controls| controls.zoom(factor));
    }

    /// Moves the camera to the right, down and forward, in distances of the start view from its pivot.
    pub fn fly(&self, dx: f64, dy: f64, dz: f64) {
        self.with_controls(|controls| controls.fly(dx, dy, dz));
    }

    /// Turns the camera on the spot, by radians to the right and down. The scene follows the pointer.
    pub fn look(&self, dx: f64, dy: f64) {
        self.with_controls(|controls| controls.look(dx, dy));
    }

    /// Moves the camera a part of the way to the nearest position from which pictures can be trusted, as the file says.
    ///
    /// - `share`: of the way, in [0, 1]
    #[wasm_bindgen(js_name = leadBack)]
    pub fn lead_back(&self, share: f64) {
        self.state.borrow_mut().viewer.lead_back(share);
    }

    /// Moves the camera back to the start view.
    pub fn reset(&self) {
        self.with_controls(|controls| controls.reset());
    }

    /// The camera of the picture on the canvas: `{width, height, fx, fy, cx, cy, cameraFromWorld}`, the matrix as 16
    /// numbers in rows; null while no scene is open.
    pub fn camera(&self) -> JsValue {
        let state = self.state.borrow();
        state.viewer.camera(state.size).map_or(JsValue::NULL, |camera| camera_object(&camera))
    }

    /// Moves to a camera, given in the form of `camera()`. On a canvas of its size the picture is exactly the camera's;
    /// any other canvas shows at least as much. Throws an error of code `bad-camera` if the camera is not valid.
    #[wasm_bindgen(js_name = setCamera)]
    pub fn set_camera(&self, camera: JsValue) -> Result<(), JsValue> {
        let camera = camera_of(&camera).map_err(PlayError::from)?;
        if let Some(controls) = self.state.borrow_mut().viewer.controls_mut() {
            controls.set_camera(&camera).map_err(PlayError::from)?;
        }
        Ok(())
    }

    /// Moves to a camera of the file. Throws an error of code `bad-camera` if the file has no camera of that index.
    #[wasm_bindgen(js_name = useCamera)]
    pub fn use_camera(&self, index: usize) -> Result<(), JsValue> {
        let mut state = self.state.borrow_mut();
        let Some(camera) = state.cameras.get(index).map(|entry| entry.camera.clone()) else {
            return Err(PlayError::from(BadCamera::Index { index, count: state.cameras.len() }).into());
        };
        if let Some(controls) = state.viewer.controls_mut() {
            controls.set_camera(&camera).map_err(PlayError::from)?;
        }
        Ok(())
    }

    /// Draws a picture of the canvas' size once the due timestep has arrived, and resolves to
    /// `{width, height, timestep, data}`, where `data` is RGBA in rows from the top. Rejects with the code `aborted` if
    /// another scene is opened meanwhile.
    #[wasm_bindgen(unchecked_return_type = "Promise<object>")]
    pub fn capture(&self) -> Promise {
        let state = self.state.clone();
        let turn = state.borrow().opening;
        let still_open = move |state: &ViewerState| {
            if state.opening == turn { Ok(()) } else { Err(PlayError::Replaced) }
        };
        future_to_promise(async move {
            loop {
                let (still, size, timestep) = {
                    let mut state = state.borrow_mut();
                    still_open(&state)?;
                    state.viewer.update(now_ms())?;
                    let size = state.size;
                    let timestep = state.viewer.clock_mut().map_or(0, |clock| clock.timestep());
                    (state.viewer.begin_still(size)?, size, timestep)
                };
                sleep(LOOK_MS).await;
                let Some(still) = still else { continue };
                while !is_ready(&still) {
                    state.borrow().canvas.check()?;
                    sleep(LOOK_MS).await;
                }
                let mut state = state.borrow_mut();
                still_open(&state)?;
                if let Some(pixels) = state.viewer.finish_still(&still)? {
                    return Ok(object([
                        ("width", (size[0] as u32).into()),
                        ("height", (size[1] as u32).into()),
                        ("timestep", (timestep as u32).into()),
                        ("data", Uint8ClampedArray::from(&pixels[..]).into()),
                    ]));
                }
            }
        })
    }
}

impl ViewerState {
    /// Lets time pass. Errors of a scene that is still opening go to the promise of `open`.
    fn update(&mut self, now_ms: f64) -> Result<(), PlayError> {
        let updated = self.viewer.update(now_ms);
        if self.is_open {
            updated?;
        } else if let Some(waker) = self.waker.take() {
            waker.wake();
        }
        Ok(())
    }

    /// What `frame` returns.
    fn report(&self, frame: Option<&FrameReport>) -> JsValue {
        let gaussians = self.viewer.info().map_or(0, |info| info.num_gaussians);
        object([
            ("time", frame.map_or(0.0, |frame| frame.time).into()),
            ("seconds", frame.map_or(0.0, |frame| frame.seconds).into()),
            ("timestep", frame.map_or(0, |frame| frame.timestep as u32).into()),
            ("playing", frame.is_some_and(|frame| frame.is_playing).into()),
            ("buffering", frame.is_none_or(|frame| frame.is_buffering).into()),
            ("drawn", frame.is_some_and(|frame| frame.is_drawn).into()),
            ("doubt", frame.map_or(0.0, |frame| frame.doubt).into()),
            ("gaussians", gaussians.into()),
            ("bytesLoaded", (self.viewer.bytes_loaded() as f64).into()),
            ("width", (self.size[0] as u32).into()),
            ("height", (self.size[1] as u32).into()),
        ])
    }
}

impl WebViewer {
    fn with_clock(&self, action: impl FnOnce(&mut crate::Clock)) {
        if let Some(clock) = self.state.borrow_mut().viewer.clock_mut() {
            action(clock);
        }
    }

    fn with_controls(&self, action: impl FnOnce(&mut crate::Controls)) {
        if let Some(controls) = self.state.borrow_mut().viewer.controls_mut() {
            action(controls);
        }
    }
}

fn camera_entry(entry: &FileCamera) -> JsValue {
    let camera = camera_object(&entry.camera);
    let position: js_sys::Array = entry.camera.center().into_iter().map(JsValue::from_f64).collect();
    let fields = js_sys::Object::from(camera);
    object::set(&fields, "name", &entry.name.as_str().into());
    object::set(&fields, "position", &position.into());
    fields.into()
}
