//! The canvas with WebGL2; scenes are decoded and arranged in a worker.
//!
//! Each Gaussian is a quad, from back to front. The vertex shader projects it as `tcgs_render::project` does, from the
//! row that the worker wrote; so the camera moves at once, and order and colours follow. The fragment shader has the
//! alpha and the cutoffs of the renderer that trains. Colours are blended as 16-bit floats where the browser can, else
//! in 8 bits, where every splat rounds.
//!
//! Departures from the renderer that trains:
//! 1. A pixel is never finished: what is drawn behind `MIN_TRANSMITTANCE` is not left out.
//! 2. Sums are rounded to the format of the blending after every splat.
//! 3. Colours and opacities have 11 significant bits.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::task::Waker;

use js_sys::{Object, Uint32Array};
use tcgs_core::Camera;
use tcgs_render::SplatCamera;
use tcgs_render::device::GpuError;
use tcgs_render::settings::{BLUR_VARIANCE, MAX_ALPHA, MIN_ALPHA, NEAR};
use wasm_bindgen::{JsCast, JsValue};
use web_sys::{
    HtmlCanvasElement, WebGl2RenderingContext as Gl, WebGlBuffer, WebGlFramebuffer, WebGlProgram, WebGlSync,
    WebGlTexture, WebGlUniformLocation, WebGlVertexArrayObject,
};

use super::object::object;
use super::worker::Port;
use crate::arrange::{LINE, ROW_WORDS};
use crate::error::PlayError;
use crate::remote::{Arranged, RemotePlayer};
use crate::renderer::{PictureRequest, Renderer};
use crate::viewer::{FrameReport, Viewer};

/// From an address or a file to arranged timesteps.
pub type ScenePlayer = RemotePlayer<Port>;
/// Draws them.
pub type CanvasRenderer = QuadRenderer;

type Words = Arranged<Uint32Array>;

/// Texels of a row.
const ROW_TEXELS: usize = ROW_WORDS / 4;
/// Texels of a line.
const LINE_TEXELS: usize = LINE * ROW_TEXELS;

/// One quad for each index: the projection of `tcgs_render::project`, in the same order of steps.
const QUAD: &str = include_str!("quad.vert.glsl");
const SPLAT: &str = include_str!("splat.frag.glsl");
/// One triangle that covers everything.
const COVER: &str = include_str!("cover.vert.glsl");
const COPY: &str = include_str!("copy.frag.glsl");

/// A canvas and its context.
pub struct Canvas {
    context: Rc<Context>,
    canvas: HtmlCanvasElement,
    port: Port,
    /// Frames that the GPU may not have finished.
    fences: VecDeque<WebGlSync>,
}

/// A context with all that outlives a scene.
pub struct Context {
    gl: Gl,
    splats: WebGlProgram,
    uniforms: Uniforms,
    copy: WebGlProgram,
    copy_uniforms: CopyUniforms,
    /// Without any attribute.
    no_attributes: WebGlVertexArrayObject,
    target: RefCell<Target>,
    /// Format of the blending.
    format: u32,
    most: usize,
}

/// Part of a framebuffer.
pub struct Place {
    /// `None`: the canvas.
    pub framebuffer: Option<WebGlFramebuffer>,
    /// Left and lower edge, pixels.
    pub corner: [i32; 2],
    /// Width and height, pixels.
    pub size: [usize; 2],
    /// `None`: the picture alone.
    pub edge: Option<Edge>,
}

/// An amber edge over a picture that cannot be trusted. It begins at an angle from the optical axis, so that both eyes
/// of a headset see it in the same directions.
pub struct Edge {
    /// How little the picture can be trusted, in `(0, 1]`.
    doubt: f32,
    /// Focal lengths, pixels.
    focal: [f32; 2],
    /// Principal point from the lower left corner of the place, pixels.
    principal: [f32; 2],
}

