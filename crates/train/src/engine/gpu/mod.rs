//! The optimisation on the GPU: WGSL compute shaders, each operation a `.rs` beside its `.wgsl`.
//!
//! In a steady iteration the host writes two small uniforms and makes one submission; nothing is read back.
//! Every 64 iterations (`REPORT`) the losses are copied out and arrive while later iterations run.
//!
//! An iteration that needs more pairs of tiles and splats than there is room for halts the GPU: from it on no kernel
//! changes anything that outlives an iteration. The report says so; the host then enlarges the buffers
//! and asks for the same iterations again. Results are those of buffers that were large enough from the start.

mod activate;
mod adam;
mod fake_quant;
mod finish;
mod image_loss;
mod model;
mod motion_prior;
mod neighbor_lists;
mod passes;
mod step;
mod targets;
#[cfg(test)]
mod testing;

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use tcgs_core::{Activated, Attribute, Camera, Image, Sensitivity};
use tcgs_render::device::Capacity;
use tcgs_render::gpu::{Gpu, GpuError, GpuRasterizer, StageTimer, Staged};
use tcgs_render::{Draw, RenderSettings, StageTimes};

pub use activate::{ActivateBuffers, ActivateKernels};
pub use adam::{AdamBuffers, AdamKernel};
pub use fake_quant::{FakeQuantKernels, QuantizerBuffers};
pub use finish::{FinishBuffers, FinishKernel, LOSS_VALUES};
pub use image_loss::{ImageLossBuffers, ImageLossKernels};
pub use motion_prior::{MotionPriorKernels, PriorBuffers, prior_rows};
pub use step::{StepUniform, adam_rates};

use self::model::{Model, REPORT};
use self::passes::{Passes, STAGES};
use self::targets::Targets;
use super::cpu::drawn;
use super::{Engine, Step, Target};
use crate::TrainError;
use crate::config::MaskConfig;
use crate::fake_quant::MIN_STEP_SHARE;
use crate::losses::{LossTerms, PriorLosses};
use crate::motion::Pose;
use crate::neighbors::Neighbors;
use crate::sensitivity::sensitivity;
use crate::state::State;

/// Reports that may be on their way before the host waits for the first of them.
const MAX_REPORTS: usize = 2;

/// Room that is given beyond the pairs that were found to be needed.
const SPARE_PAIRS: f64 = 1.25;

/// One iteration that was asked for and is not yet known to be done.
#[derive(Clone, Copy, Debug)]
struct Pending {
    uniform: StepUniform,
    camera: usize,
}

/// Losses on their way back.
#[derive(Debug)]
struct Report {
    staged: Staged,
    num_steps: usize,
}

/// The losses on motion, with what they were made for.
#[derive(Debug)]
struct Prior {
    neighbors: Arc<Neighbors<f32>>,
    kernels: MotionPriorKernels,
    partials: wgpu::Buffer,
}

/// The optimisation on a GPU.
#[derive(Debug)]
pub struct GpuEngine {
    gpu: Gpu,
    state: State,
    /// The GPU has gone on since `state` was read.
    gpu_is_ahead: bool,
    /// `state` was changed since it was written.
    host_is_ahead: bool,
    targets: Option<Targets>,
    model: Option<Model>,
    prior: Option<Prior>,
    passes: Option<Passes>,
    /// Room for pairs of tiles and splats; grows only.
    num_pairs: usize,
    pending: VecDeque<Pending>,
    reports: VecDeque<Report>,
    /// A timestep has begun since the losses on motion were told what to compare with.
    past_is_new: bool,
    /// Submitted since the last report was asked for.
    unreported: usize,
    losses: Vec<LossTerms>,
    /// Once it was asked for.
    timer: Option<StageTimer>,
    /// Draws what is not trained on.
    rasterizer: GpuRasterizer,
    drawn: Option<(MaskConfig, Arc<Activated>)>,
}

impl GpuEngine {
    /// Goes on from `state`.
    pub fn new(gpu: &Gpu, state: State) -> Self {
        Self {
            gpu: gpu.clone(),
            state,
            gpu_is_ahead: false,
            host_is_ahead: true,
            targets: None,
            model: None,
            prior: None,
            passes: None,
            num_pairs: 0,
            past_is_new: false,
            pending: VecDeque::new(),
            reports: VecDeque::new(),
            unreported: 0,
            losses: Vec::new(),
            timer: None,
            rasterizer: GpuRasterizer::new(gpu),
            drawn: None,
        }
    }

    /// Leaves room for so many pairs of tiles and splats at first, instead of a guess.
    pub fn with_room_for(mut self, num_pairs: usize) -> Self {
        self.num_pairs = num_pairs;
        self
    }

