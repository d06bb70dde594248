//! The optimisation on the GPU: WGSL compute shaders, each operation a `.rs` beside its `.wgsl`.
//!
//! In a steady iteration the host writes two small uniforms and makes one submission; nothing is read back.
//! Every 64 iterations (`REPORT`) the losses are copied out and arrive while later iterations run.
//!
//! An iteration that needs more pairs of tiles and splats than there is room for halts the GPU: from it on no kernel
//! changes anything that outlives an iteration. The report says so; the host then enlarges the buffers and submits the
//! same iterations again. Results are those of buffers that were large enough from the start.
//!
//! Three types hold the engine's progress: `Mirror` says whether the host or the GPU has the newest state, `Memory`
//! what the GPU's memory holds, and `InFlight` which iterations are not yet known to be done.

mod activate;
mod adam;
mod fake_quant;
mod image_loss;
mod look;
mod memory;
mod motion_prior;
mod parts;
mod passes;
mod seen;
mod state_buffers;
mod sums;
mod targets;
#[cfg(test)]
mod test_support;

use std::sync::Arc;
use std::time::Instant;

use tcgs_core::{Camera, Image, Sensitivity};
use tcgs_render::gpu::raw::{StageTimer, Staged};
use tcgs_render::gpu::{Gpu, GpuError, GpuRasterizer};
use tcgs_render::{Draw, RenderSettings, StageTimes};

use self::look::GpuLook;
use self::memory::Memory;
use self::parts::Parts;
use self::passes::STAGES;
use self::state_buffers::REPORT;
use self::targets::Targets;
use super::cpu::Drawn;
use super::device::{InFlight, LOSS_VALUES, Mirror, StepUniform, ViewPlace, count_updates, losses_of};
use super::{Engine, LookRenderer, Scenery, Step, Target};
use crate::TrainError;
use crate::config::MaskConfig;
use crate::losses::LossTerms;
use crate::sensitivity::sensitivity;
use crate::state::State;

/// Unstable, for the tests of this crate only: buffers and kernels of single operations, which are compared with the
/// CPU's. They change with the shaders.
#[doc(hidden)]
pub mod testing {
    pub use super::fake_quant::{FakeQuantKernels, QuantizerBuffers};
    pub use super::motion_prior::{MotionPriorKernels, PriorBuffers, prior_rows};
    pub use crate::engine::device::{Packing, StepUniform};
}

/// Reports that may be on their way before the host waits for the first of them.
const MAX_REPORTS: usize = 2;

/// Factor by which room exceeds the pairs found to be needed.
const SPARE_PAIRS: f64 = 1.25;

/// Room for pairs of tiles and splats; only grows. 0 until a guess has proved too small.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Room {
    /// In timesteps that train everything.
    whole: usize,
    /// In timesteps that train a part.
    part: usize,
}

/// The request of one iteration. It may be submitted more than once.
#[derive(Clone, Debug)]
struct Request {
    uniform: StepUniform,
    /// A rate for every group of Adam.
    rates: Vec<[f32; 4]>,
    camera: usize,
}

/// The optimisation on a GPU.
///
/// Iterations run asynchronously: [`Engine::step`] returns before they are computed, and their losses are known up to
/// 64 iterations later. On one GPU results are the same in every run.
#[derive(Debug)]
pub struct GpuEngine {
    gpu: Gpu,
    state: Mirror,
    memory: Memory,
    /// The timestep's images.
    targets: Option<Targets>,
    /// The scenery of a timestep that trains a part of the scene.
    parts: Option<Parts>,
    room: Room,
    in_flight: InFlight<Request, Staged>,
    /// Known, and not yet returned.
    losses: Vec<LossTerms>,
    /// Present after the first profile.
    timer: Option<StageTimer>,
    /// Renders outside of iterations: sensitivities and pictures.
    rasterizer: GpuRasterizer,
    /// Renders for the gate's look.
    look: Arc<GpuLook>,
    /// The Gaussians that a state draws with a mask, with the state's version and the mask.
    drawn: Option<(u64, MaskConfig, Drawn)>,
}

impl GpuEngine {
    /// An engine that goes on from `state`. The GPU's memory is asked for at the first iteration.
    pub fn new(gpu: &Gpu, state: State) -> Self {
        Self {
            gpu: gpu.clone(),
            state: Mirror::new(state),
            memory: Memory::default(),
            targets: None,
            parts: None,
            room: Room::default(),
            in_flight: InFlight::new(REPORT),
            losses: Vec::new(),
            timer: None,
            rasterizer: GpuRasterizer::new(gpu),
            look: Arc::new(GpuLook::new(gpu)),
            drawn: None,
        }
    }

    /// Leaves room for `num_pairs` pairs of tiles and splats at first, instead of a guess. Too little room costs time
    /// but changes no result.
    #[must_use]
    pub fn with_room_for(mut self, num_pairs: usize) -> Self {
        self.room = Room { whole: num_pairs, part: num_pairs };
        self
    }