impl Edge {
    pub fn new(camera: &Camera, doubt: f64) -> Self {
        let [x, y] = camera.principal.map(|c| c as f32);
        Self { doubt: doubt as f32, focal: camera.focal.map(|f| f as f32), principal: [x, camera.height as f32 - y] }
    }
}

impl Place {
    fn all_of(framebuffer: Option<WebGlFramebuffer>, size: [usize; 2]) -> Self {
        Self { framebuffer, corner: [0, 0], size, edge: None }
    }
}

/// The picture into which splats are blended.
struct Target {
    framebuffer: WebGlFramebuffer,
    texture: Option<WebGlTexture>,
    size: [usize; 2],
}

struct CopyUniforms {
    corner: Option<WebGlUniformLocation>,
    doubt: Option<WebGlUniformLocation>,
    focal: Option<WebGlUniformLocation>,
    principal: Option<WebGlUniformLocation>,
}

struct Uniforms {
    camera_from_world: Option<WebGlUniformLocation>,
    focal: Option<WebGlUniformLocation>,
    principal: Option<WebGlUniformLocation>,
    size: Option<WebGlUniformLocation>,
    slope_min: Option<WebGlUniformLocation>,
    slope_max: Option<WebGlUniformLocation>,
    light: Option<WebGlUniformLocation>,
    antialiased: Option<WebGlUniformLocation>,
}

impl Canvas {
    /// Opens WebGL2 for a canvas.
    ///
    /// - `worker`: a `Worker` that runs `workOnScenes`
    pub async fn create(canvas: HtmlCanvasElement, worker: JsValue) -> Result<(Self, Rc<Context>), PlayError> {
        let no = JsValue::FALSE;
        let options = object([
            ("alpha", no.clone()),
            ("antialias", no.clone()),
            ("depth", no.clone()),
            ("stencil", no),
            ("powerPreference", "high-performance".into()),
        ]);
        let gl = canvas.get_context_with_context_options("webgl2", &options).ok().flatten();
        let found = "a canvas without it".into();
        let gl: Gl = gl.ok_or(GpuError::NotFound { wanted: "through WebGL2".into(), found })?.unchecked_into();
        let context = Rc::new(Context::new(gl)?);
        let port = Port::open(worker.unchecked_into()).await?;
        Ok((Self { context: context.clone(), canvas, port, fences: VecDeque::new() }, context))
    }

    /// A player of an address or a file, and a function that takes the waker which the next answer of the worker wakes.
    pub fn player(
        &mut self,
        source: &JsValue,
        first_timestep: usize,
    ) -> Result<(ScenePlayer, impl Fn(Waker) + use<>), PlayError> {
        let port = self.port.open_scene(source, first_timestep);
        let waits = port.clone();
        Ok((RemotePlayer::new(port, first_timestep), move |waker| waits.wake_by(waker)))
    }

    /// Sets the canvas' size in device pixels, or the nearest that the GPU allows; returns it.
    pub fn resize(&mut self, size: [usize; 2]) -> [usize; 2] {
        let size = size.map(|side| side.min(self.context.most));
        let held = [self.canvas.width(), self.canvas.height()].map(|side| side as usize);
        if held != size {
            self.canvas.set_width(size[0] as u32);
            self.canvas.set_height(size[1] as u32);
        }
        size
    }

    /// Draws a frame.
    pub fn draw(
        &mut self,
        viewer: &mut Viewer<ScenePlayer, CanvasRenderer>,
        size: [usize; 2],
    ) -> Result<Option<FrameReport>, PlayError> {
        let frame = viewer.draw(size, &Place::all_of(None, size))?;
        let gl = &self.context.gl;
        self.fences.extend(gl.fence_sync(Gl::SYNC_GPU_COMMANDS_COMPLETE, 0));
        gl.flush();
        Ok(frame)
    }

