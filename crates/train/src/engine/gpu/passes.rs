//! The kernels of one iteration, bound to their buffers, in their order.

use tcgs_render::device::Capacity;
use tcgs_render::gpu::raw::{GpuRenderer, PartLists, StageTimer};
use tcgs_render::gpu::{Gpu, GpuError};
use tcgs_render::tile_grid;

use super::activate::{ActivateBuffers, ActivateKernels};
use super::adam::{AdamBuffers, AdamKernel};
use super::fake_quant::FakeQuantKernels;
use super::image_loss::{ImageLossBuffers, ImageLossKernels};
use super::motion_prior::MotionPriorKernels;
use super::parts::Parts;
use super::seen::{SeenBuffers, SeenKernels};
use super::state_buffers::StateBuffers;
use super::sums::{SumsBuffers, SumsKernel};
use super::targets::Targets;
use crate::engine::device::StepUniform;

/// Stages of an iteration, in the order in which they run.
pub(super) const STAGES: [&str; 11] = [
    "activate",
    "project",
    "sort",
    "rasterize",
    "image losses",
    "rasterize backward",
    "project backward",
    "activate backward",
    "motion losses",
    "sums, small Adam",
    "Adam",
];

/// Everything that depends on the number of Gaussians, channels, and the images' size.
#[derive(Debug)]
pub(super) struct Passes {
    pub renderer: GpuRenderer,
    activate: ActivateKernels,
    /// None without harmonics.
    seen: Option<SeenKernels>,
    image_loss: ImageLossKernels,
    fake_quant: FakeQuantKernels,
    sums: SumsKernel,
    adam: AdamKernel,
}

impl Passes {
    /// - `parts`: the scenery, if the timestep trains a part of the scene
    /// - `prior_partials`: of the losses on motion; any buffer without these losses
    pub fn new(
        gpu: &Gpu,
        model: &StateBuffers,
        targets: &Targets,
        parts: Option<&Parts>,
        capacity: Capacity,
        prior_partials: &wgpu::Buffer,
    ) -> Result<Self, GpuError> {
        let renderer = match parts {
            Some(parts) => {
                let lists = PartLists { lists: &parts.lists, num_rows: parts.num_rows };
                GpuRenderer::of_parts(gpu, capacity, &parts.activated, lists)?
            }
            None => GpuRenderer::new(gpu, capacity)?,
        };
        let render = renderer.buffers();
        let packing = &model.packing;
        let (step, status) = (&model.step, &render.status);
        let q = &model.quantizers;
        let activate = ActivateKernels::new(
            gpu,
            packing,
            ActivateBuffers {
                step,
                params: &model.params,
                flags: &model.flags,
                quantizer_groups: &q.quantizer_groups,
                group_starts: &q.group_starts,
                quantizers: &q.quantizers,
                activated: &render.activated,
                v_activated: &render.v_activated,
                previous_mask_logits: &model.previous_mask_logits,
                grads: &model.grads,
                v_means2d_ndc: &render.v_means2d_ndc,
                statistic: &model.statistic,
                status,
            },
            model.num_gaussians,
        )?;
        let seen = SeenKernels::new(
            gpu,
            packing,
            SeenBuffers {
                step,
                params: &model.params,
                activated: &render.activated,
                grads: &model.grads,
                part: parts.map(|parts| [&parts.lists, &parts.colors]),
            },
            model.num_gaussians,
            parts.map_or(0, |parts| parts.max_listed),
        );
        let [height, width] = targets.max_size();
        let [columns, rows] = tile_grid(width, height);
        let image_loss = ImageLossKernels::new(
            gpu,
            packing,
            ImageLossBuffers {
                step,
                rendered: &render.image,
                targets: &targets.buffer,
                cameras: &model.cameras,
                v_image: &render.v_image,
                part: parts.map(|parts| [&parts.lists, &parts.pictures]),
            },
            [targets.num_channels(), height, width],
            parts.map_or(columns * rows, |parts| parts.max_blocks),
        )?;
        let sums = SumsKernel::new(
            gpu,
            packing,
            SumsBuffers {
                step,
                image_partials: &image_loss.partials,
                mask_partials: &activate.mask_partials,
                prior_partials,
                quantizer_partials: &q.quantizer_partials,
                quantizer_rows: &q.quantizer_rows,
                quantizers: &q.quantizers,
                quantizer_state: &model.quantizer_state,
                cameras: &model.cameras,
                losses: &model.losses,
                status,
            },
            model.num_quantizers,
        )?;
        let adam = AdamKernel::new(
            gpu,
            packing,
            AdamBuffers {
                step,
                params: &model.params,
                grads: &model.grads,
                first_moments: &model.first_moments,
                second_moments: &model.second_moments,
                status,
            },
            parts.map_or(model.num_gaussians, |parts| parts.num_active),
        )?;
        let fake_quant = FakeQuantKernels::new(gpu, packing, q, &model.params, &model.grads, step);
        gpu.check()?;
        Ok(Self { renderer, activate, seen, image_loss, fake_quant, sums, adam })
    }

    /// Records one iteration; with a timer each stage is a pass of its own.
    ///
    /// - `step`: the iteration's uniform
    pub fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        step: &StepUniform,
        prior: Option<&MotionPriorKernels>,
        timer: Option<&StageTimer>,
    ) {
        match timer {
            Some(timer) => {
                for stage in 0..STAGES.len() {
                    self.stage(stage, &mut timer.pass(encoder, stage), step, prior);
                }
            }
            None => {
                let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
                for stage in 0..STAGES.len() {
                    self.stage(stage, &mut pass, step, prior);
                }
            }
        }
    }

    fn stage(
        &self,
        stage: usize,
        pass: &mut wgpu::ComputePass<'_>,
        step: &StepUniform,
        prior: Option<&MotionPriorKernels>,
    ) {
        match stage {
            0 => {
                self.activate.record_fwd(pass);
                if let Some(seen) = &self.seen {
                    seen.record_fwd(pass);
                }
            }
            1 => self.renderer.project(pass),
            2 => self.renderer.sort(pass),
            3 => self.renderer.rasterize(pass),
            4 => self.image_loss.record(pass, step),
            5 => self.renderer.rasterize_bwd(pass),
            6 => self.renderer.project_bwd(pass),
            7 => {
                self.activate.record_bwd(pass);
                if let Some(seen) = &self.seen {
                    seen.record_bwd(pass);
                }
                self.activate.record_count(pass);
                self.fake_quant.record(pass);
            }
            8 => {
                if let Some(prior) = prior {
                    prior.record(pass);
                }
            }
            9 => self.sums.record(pass),
            _ => self.adam.record(pass),
        }
    }
}