    /// The GPU that computes.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    fn targets(&self) -> &Targets {
        self.targets.as_ref().expect("a step comes after its timestep's begin")
    }

    /// Brings memory and kernels up to the newest state and the images.
    fn prepare(&mut self) -> Result<(), TrainError> {
        self.state.upload(|state| self.memory.upload(&self.gpu, state))?;
        let targets = self.targets.as_ref().expect("a step comes after its timestep's begin");
        let (parts, room) = (self.parts.as_ref(), self.room);
        Ok(self.memory.bind(&self.gpu, targets, parts, if parts.is_some() { room.part } else { room.whole })?)
    }

    /// Counts an iteration for Adam and makes its uniform. Everything is prepared.
    fn request(&mut self, step: &Step<'_>) -> Request {
        let targets = self.targets();
        let camera = &targets.cameras[step.camera];
        let view = ViewPlace {
            width: camera.width as u32,
            height: camera.height as u32,
            eye: camera.center().map(|x| x as f32),
            target_offset: targets.offsets[step.camera],
            segmented: targets.segmented,
            part: self.parts.as_ref().map(|parts| parts.place(step.camera)),
        };
        let uniform = StepUniform::of(step, view, self.state.host());
        self.state.advance();
        let rates = count_updates(step, &self.memory.loaded().model.packing, self.state.host_mut());
        Request { uniform, rates, camera: step.camera }
    }

    /// Submits an iteration; everything is prepared.
    ///
    /// - returns: its times on their way back, where there is a timer
    fn submit(&mut self, request: Request, timer: Option<&StageTimer>) -> Result<Option<Staged>, TrainError> {
        let targets = self.targets.as_ref().expect("a step comes after its timestep's begin");
        let camera = &targets.cameras[request.camera];
        let uniform = StepUniform { slot: self.in_flight.slot() as u32, ..request.uniform };
        let layout = self.state.host().parameters.gaussians.layout();
        let is_antialiased = layout.is_antialiased();
        let settings = RenderSettings::default().or_background(&layout.background_color());
        let (loaded, passes) = self.memory.ready();
        match &self.parts {
            Some(parts) => {
                let part = parts.place(request.camera).view.part;
                passes.renderer.set_part(camera, &settings, is_antialiased, part);
            }
            None => passes.renderer.set_view(camera, &settings, is_antialiased),
        }
        self.gpu.queue().write_buffer(&loaded.model.step, 0, &uniform.bytes(&request.rates));
        let mut encoder = self.gpu.encoder();
        let motion = loaded.motion.as_ref().filter(|_| uniform.has(StepUniform::HAS_PRIOR));
        passes.record(&mut encoder, &uniform, motion.map(|motion| &motion.kernels), timer);
        let times = timer.map(|timer| timer.stage(&self.gpu, &mut encoder)).transpose()?;
        let is_full = self.in_flight.submitted(request);
        let report = if is_full { Some(self.stage_losses(&mut encoder)?) } else { None };
        self.gpu.submit(encoder);
        self.gpu.check()?;
        if let Some(report) = report {
            self.expect(report);
        }
        Ok(times)
    }

    /// Records a copy of the losses of all iterations of the open batch.
    fn stage_losses(&self, encoder: &mut wgpu::CommandEncoder) -> Result<Staged, GpuError> {
        self.gpu.stage(encoder, &self.memory.loaded().model.losses, LOSS_VALUES * self.in_flight.slot())
    }

    /// Asks for a report whose copy was submitted.
    fn expect(&mut self, report: Staged) {
        report.map(&self.gpu);
        self.in_flight.reported(report);
    }

    /// Waits for all reports that are on their way, and takes them.
    fn collect_all(&mut self) -> Result<(), TrainError> {
        self.gpu.wait()?;
        if self.in_flight.oldest().is_some_and(|report| !report.is_ready()) {
            return Err(GpuError::Lost("it is done but has reported nothing".into()).into());
        }
        self.collect()
    }

    /// Takes the reports that have arrived.
    fn collect(&mut self) -> Result<(), TrainError> {
        while let Some(batch) = self.in_flight.arrived(Staged::is_ready) {
            let rows: Vec<f32> = batch.report.take(&self.gpu)?;
            let mut steps = batch.steps.into_iter();
            for row in rows.as_chunks::<LOSS_VALUES>().0 {
                match losses_of(row) {
                    Some(values) => {
                        self.losses.push(LossTerms::from_values(values));
                        steps.next();
                    }
                    None => {
                        let again = self.in_flight.halt(steps);
                        return self.repeat(again);
                    }
                }
            }
        }
        Ok(())
    }

    fn room_mut(&mut self) -> &mut usize {
        if self.parts.is_some() { &mut self.room.part } else { &mut self.room.whole }
    }

    /// Enlarges the buffers and resubmits `requests`, which start with the one that did not fit.
    fn repeat(&mut self, requests: Vec<Request>) -> Result<(), TrainError> {
        self.gpu.wait()?;
        let status = &self.memory.ready().1.renderer.buffers().status;
        let needed = self.gpu.read::<u32>(status, 2)?[1];
        *self.room_mut() = (f64::from(needed) * SPARE_PAIRS) as usize;
        self.memory.unbind();
        self.prepare()?;
        for request in requests {
            self.submit(request, None)?;
        }
        Ok(())
    }

    /// The state after all iterations so far, in the host's memory.
    fn read(&mut self) -> Result<&State, TrainError> {
        self.wait()?;
        let (gpu, memory) = (&self.gpu, &self.memory);
        Ok(self.state.download(|state| memory.loaded().model.read(gpu, state))?)
    }
}