    /// Number of frames that the GPU has not finished yet.
    pub fn pending(&mut self) -> u32 {
        let gl = &self.context.gl;
        while let Some(fence) = self.fences.front() {
            let status = gl.get_sync_parameter(fence, Gl::SYNC_STATUS).as_f64();
            // A lost context says nothing.
            if status == Some(f64::from(Gl::UNSIGNALED)) {
                break;
            }
            gl.delete_sync(Some(fence));
            self.fences.pop_front();
        }
        self.fences.len() as u32
    }

    /// Whether the GPU still works.
    pub fn check(&self) -> Result<(), PlayError> {
        self.context.check()
    }
}

/// Whether the pixels of a still have arrived.
pub fn is_ready(_: &[u8]) -> bool {
    true
}

fn refused(what: &str, problem: Option<String>) -> PlayError {
    GpuError::Refused(format!("{what}: {}", problem.unwrap_or_default())).into()
}

impl Context {
    fn new(gl: Gl) -> Result<Self, PlayError> {
        // Either allows targets of 16-bit floats, and blending in them.
        let has = |name: &str| gl.get_extension(name).ok().flatten().is_some();
        let has_floats = has("EXT_color_buffer_float");
        let is_half = has("EXT_color_buffer_half_float") || has_floats;
        let splats = program(&gl, QUAD, SPLAT)?;
        let copy = program(&gl, COVER, COPY)?;
        let uniform = |name: &str| gl.get_uniform_location(&splats, name);
        let uniforms = Uniforms {
            camera_from_world: uniform("camera_from_world"),
            focal: uniform("focal"),
            principal: uniform("principal"),
            size: uniform("size"),
            slope_min: uniform("slope_min"),
            slope_max: uniform("slope_max"),
            light: uniform("light"),
            antialiased: uniform("antialiased"),
        };
        let framebuffer = gl.create_framebuffer().ok_or_else(|| lost("no framebuffer"))?;
        let uniform = |name: &str| gl.get_uniform_location(&copy, name);
        let copy_uniforms = CopyUniforms {
            corner: uniform("corner"),
            doubt: uniform("doubt"),
            focal: uniform("focal"),
            principal: uniform("principal"),
        };
        let no_attributes = gl.create_vertex_array().ok_or_else(|| lost("no vertex array"))?;
        let most = gl.get_parameter(Gl::MAX_TEXTURE_SIZE).ok().and_then(|most| most.as_f64()).unwrap_or(2048.0);
        let target = RefCell::new(Target { framebuffer, texture: None, size: [0, 0] });
        let format = if is_half { Gl::RGBA16F } else { Gl::RGBA8 };
        Ok(Self { gl, splats, uniforms, copy, copy_uniforms, no_attributes, target, format, most: most as usize })
    }

    /// Whether the GPU still works.
    fn check(&self) -> Result<(), PlayError> {
        if self.gl.is_context_lost() { Err(lost("the browser took WebGL2 away")) } else { Ok(()) }
    }

    /// Makes splats be blended into a picture of this size, filled with a colour.
    fn begin(&self, size: [usize; 2], [r, g, b]: [f32; 3]) {
        let gl = &self.gl;
        let mut target = self.target.borrow_mut();
        gl.bind_framebuffer(Gl::FRAMEBUFFER, Some(&target.framebuffer));
        if target.size != size {
            gl.delete_texture(target.texture.as_ref());
            target.texture = texture(gl, self.format, size);
            let (attachment, texture) = (Gl::COLOR_ATTACHMENT0, target.texture.as_ref());
            gl.framebuffer_texture_2d(Gl::FRAMEBUFFER, attachment, Gl::TEXTURE_2D, texture, 0);
            target.size = size;
        }
        gl.viewport(0, 0, size[0] as i32, size[1] as i32);
        gl.clear_color(r, g, b, 1.0);
        gl.clear(Gl::COLOR_BUFFER_BIT);
    }