    /// The GPU it computes on.
    pub fn gpu(&self) -> &Gpu {
        &self.gpu
    }

    /// Brings memory and kernels up to `state` and the images.
    fn prepare(&mut self) -> Result<(), TrainError> {
        if self.host_is_ahead && self.model.as_ref().is_none_or(|model| !model.fits(&self.state)) {
            // The old memory is given back before new is asked for.
            (self.passes, self.prior, self.model) = (None, None, None);
            self.model = Some(Model::new(&self.gpu, &self.state)?);
        }
        if self.host_is_ahead {
            self.prepare_prior()?;
            self.model().write(&self.gpu, &self.state);
            self.host_is_ahead = false;
        }
        if self.passes.is_none() {
            let (model, targets) = (self.model(), self.targets());
            let mut capacity = Capacity::new(model.num_gaussians, targets.num_channels(), &targets.cameras, true);
            if self.num_pairs > 0 {
                capacity.num_pairs = self.num_pairs;
            }
            let partials = self.prior.as_ref().map_or(&model.flags, |prior| &prior.partials);
            self.passes = Some(Passes::new(&self.gpu, model, targets, capacity, partials)?);
        }
        Ok(())
    }

    /// Tells the losses on motion what to compare with, and makes them if they are not there yet.
    fn prepare_prior(&mut self) -> Result<(), TrainError> {
        let Some(past) = &self.state.past else { return Ok(()) };
        let model = self.model.as_ref().expect("prepared");
        if self.prior.as_ref().is_none_or(|prior| !Arc::ptr_eq(&prior.neighbors, &past.neighbors)) {
            let neighbors = Arc::clone(&past.neighbors);
            let rows = prior_rows(model.num_gaussians, neighbors.foreground.len());
            let partials = self.gpu.storage("sums of the losses on motion", 8 * rows)?;
            let buffers =
                PriorBuffers { params: &model.params, grads: &model.grads, step: &model.step, partials: &partials };
            let Pose { means, quats } = &*past.first;
            let kernels = MotionPriorKernels::new(&self.gpu, &neighbors, means, quats, &buffers)?;
            self.prior = Some(Prior { neighbors, kernels, partials });
            (self.passes, self.past_is_new) = (None, true);
        }
        if self.past_is_new {
            // Where everything was goes by way of the parameters' memory.
            let queue = self.gpu.queue();
            let mut at = 0;
            for attribute in Attribute::BASE {
                let values = past.previous.values(attribute);
                queue.write_buffer(&model.params, at, bytemuck::cast_slice(values));
                at += size_of_val(values) as u64;
            }
            let uniform = StepUniform { num_gaussians: model.num_gaussians as u32, ..StepUniform::default() };
            queue.write_buffer(&model.step, 0, bytemuck::bytes_of(&uniform));
            let mut encoder = self.gpu.encoder();
            let kernels = &self.prior.as_ref().expect("made above").kernels;
            kernels.record_begin(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()));
            self.gpu.submit(encoder);
            self.past_is_new = false;
        }
        Ok(())
    }

    fn model(&self) -> &Model {
        self.model.as_ref().expect("a step comes after its timestep's begin")
    }

    fn targets(&self) -> &Targets {
        self.targets.as_ref().expect("a step comes after its timestep's begin")
    }

    /// An iteration in the words of the shaders; counts it for Adam.
    fn uniform(&mut self, step: &Step<'_>) -> StepUniform {
        let (targets, w) = (self.targets(), step.weights);
        let camera = &targets.cameras[step.camera];
        let (width, height, offset) = (camera.width as u32, camera.height as u32, targets.offsets[step.camera]);
        let segmented = targets.segmented;
        let (num_quantizers, num_cameras) = (self.model().num_quantizers, self.model().num_cameras);
        let learned_offset = self.state.quantizers.as_ref().is_some_and(|q| q.learned_offset);
        let past = self.state.past.as_ref();
        let num_gaussians = self.state.parameters.num_gaussians();
        let num_foreground = past.map_or(0, |past| past.neighbors.foreground.len());
        let compares_masks = past.is_some_and(|past| past.previous_mask_logits.is_some());
        let flags = [
            (step.mask.enabled, StepUniform::MASKED),
            (step.counts_gradients, StepUniform::COUNTS),
            (step.moves_gaussians, StepUniform::MOVES),
            (self.state.quantizers.is_some(), StepUniform::QUANTIZED),
            (step.mask.enabled && compares_masks, StepUniform::COMPARES_MASKS),
            (segmented, StepUniform::SEGMENTED),
            (past.is_some(), StepUniform::HAS_PRIOR),
            (learned_offset, StepUniform::LEARNED_OFFSET),
        ];
        let per_node = past.map_or(0, |past| past.neighbors.per_node as u32);

        let o = &mut self.state.optimizer;
        let rates = &step.rates;
        let mut adam = [[0.0; 4]; 10];
        let mut count = |group: usize, updates: &mut u64, rate: f32, moves: bool| {
            if moves {
                *updates += 1;
                adam[group] = adam_rates(rate, *updates);
            }
        };
        let moves = step.moves_gaussians;
        let layout = Arc::clone(o.first.layout());
        for (group, (updates, column)) in o.steps.iter_mut().zip(layout.columns()).enumerate() {
            count(group, updates, rates.of(column), moves);
        }
        count(5, &mut o.mask.step, rates.mask, moves && step.mask.enabled);
        count(6, &mut o.gains.step, rates.camera, rates.camera > 0.0);
        count(7, &mut o.offsets.step, rates.camera, rates.camera > 0.0);
        count(8, &mut o.quantizer_steps.step, rates.step, num_quantizers > 0);
        count(9, &mut o.quantizer_offsets.step, rates.step, num_quantizers > 0 && learned_offset);

        StepUniform {
            num_gaussians: num_gaussians as u32,
            num_foreground: num_foreground as u32,
            per_node,
            num_background: if past.is_some() { (num_gaussians - num_foreground) as u32 } else { 0 },
            num_cameras: num_cameras as u32,
            camera: step.camera as u32,
            slot: 0,
            flags: flags.iter().map(|&(on, flag)| if on { flag } else { 0 }).sum(),
            width,
            height,
            num_quantizers: num_quantizers as u32,
            target_offset: offset,
            mask_threshold: step.mask.threshold,
            image_weight: w.image,
            segmentation_weight: w.segmentation,
            rigid_weight: w.rigid,
            rot_weight: w.rot,
            iso_weight: w.iso,
            floor_weight: if segmented { w.floor } else { 0.0 },
            background_weight: w.background,
            soft_color_weight: w.soft_color,
            mask_weight: w.mask,
            mask_consistency_weight: w.mask_consistency,
            step_min_share: MIN_STEP_SHARE,
            adam,
        }
    }

    /// Submits the iteration at `index` of those pending.
    fn submit(&mut self, index: usize, timer: Option<&StageTimer>) -> Result<Option<Staged>, TrainError> {
        let Pending { mut uniform, camera } = self.pending[index];
        uniform.slot = self.unreported as u32;
        let channels = self.targets().num_channels();
        let camera = self.targets().cameras[camera].clone();
        let passes = self.passes.as_mut().expect("prepared");
        passes.renderer.set_view(&camera, &RenderSettings::default());
        let (model, passes) = (self.model(), self.passes.as_ref().expect("prepared"));
        self.gpu.queue().write_buffer(&model.step, 0, bytemuck::bytes_of(&uniform));
        let mut encoder = self.gpu.encoder();
        let prior = self.prior.as_ref().filter(|_| uniform.flags & StepUniform::HAS_PRIOR != 0);
        passes.record(&mut encoder, [channels, camera.height, camera.width], prior.map(|p| &p.kernels), timer);
        let times = timer.map(|timer| timer.stage(&self.gpu, &mut encoder)).transpose()?;
        self.unreported += 1;
        let losses = if self.unreported == REPORT { Some(self.stage_losses(&mut encoder)?) } else { None };
        self.gpu.submit(encoder);
        self.gpu.check()?;
        if let Some(report) = losses {
            self.expect(report);
        }
        Ok(times)
    }

    fn stage_losses(&self, encoder: &mut wgpu::CommandEncoder) -> Result<Report, GpuError> {
        let staged = self.gpu.stage(encoder, &self.model().losses, LOSS_VALUES * self.unreported)?;
        Ok(Report { staged, num_steps: self.unreported })
    }

    fn expect(&mut self, report: Report) {
        report.staged.map(&self.gpu);
        self.reports.push_back(report);
        self.unreported = 0;
    }

    /// Waits for all reports that are on their way, and takes them.
    fn collect_all(&mut self) -> Result<(), TrainError> {
        self.gpu.wait()?;
        if self.reports.front().is_some_and(|report| !report.staged.is_ready()) {
            return Err(GpuError::Lost("it is done but has reported nothing".into()).into());
        }
        self.collect()
    }

    /// Takes the reports that have arrived.
    fn collect(&mut self) -> Result<(), TrainError> {
        while self.reports.front().is_some_and(|report| report.staged.is_ready()) {
            let report = self.reports.pop_front().expect("looked at above");
            let rows: Vec<f32> = report.staged.take(&self.gpu)?;
            for row in rows.as_chunks::<LOSS_VALUES>().0.iter().take(report.num_steps) {
                if row[HALTED] != 0.0 {
                    return self.repeat();
                }
                self.pending.pop_front();
                self.losses.push(terms(row));
            }
        }
        Ok(())
    }

    /// Enlarges the buffers and asks again for all iterations from the one on that they were too small for.
    fn repeat(&mut self) -> Result<(), TrainError> {
        self.gpu.wait()?;
        self.reports.clear();
        self.unreported = 0;
        let status = &self.passes.as_ref().expect("something was computed").renderer.buffers().status;
        let needed = self.gpu.read::<u32>(status, 2)?[1];
        self.num_pairs = (f64::from(needed) * SPARE_PAIRS) as usize;
        self.passes = None;
        self.prepare()?;
        for index in 0..self.pending.len() {
            self.submit(index, None)?;
        }
        Ok(())
    }

    /// What the state draws, kept until it changes.
    fn prepare_drawn(&mut self, mask: &MaskConfig) -> Result<(), TrainError> {
        if self.drawn.as_ref().is_none_or(|(of, _)| of != mask) {
            self.state()?;
            self.drawn = Some((mask.clone(), Arc::new(drawn(&self.state, mask, false))));
        }
        Ok(())
    }
}