impl Engine for GpuEngine {
    fn name(&self) -> String {
        self.gpu.info().name.clone()
    }

    fn begin(&mut self, targets: Arc<[Target]>, scenery: Option<Scenery>) -> Result<(), TrainError> {
        self.wait()?;
        let before = self.targets.take();
        let old = before.as_ref().map(Targets::shape).filter(|_| self.parts.is_none());
        self.parts = None;
        let targets = match scenery {
            Some(scenery) => {
                // Kernels are bound to the scenery of one timestep.
                self.memory.unbind();
                let (parts, words, offsets) = Parts::new(&self.gpu, &scenery, &targets)?;
                self.parts = Some(parts);
                Targets::of_words(&self.gpu, &targets, &words, offsets, before)?
            }
            None => Targets::new(&self.gpu, &targets, before)?,
        };
        if old != Some(targets.shape()) {
            self.memory.unbind();
        }
        self.targets = Some(targets);
        Ok(())
    }

    /// Keeps the images: the next timestep reuses their memory.
    fn end(&mut self) {}

    fn step(&mut self, step: &Step<'_>) -> Result<(), TrainError> {
        self.prepare()?;
        let request = self.request(step);
        self.submit(request, None)?;
        self.gpu.poll()?;
        while self.in_flight.num_reports() > MAX_REPORTS {
            self.collect_all()?;
        }
        self.collect()
    }

    fn profile(&mut self, step: &Step<'_>) -> Result<StageTimes, TrainError> {
        self.wait()?;
        self.prepare()?;
        if self.timer.is_none() {
            self.timer = StageTimer::new(&self.gpu, &STAGES)?;
        }
        loop {
            let room = self.room;
            let request = self.request(step);
            let timer = self.timer.take();
            let begin = Instant::now();
            let staged = self.submit(request, timer.as_ref())?;
            let times = match timer.as_ref().zip(staged) {
                Some((timer, staged)) => timer.read(&self.gpu, &staged)?,
                None => {
                    self.gpu.wait()?;
                    let total = begin.elapsed().as_secs_f64() * 1e3;
                    StageTimes { stages: vec![("iteration", total)], total }
                }
            };
            self.timer = timer;
            self.wait()?;
            if self.room == room {
                return Ok(times);
            }
            // It was repeated with more room but without a clock. The next iteration is timed.
        }
    }

    fn losses(&mut self) -> Result<Vec<LossTerms>, TrainError> {
        Ok(std::mem::take(&mut self.losses))
    }

    fn wait(&mut self) -> Result<(), TrainError> {
        while !self.in_flight.is_empty() {
            if self.in_flight.has_open() {
                let mut encoder = self.gpu.encoder();
                let report = self.stage_losses(&mut encoder)?;
                self.gpu.submit(encoder);
                self.expect(report);
            }
            self.collect_all()?;
        }
        Ok(())
    }

    fn state(&mut self) -> Result<&State, TrainError> {
        self.read()
    }

    fn state_mut(&mut self) -> Result<&mut State, TrainError> {
        self.read()?;
        Ok(self.state.change())
    }

    fn sensitivity(&mut self, cameras: &[Camera]) -> Result<Sensitivity, TrainError> {
        self.read()?;
        Ok(sensitivity(&self.rasterizer, &self.state.host().parameters.gaussians, cameras)?)
    }

    fn look_renderer(&self) -> Arc<dyn LookRenderer> {
        Arc::<GpuLook>::clone(&self.look)
    }

    fn draw(&mut self, mask: &MaskConfig, camera: &Camera) -> Result<Image, TrainError> {
        let version = self.state.version();
        if !self.drawn.as_ref().is_some_and(|(of, with, _)| *of == version && with == mask) {
            let drawn = Drawn::new(self.read()?, mask, false);
            self.drawn = Some((version, mask.clone(), drawn));
        }
        let (_, _, drawn) = self.drawn.as_ref().expect("it was just made");
        Ok(self.rasterizer.draw(&drawn.seen_by(camera), camera, &RenderSettings::default())?.0.image)
    }
}