    /// Copies the picture to a place of the same size.
    fn copy_to(&self, place: &Place) {
        let gl = &self.gl;
        gl.bind_framebuffer(Gl::FRAMEBUFFER, place.framebuffer.as_ref());
        let [x, y] = place.corner;
        gl.viewport(x, y, place.size[0] as i32, place.size[1] as i32);
        gl.disable(Gl::BLEND);
        gl.use_program(Some(&self.copy));
        let uniforms = &self.copy_uniforms;
        gl.uniform2i(uniforms.corner.as_ref(), x, y);
        gl.uniform1f(uniforms.doubt.as_ref(), place.edge.as_ref().map_or(0.0, |edge| edge.doubt));
        if let Some(Edge { focal, principal, .. }) = &place.edge {
            gl.uniform2fv_with_f32_array(uniforms.focal.as_ref(), focal);
            gl.uniform2fv_with_f32_array(uniforms.principal.as_ref(), principal);
        }
        gl.bind_vertex_array(Some(&self.no_attributes));
        gl.bind_texture(Gl::TEXTURE_2D, self.target.borrow().texture.as_ref());
        gl.draw_arrays(Gl::TRIANGLES, 0, 3);
    }

    /// Takes the pixels of the picture.
    fn read(&self, [width, height]: [usize; 2]) -> Result<Vec<u8>, PlayError> {
        let gl = &self.gl;
        let pixels = texture(gl, Gl::RGBA8, [width, height]);
        let place = Place::all_of(gl.create_framebuffer(), [width, height]);
        gl.bind_framebuffer(Gl::FRAMEBUFFER, place.framebuffer.as_ref());
        gl.framebuffer_texture_2d(Gl::FRAMEBUFFER, Gl::COLOR_ATTACHMENT0, Gl::TEXTURE_2D, pixels.as_ref(), 0);
        self.copy_to(&place);
        let mut bytes = vec![0; 4 * width * height];
        let (columns, rows) = (width as i32, height as i32);
        let read = gl.read_pixels_with_opt_u8_array(0, 0, columns, rows, Gl::RGBA, Gl::UNSIGNED_BYTE, Some(&mut bytes));
        gl.delete_framebuffer(place.framebuffer.as_ref());
        gl.delete_texture(pixels.as_ref());
        read.map_err(|error| refused("the pixels", error.as_string()))?;
        self.check()?;
        // Rows come from the bottom.
        Ok(bytes.chunks_exact(4 * width).rev().flatten().copied().collect())
    }
}

fn lost(problem: &str) -> PlayError {
    GpuError::Lost(problem.into()).into()
}

/// A texture of one level without content, bound.
fn texture(gl: &Gl, format: u32, [width, height]: [usize; 2]) -> Option<WebGlTexture> {
    let texture = gl.create_texture();
    gl.bind_texture(Gl::TEXTURE_2D, texture.as_ref());
    gl.tex_storage_2d(Gl::TEXTURE_2D, 1, format, width as i32, height as i32);
    for parameter in [Gl::TEXTURE_MIN_FILTER, Gl::TEXTURE_MAG_FILTER] {
        gl.tex_parameteri(Gl::TEXTURE_2D, parameter, Gl::NEAREST as i32);
    }
    texture
}

/// The cutoffs and sizes of this program, as GLSL.
fn constants() -> String {
    let floats = [("NEAR", NEAR), ("BLUR_VARIANCE", BLUR_VARIANCE), ("MIN_ALPHA", MIN_ALPHA), ("MAX_ALPHA", MAX_ALPHA)];
    let floats: String = floats.map(|(name, value)| format!("const float {name} = {value:e};\n")).concat();
    let precisions: String = ["float", "int", "sampler2D"].map(|kind| format!("precision highp {kind};\n")).concat();
    format!("#version 300 es\n{precisions}{floats}const uint LINE = {LINE}u;\n")
}