/// Where a row of losses says whether the GPU had halted.
const HALTED: usize = 10;

fn terms(row: &[f32; LOSS_VALUES]) -> LossTerms {
    let [image, segmentation, rigid, rot, iso, floor, background, soft_color, mask, mask_consistency] =
        std::array::from_fn(|i| f64::from(row[i]));
    let prior = PriorLosses { rigid, rot, iso, floor, background, soft_color };
    LossTerms { image, segmentation, prior, mask, mask_consistency }
}

impl Engine for GpuEngine {
    fn name(&self) -> String {
        self.gpu.info().name.clone()
    }

    fn begin(&mut self, targets: Vec<Target>) -> Result<(), TrainError> {
        self.wait()?;
        let before = self.targets.take();
        let old = before.as_ref().map(|t| (t.buffer.clone(), t.num_channels(), t.cameras.clone()));
        let targets = Targets::new(&self.gpu, &targets, before)?;
        let same = Some((targets.buffer.clone(), targets.num_channels(), targets.cameras.clone())) == old;
        self.targets = Some(targets);
        if !same {
            self.passes = None;
        }
        self.past_is_new = self.state.past.is_some();
        Ok(())
    }

    fn step(&mut self, step: &Step<'_>) -> Result<(), TrainError> {
        self.prepare()?;
        (self.gpu_is_ahead, self.drawn) = (true, None);
        let uniform = self.uniform(step);
        self.pending.push_back(Pending { uniform, camera: step.camera });
        self.submit(self.pending.len() - 1, None)?;
        self.gpu.poll()?;
        while self.reports.len() > MAX_REPORTS {
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
            let room = self.num_pairs;
            (self.gpu_is_ahead, self.drawn) = (true, None);
            let uniform = self.uniform(step);
            self.pending.push_back(Pending { uniform, camera: step.camera });
            let timer = self.timer.take();
            let begin = Instant::now();
            let staged = self.submit(0, timer.as_ref())?;
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
            if self.num_pairs == room {
                return Ok(times);
            }
            // It was repeated with more room, without a clock. Another one tells the time.
        }
    }