fn program(gl: &Gl, vertex: &str, fragment: &str) -> Result<WebGlProgram, PlayError> {
    let program = gl.create_program().ok_or_else(|| lost("no program"))?;
    for (kind, source) in [(Gl::VERTEX_SHADER, vertex), (Gl::FRAGMENT_SHADER, fragment)] {
        let shader = gl.create_shader(kind).ok_or_else(|| lost("no shader"))?;
        gl.shader_source(&shader, &format!("{}{source}", constants()));
        gl.compile_shader(&shader);
        if !gl.get_shader_parameter(&shader, Gl::COMPILE_STATUS).is_truthy() {
            return Err(refused("a shader", gl.get_shader_info_log(&shader)));
        }
        gl.attach_shader(&program, &shader);
    }
    gl.link_program(&program);
    if gl.get_program_parameter(&program, Gl::LINK_STATUS).is_truthy() {
        Ok(program)
    } else {
        Err(refused("the shaders", gl.get_program_info_log(&program)))
    }
}

/// Draws one scene as quads.
pub struct QuadRenderer {
    context: Rc<Context>,
    /// The rows, [`LINE`] in a line, and the number of lines.
    rows: Option<WebGlTexture>,
    num_lines: usize,
    order: Option<WebGlBuffer>,
    attributes: Option<WebGlVertexArrayObject>,
    /// What is uploaded.
    uploaded: [Option<Rc<Uint32Array>>; 2],
}

impl QuadRenderer {
    /// Uploads what has changed.
    fn upload(&mut self, moment: &Words) -> Result<(), PlayError> {
        let gl = &self.context.gl;
        let [rows, order] = &mut self.uploaded;
        gl.bind_texture(Gl::TEXTURE_2D, self.rows.as_ref());
        if rows.as_ref().is_none_or(|rows| !Rc::ptr_eq(rows, &moment.rows)) {
            let num_lines = moment.rows.length() as usize / (LINE * ROW_WORDS);
            if num_lines > self.context.most {
                let bytes = 4 * u64::from(moment.rows.length());
                let problem = format!("a texture has at most {} lines", self.context.most);
                return Err(GpuError::Memory { what: "Gaussians".into(), bytes, problem }.into());
            }
            // With a changing number of Gaussians, a new maximum should not always need a new texture.
            if num_lines > self.num_lines {
                gl.delete_texture(self.rows.as_ref());
                self.num_lines = (num_lines + num_lines / 8).min(self.context.most);
                self.rows = texture(gl, Gl::RGBA32UI, [LINE_TEXELS, self.num_lines]);
                if gl.get_error() == Gl::OUT_OF_MEMORY {
                    let (bytes, problem) = (4 * u64::from(moment.rows.length()), "more than there is".into());
                    return Err(GpuError::Memory { what: "Gaussians".into(), bytes, problem }.into());
                }
            }
            if num_lines > 0 {
                let data: &Object = (*moment.rows).as_ref();
                gl.tex_sub_image_2d_with_i32_and_i32_and_u32_and_type_and_opt_array_buffer_view(
                    Gl::TEXTURE_2D,
                    0,
                    0,
                    0,
                    LINE_TEXELS as i32,
                    num_lines as i32,
                    Gl::RGBA_INTEGER,
                    Gl::UNSIGNED_INT,
                    Some(data),
                )
                .map_err(|error| refused("the Gaussians", error.as_string()))?;
            }
            *rows = Some(moment.rows.clone());
        }
        if order.as_ref().is_none_or(|order| !Rc::ptr_eq(order, &moment.order)) {
            gl.bind_buffer(Gl::ARRAY_BUFFER, self.order.as_ref());
            let data: &Object = (*moment.order).as_ref();
            gl.buffer_data_with_array_buffer_view(Gl::ARRAY_BUFFER, data, Gl::STREAM_DRAW);
            *order = Some(moment.order.clone());
        }
        Ok(())
    }

    fn set_uniforms(&self, camera: &Camera, light: [f32; 3], is_antialiased: bool) {
        let (gl, uniforms) = (&self.context.gl, &self.context.uniforms);
        let SplatCamera { pinhole, slope_min, slope_max } = SplatCamera::<f32>::new(camera);
        let rows: Vec<f32> =
            (0..3).flat_map(|i| pinhole.rotation[i].into_iter().chain([pinhole.translation[i]])).collect();
        gl.uniform4fv_with_f32_array(uniforms.camera_from_world.as_ref(), &rows);
        gl.uniform2fv_with_f32_array(uniforms.focal.as_ref(), &pinhole.focal);
        gl.uniform2fv_with_f32_array(uniforms.principal.as_ref(), &pinhole.principal);
        gl.uniform2fv_with_f32_array(uniforms.size.as_ref(), &[camera.width as f32, camera.height as f32]);
        gl.uniform2fv_with_f32_array(uniforms.slope_min.as_ref(), &slope_min);
        gl.uniform2fv_with_f32_array(uniforms.slope_max.as_ref(), &slope_max);
        gl.uniform3fv_with_f32_array(uniforms.light.as_ref(), &light);
        gl.uniform1i(uniforms.antialiased.as_ref(), is_antialiased.into());
    }

    /// Draws a picture into the context's target.
    fn render(&mut self, request: &PictureRequest<'_, Words>) -> Result<(), PlayError> {
        self.context.check()?;
        let context = self.context.clone();
        let gl = &context.gl;
        context.begin([request.camera.width, request.camera.height], request.background);
        gl.use_program(Some(&context.splats));
        self.upload(request.moment)?;
        self.set_uniforms(request.camera, request.light, request.moment.is_antialiased);
        gl.bind_vertex_array(self.attributes.as_ref());
        gl.enable(Gl::BLEND);
        gl.blend_func(Gl::ONE, Gl::ONE_MINUS_SRC_ALPHA);
        gl.draw_arrays_instanced(Gl::TRIANGLE_STRIP, 0, 4, request.moment.order.length() as i32);
        Ok(())
    }
}

impl Renderer for QuadRenderer {
    type Moment = Words;
    type Device = Rc<Context>;
    type Target = Place;
    /// RGBA, rows from the top.
    type Still = Vec<u8>;

    fn begin(context: &Rc<Context>) -> Result<Self, PlayError> {
        let gl = &context.gl;
        let (order, attributes) = (gl.create_buffer(), gl.create_vertex_array());
        gl.bind_vertex_array(attributes.as_ref());
        gl.bind_buffer(Gl::ARRAY_BUFFER, order.as_ref());
        gl.enable_vertex_attrib_array(0);
        gl.vertex_attrib_i_pointer_with_i32(0, 1, Gl::UNSIGNED_INT, 0, 0);
        gl.vertex_attrib_divisor(0, 1);
        context.check()?;
        let (context, uploaded) = (context.clone(), [None, None]);
        Ok(Self { context, rows: None, num_lines: 0, order, attributes, uploaded })
    }

    fn clear(context: &Rc<Context>, place: &Place, color: [f32; 3]) -> Result<(), PlayError> {
        context.begin(place.size, color);
        context.copy_to(place);
        context.check()
    }

    fn draw(&mut self, request: &PictureRequest<'_, Words>, place: &Place) -> Result<(), PlayError> {
        self.render(request)?;
        self.context.copy_to(place);
        Ok(())
    }

    fn is_whole(&self) -> bool {
        true
    }

    fn begin_still(&mut self, request: &PictureRequest<'_, Words>) -> Result<Vec<u8>, PlayError> {
        self.render(request)?;
        self.context.read([request.camera.width, request.camera.height])
    }

    fn finish_still(&mut self, still: &Vec<u8>) -> Result<Option<Vec<u8>>, PlayError> {
        Ok(Some(still.clone()))
    }
}

impl Drop for QuadRenderer {
    fn drop(&mut self) {
        let gl = &self.context.gl;
        gl.delete_texture(self.rows.as_ref());
        gl.delete_buffer(self.order.as_ref());
        gl.delete_vertex_array(self.attributes.as_ref());
    }
}