    fn losses(&mut self) -> Result<Vec<LossTerms>, TrainError> {
        Ok(std::mem::take(&mut self.losses))
    }

    fn wait(&mut self) -> Result<(), TrainError> {
        while !self.pending.is_empty() {
            if self.unreported > 0 {
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
        self.wait()?;
        if self.gpu_is_ahead {
            self.model.as_ref().expect("something was computed").read(&self.gpu, &mut self.state)?;
            self.gpu_is_ahead = false;
        }
        Ok(&self.state)
    }

    fn state_mut(&mut self) -> Result<&mut State, TrainError> {
        self.state()?;
        (self.host_is_ahead, self.drawn) = (true, None);
        Ok(&mut self.state)
    }

    fn sensitivity(&mut self, cameras: &[Camera]) -> Result<Sensitivity, TrainError> {
        self.state()?;
        Ok(sensitivity(&self.rasterizer, &self.state.parameters.gaussians, cameras)?)
    }

    fn draw(&mut self, mask: &MaskConfig, camera: &Camera) -> Result<Image, TrainError> {
        self.prepare_drawn(mask)?;
        let (_, drawn) = self.drawn.as_ref().expect("made above");
        Ok(self.rasterizer.draw(drawn, camera, &RenderSettings::default())?.0.image)
    }
}
